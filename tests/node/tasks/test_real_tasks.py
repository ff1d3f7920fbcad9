"""80 tasks of a real robot, frame by frame: each ends as the robot ended it.

The frames are sent in their recorded order, without the pauses between them.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.harness import Client, GoalClient
from tests.node.goals import ABORTED, COMPLETED, FAILED, SUCCEEDED, TASK_CANCELED
from tests.node.tasks.reports import ScriptedRobot, wire
from tests.node.tasks.scripted_chassis import EXEC_TASK, TASK_PROC, Body, ScriptedChassis
from woosh_robot_msgs.action import ExecTask

FACTS = Path(__file__).parents[2] / "facts" / "real_tasks.json"
TASKS: list[dict[str, Any]] = json.loads(FACTS.read_text("utf-8"))
GOALS = [n for n, task in enumerate(TASKS) if task["request"] == EXEC_TASK]
SETS = [n for n, task in enumerate(TASKS) if task["request"] != EXEC_TASK]
NO_ID = "None"
"""Id of a task whose request had none, and on which the robot never reported."""
EXEC_PRE_TASK = "woosh.robot.ExecPreTask"
ENDS = {
    "kCompleted": (SUCCEEDED, COMPLETED),
    "kCanceled": (ABORTED, TASK_CANCELED),  # by another client
    "kFailed": (ABORTED, FAILED),
}
"""Status of the goal and state of the task in its result, by the recorded end."""


@pytest.fixture(scope="module")
def goal_link_timeout() -> float:
    return 1.0


def script(chassis: ScriptedChassis, task: dict[str, Any]) -> list[Callable[[], None]]:
    """Return what the chassis does in a task, frame by frame."""
    refused = task["refused"]
    steps: list[Callable[[], None]] = []
    for _, kind, name, body in task["frames"]:
        if kind == "answer":
            steps.append(lambda: chassis.answer(refused is None, refused or "Request succeed"))
        elif kind == "push":
            steps.append(lambda name=name, body=body: chassis.push(name, body))  # type: ignore[misc]
    return steps


def play(steps: list[Callable[[], None]]) -> None:
    for step in steps:
        step()


def reports(task: dict[str, Any], task_id: str | None) -> list[Body]:
    """Return the reports on a task, in order; on all tasks if `task_id` is None."""
    procs = [body for _, kind, name, body in task["frames"] if (kind, name) == ("push", TASK_PROC)]
    return [body for body in procs if task_id in (None, body.get("robotTaskId"))]


def send(client: Client, task: dict[str, Any]) -> GoalClient:
    goal = ExecTask.Goal()
    goal.arg.task_id = 0 if task["task_id"] == NO_ID else int(task["task_id"])
    goal.arg.type.value = 1
    return client.send_goal(ExecTask, "robot/ExecTask", goal)


@pytest.mark.parametrize(
    ("number", "pace"),
    [(number, ("at once", "one by one")[turn % 2]) for turn, number in enumerate(GOALS)],
)
def test_goal_ends_as_the_robot_ended_the_task(
    robot: ScriptedRobot, number: int, pace: str
) -> None:
    task = TASKS[number]
    steps = script(robot.chassis, task)
    expected = reports(task, task["task_id"])
    asked = robot.chassis.count(EXEC_TASK)
    if pace == "at once":
        robot.chassis.expect(EXEC_TASK, lambda: play(steps))
        goal = send(robot, task)
    else:
        robot.chassis.expect(EXEC_TASK)
        goal = send(robot, task)
        robot.chassis.wait_request(EXEC_TASK, asked + 1)
        told = 0
        for (_, kind, name, body), step in zip(frames(task), steps, strict=True):
            assert kind == "answer" or told == len(expected) or not goal.done
            step()
            if (kind, name) == ("push", TASK_PROC) and body in expected:
                told += 1
                goal.feedback.wait_count(told)
    if "link_lost_at" in task:
        robot.chassis.wait_request(EXEC_TASK, asked + 1)
        robot.chassis.vanish()

    status, ret = goal.result()

    goal.feedback.wait_count(len(expected))
    assert [wire(fb) for fb in goal.feedback.messages] == expected
    if "link_lost_at" in task:
        assert (status, ret.state.value) == (ABORTED, FAILED)
        assert "the link was lost" in ret.msg
        robot.chassis.listen()
        robot.agent.wait_connected()
    elif task["refused"]:
        assert (status, ret.state.value) == (ABORTED, FAILED)
        assert ret.msg.split(" (")[0] == task["refused"]
    else:
        assert (status, ret.state.value) == ENDS[task["end"]]
        assert wire(ret) == expected[-1]


def frames(task: dict[str, Any]) -> list[Any]:
    return [frame for frame in task["frames"] if frame[1] in ("answer", "push")]
