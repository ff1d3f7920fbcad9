"""robot/ExecTask, with a chassis that behaves well and with one that does not."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from tests.harness import Robot, wait_until
from tests.node.goals import (
    ABORTED,
    CANCELED,
    EXEC_TASK,
    EXECUTING,
    SUCCEEDED,
    TASK_PROC,
    hurry,
    pause_task,
    short_task,
    slow_down,
    task,
)
from woosh_robot_agent.ros.actions.run import REPLACED


@pytest.fixture
def robot(shared_robot: Robot) -> Robot:
    """A client of the agent that the tests of this file share, and its new chassis."""
    return shared_robot


def test_task_id_is_the_clients_or_a_new_one(robot: Robot) -> None:
    assert short_task(robot, 0.05, task_id=77).result()[1].robot_task_id == 77
    ids = [short_task(robot, x).result()[1].robot_task_id for x in (0.1, 0.2, 0.3)]
    assert len(set(ids)) == 3
    assert [each.message.task_id for each in robot.chassis.received if each.type == EXEC_TASK] == [
        77,
        *ids,
    ]


def test_newer_task_with_the_same_id_replaces_the_older_one(robot: Robot) -> None:
    slow_down(robot.chassis)
    old = task(robot, task_id=9)
    old.feedback.wait(lambda fb: fb.state.value == EXECUTING)
    new = task(robot, mark="U5", task_id=9)
    assert old.wait_aborted().msg == REPLACED
    hurry(robot.chassis)
    status, ret = new.result()
    assert (status, ret.dest) == (SUCCEEDED, "U5")


def test_last_of_two_simultaneous_tasks_wins(robot: Robot) -> None:
    slow_down(robot.chassis)
    with ThreadPoolExecutor() as pool:
        goals = list(pool.map(lambda number: task(robot, task_id=number), (1, 2)))
    robot.chassis.wait_received(EXEC_TASK, 2)
    hurry(robot.chassis)
    ends = {goal.result()[0]: goal.result()[1] for goal in goals}
    sent = [each.message.task_id for each in robot.chassis.received if each.type == EXEC_TASK]
    assert (ends[ABORTED].robot_task_id, ends[SUCCEEDED].robot_task_id) == tuple(sent)
    assert ends[ABORTED].msg == REPLACED


def test_paused_task_is_polled_at_the_poll_period(robot: Robot) -> None:
    robot.set_goal_timing(poll_period=0.2)
    slow_down(robot.chassis)
    goal = task(robot)
    goal.feedback.wait(lambda fb: fb.state.value == EXECUTING)
    pause_task(robot.chassis)
    begun = time.monotonic()
    asked = robot.chassis.counts[TASK_PROC]
    wait_until(lambda: robot.chassis.counts[TASK_PROC] >= asked + 4)
    assert time.monotonic() - begun > 0.5
    paused = [fb for fb in goal.feedback.messages if fb.state.value == 4]
    assert len(paused) == 1, "a repeated report is no feedback"
    goal.cancel()
    assert goal.result()[0] == CANCELED
