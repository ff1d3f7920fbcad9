"""robot/ExecTask, with a chassis that behaves well and with one that does not."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from tests.harness import Robot, wait_until
from tests.node.goals import (
    ABORTED,
    CANCELED,
    COMPLETED,
    EXEC_TASK,
    EXECUTING,
    FAILED,
    SUCCEEDED,
    TASK_CANCELED,
    TASK_PROC,
    hurry,
    pause_task,
    proc,
    short_task,
    slow_down,
    task,
)
from woosh_robot_agent.ros.actions.run import REPLACED
from woosh_robot_agent.simulator.serving.exchange import Outgoing


@pytest.fixture
def robot(shared_robot: Robot) -> Robot:
    """A client of the agent that the tests of this file share, and its new chassis."""
    return shared_robot


def test_task_succeeds_with_each_report_as_feedback(robot: Robot) -> None:
    before = int(time.time())
    goal = task(robot)
    status, ret = goal.result()
    assert status == SUCCEEDED
    assert ret.state.value == COMPLETED
    assert ret.dest == "A2"
    sent = robot.chassis.last(EXEC_TASK)
    assert before <= sent.task_id == ret.robot_task_id
    goal.feedback.wait(lambda fb: fb.state.value == COMPLETED)
    states = [fb.state.value for fb in goal.feedback.messages]
    assert states[-1] == COMPLETED
    assert EXECUTING in states
    assert {fb.robot_task_id for fb in goal.feedback.messages} == {sent.task_id}


def test_task_id_is_the_clients_or_a_new_one(robot: Robot) -> None:
    assert short_task(robot, 0.05, task_id=77).result()[1].robot_task_id == 77
    ids = [short_task(robot, x).result()[1].robot_task_id for x in (0.1, 0.2, 0.3)]
    assert len(set(ids)) == 3
    assert [each.message.task_id for each in robot.chassis.received if each.type == EXEC_TASK] == [
        77,
        *ids,
    ]


def test_refusal_reaches_the_client(robot: Robot) -> None:
    robot.chassis.refuse(EXEC_TASK, "robot is in manual mode: turn the key switch")
    goal = task(robot, task_id=5)
    ret = goal.wait_aborted()
    assert ret.msg == "robot is in manual mode: turn the key switch"
    assert ret.state.value == FAILED
    assert ret.robot_task_id == 5
    assert not goal.feedback.messages
    robot.chassis.refuse(EXEC_TASK, "")
    task(robot).wait_aborted("refused")


def test_newer_task_with_the_same_id_replaces_the_older_one(robot: Robot) -> None:
    slow_down(robot.chassis)
    old = task(robot, task_id=9)
    old.feedback.wait(lambda fb: fb.state.value == EXECUTING)
    new = task(robot, mark="U5", task_id=9)
    assert old.wait_aborted().msg == REPLACED
    hurry(robot.chassis)
    status, ret = new.result()
    assert (status, ret.dest) == (SUCCEEDED, "U5")


@pytest.mark.parametrize("state", [COMPLETED, TASK_CANCELED, FAILED])
def test_late_end_of_an_older_task_with_the_same_id_is_ignored(robot: Robot, state: int) -> None:
    assert short_task(robot, 0.1, task_id=9).result()[0] == SUCCEEDED
    late = Outgoing(TASK_PROC, proc(9, state, "the old end"))
    robot.chassis.intercept(lambda out: [late, out] if out.request == EXEC_TASK else [out])
    second = task(robot, mark="U5", task_id=9)
    status, ret = second.result()
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
