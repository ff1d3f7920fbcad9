"""The table of a scene that lists the actions of each kind of task: `action_groups.json`.

The default table, in the folder `data/`, has the content of a real TR-200's table.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal

from woosh_robot_agent.data_files import Between, DataFileError, NotNegative, load_json, structure
from woosh_robot_agent.pb.util import action_pb2, task_pb2

ACTION_GROUPS = "action_groups.json"
"""Name of the file in the folder of a scene."""


def _one_of(numbers: Collection[int]) -> Callable[[int], None]:
    """Return a check that a number is one of `numbers`, but not 0, which stands for undefined."""
    valid = [number for number in numbers if number]

    def check(number: int) -> None:
        if number not in valid:
            raise ValueError(f"{number} is not one of {', '.join(map(str, valid))}")

    return check


@dataclass(frozen=True)
class Action:
    """An action of a task.

    Only waits use the `wait_` attributes, and only steps the `stepctrl_` ones.

    Attributes:
        action: the `woosh.action.Type`.
        wait_id: number of a wait, which TaskProc reports; 0 for its position among the waits.
        wait_time: duration of a wait, in seconds.
        stepctrl_type: kind of a step: 0 is straight, 1 a turn.
        stepctrl_value: distance of a step in metres, or its angle in radians.
        stepctrl_speed: speed of a step, in m/s or rad/s; 0 for the default.
        stepctrl_avoid: True if a step stops before obstacles.
    """

    action: Annotated[int, _one_of(action_pb2.Type.values())]
    wait_id: Annotated[int, Between(0, 2**31 - 1)] = 0
    wait_time: NotNegative = 0.0
    stepctrl_type: Literal[0, 1] = 0
    stepctrl_value: float = 0.0
    stepctrl_speed: NotNegative = 0.0
    stepctrl_avoid: bool = False


@dataclass(frozen=True)
class _Group:
    """The actions of the tasks of one type and number.

    Attributes:
        type: the `woosh.task.Type`.
        no: the number, as `task_type_no` in ExecTask.
        order: the actions, in the order in which they are executed.
    """

    type: Annotated[int, _one_of(task_pb2.Type.values())]
    no: Annotated[int, Between(0)]
    order: Annotated[tuple[Action, ...], Between(1)]


@dataclass(frozen=True)
class _File:
    """The content of the file.

    Attributes:
        task_type: the actions of all tasks; the attribute is named like the key of the file.
    """

    task_type: tuple[_Group, ...]


@dataclass(frozen=True, eq=False)
class ActionGroups:
    """The table of a scene.

    Attributes:
        data: content of the file, as it was read.
        groups: the actions of tasks, in order, by the type and the number of the task.
    """

    data: bytes
    groups: Mapping[tuple[int, int], tuple[Action, ...]]

    def actions(self, kind: int, number: int) -> tuple[Action, ...] | None:
        """Return the actions of tasks of a type and number; None if the table has none."""
        return self.groups.get((kind, number))

    def numbers(self, kind: int) -> Collection[int]:
        """Return the numbers of all groups of a type; empty if there are none."""
        return [number for each, number in self.groups if each == kind]


def read_action_groups(data: bytes) -> ActionGroups:
    """Read the file, ignoring unknown keys; empty content means the default table."""
    if not data.strip():
        return default_action_groups()
    groups: dict[tuple[int, int], tuple[Action, ...]] = {}
    content = load_json(ACTION_GROUPS, data)
    for each in structure(_File, content, ACTION_GROUPS, known_only=False).task_type:
        if (each.type, each.no) in groups:
            text = f"type {each.type} has two groups with the number {each.no}"
            raise DataFileError(f"{ACTION_GROUPS}: {text}")
        groups[each.type, each.no] = each.order
    return ActionGroups(data, groups)


@lru_cache
def default_action_groups() -> ActionGroups:
    """Return the table for scenes without a table."""
    return read_action_groups((Path(__file__).parents[1] / "data" / ACTION_GROUPS).read_bytes())
