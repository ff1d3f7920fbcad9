"""robot/ExecPreTask as an action on the simulated robot; tasks/test_task_sets.py has the rules."""

from __future__ import annotations

import pytest

from tests.harness import Client, GoalClient, Robot, wait_until
from tests.node.goals import (
    ACTION_ORDER,
    COMPLETED,
    EXECUTING,
    SUCCEEDED,
    hurry,
    slow_down,
    task,
)
from woosh_robot_agent.ros.actions.run import REPLACED
from woosh_robot_msgs.action import ExecPreTask

TASK_SETS = "robot/ExecPreTask"


@pytest.fixture
def robot(shared_robot: Robot) -> Robot:
    """A client of the agent that the tests of this file share, and its new chassis."""
    return shared_robot


def send(client: Client, number: int) -> GoalClient:
    goal = ExecPreTask.Goal()
    goal.arg.task_set_id = number
    return client.send_goal(ExecPreTask, TASK_SETS, goal)


@pytest.mark.parametrize(
    ("number", "tasks"), [(666, [66601, 66602]), (1735291765, [173529176501] * 2)]
)
def test_a_set_runs_to_its_end(robot: Robot, number: int, tasks: list[int]) -> None:
    """The second set is one task, twice."""
    goal = send(robot, number)
    status, ret = goal.result()
    assert (status, ret.robot_task_id, ret.state.value) == (SUCCEEDED, tasks[-1], COMPLETED)
    ended = [fb for fb in goal.feedback.messages if fb.state.value == COMPLETED]
    assert [fb.robot_task_id for fb in ended] == tasks


@pytest.mark.parametrize("newer", ["a task", "a set"])
def test_a_newer_goal_replaces_an_older_one_of_the_other_kind(robot: Robot, newer: str) -> None:
    slow_down(robot.chassis)
    older = send(robot, 666) if newer == "a task" else task(robot, "A2")
    older.feedback.wait(lambda fb: fb.state.value == EXECUTING)
    goal = task(robot, "A2") if newer == "a task" else send(robot, 666)
    assert older.wait_aborted().msg == REPLACED
    hurry(robot.chassis)
    assert goal.result()[0] == SUCCEEDED
    assert not robot.chassis.counts[ACTION_ORDER], "a cancel would hit the newer goal"
    wait_until(lambda: not robot.agent.agent.debug()["running_goals"], "the end of all goals")
