"""Reports on tasks as a real robot sends them, and goals for such tasks."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from typing import Any

from tests.harness import Client, GoalClient, Robot
from tests.node.goals import ABORTED, COMPLETED, FAILED, SUCCEEDED, TASK_CANCELED
from tests.node.tasks.scripted_chassis import (
    EXEC_TASK,
    ROBOT_INFO,
    ROBOT_STATE,
    TASK_PROC,
    Body,
    ScriptedChassis,
)
from woosh_robot_msgs.action import ExecTask

IDLE, TASK = {"state": 2}, {"state": 4}
NAV, WAIT = 1, 6
"""Types of an action."""
RUNS, WARNS, CANCELS, DONE, SUSPENDED = 1, 2, 3, 4, 10
"""States of an action."""
PICK = [(3, NAV, RUNS), (3, NAV, DONE), (5, WAIT, RUNS), (5, WAIT, DONE), (7, WAIT, DONE)]
SEQUENCES = {
    "pick": PICK,
    "cancelled": [(3, NAV, RUNS), (3, NAV, CANCELS), (8, NAV, CANCELS)],
    "cancelled in a pause": [
        *((3, NAV, RUNS), (4, NAV, SUSPENDED)),
        *((4, NAV, CANCELS), (8, NAV, CANCELS)),
    ],
    "obstacle": [(3, NAV, RUNS), (4, NAV, WARNS), (4, NAV, WARNS), *PICK],
    "only the end": [(7, NAV, DONE)],
}
"""Task state, type and state of the action of each report on a task."""
STATUSES = {COMPLETED: SUCCEEDED, TASK_CANCELED: ABORTED, FAILED: ABORTED}
"""Status of a goal, by the state in the last report."""
IDS = count(1_719_959_303_788)
"""New task ids, as long as those in the logs of a real robot."""


def empty(time: int = 1719991764) -> Body:
    """Return the report of a robot that executes no task, since this time."""
    return {"action": {}, "time": time, "robotId": 10001}


def report(task_id: int, step: tuple[int, int, int], time: int = 1719991764) -> Body:
    state, action, action_state = step
    doing = {"type": action, "state": action_state, **({"waitId": 1} if action == WAIT else {})}
    return {
        "robotTaskId": str(task_id),
        "type": 1,
        "state": state,
        "action": doing,
        "dest": "758033B0",
        "time": time,
        "robotId": 10001,
    }


def reports(task_id: int, sequence: str) -> list[Body]:
    """Return the reports on a task that goes as one of `SEQUENCES`, a second apart."""
    return [
        report(task_id, step, 1719991764 + number)
        for number, step in enumerate(SEQUENCES[sequence])
    ]


def send(client: Client, task_id: int) -> GoalClient:
    goal = ExecTask.Goal()
    goal.arg.task_id = task_id
    goal.arg.type.value = 1
    return client.send_goal(ExecTask, "robot/ExecTask", goal)


class ScriptedRobot(Robot):
    """A client of an agent that is connected to a scripted chassis."""

    chassis: ScriptedChassis  # type: ignore[assignment]

    def start(self, task_id: int, *first: Body) -> GoalClient:
        """Start a task that the chassis accepts, and that it executes from now on.

        Args:
            task_id: id of the task.
            first: the first reports on the task. The client has them when this function returns.
        """
        chassis = self.chassis
        asked = chassis.count(EXEC_TASK)
        chassis.expect(EXEC_TASK, chassis.answer)
        goal = send(self, task_id)
        chassis.wait_request(EXEC_TASK, asked + 1)
        chassis.push(ROBOT_STATE, TASK)
        chassis.push_all(TASK_PROC, first)
        goal.feedback.wait_count(len(first))
        return goal

    def reconnect(self, meanwhile: Callable[[], None] = lambda: None) -> None:
        """Lose the link, call `meanwhile`, and wait until the agent is connected again."""
        known = self.chassis.count(ROBOT_INFO)
        self.chassis.vanish()
        meanwhile()
        self.chassis.listen()
        self.chassis.wait_request(ROBOT_INFO, known + 1)


def assert_ended(goal: GoalClient, expected: list[Body]) -> None:
    """Check that a goal ends like the last of these reports, and got all of them as feedback."""
    status, ret = goal.result()
    assert status == STATUSES[expected[-1]["state"]]
    assert wire(ret) == expected[-1]
    goal.feedback.wait_count(len(expected))
    assert [wire(fb) for fb in goal.feedback.messages] == expected


def wire(proc: Any) -> Body:
    """Return a ROS TaskProc as the chassis sends it."""
    action = {
        "type": proc.action.type.value,
        "state": proc.action.state.value,
        "waitId": proc.action.wait_id,
    }
    body = {
        "robotTaskId": str(proc.robot_task_id or ""),
        "type": proc.type.value,
        "state": proc.state.value,
        "dest": proc.dest,
        "time": proc.time,
        "robotId": proc.commu.robot_id,
        "msg": proc.msg,
    }
    found = {name: value for name, value in body.items() if value}
    return {**found, "action": {name: value for name, value in action.items() if value}}
