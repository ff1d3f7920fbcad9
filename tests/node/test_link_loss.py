"""Goals whose link is lost, whose chassis falls silent, or whose start request gets no answer."""

from __future__ import annotations

from typing import Any

import pytest

from tests.harness import GoalClient, Robot, wait_until
from tests.node.goals import (
    ACTION,
    CALL_ACTION,
    EXEC_TASK,
    STEP,
    SUCCEEDED,
    TASK,
    Kind,
    each_kind,
    feedbacks,
    hurry,
    short_task,
    slow_down,
    step,
    task,
    until,
    without_reports,
)
from tests.node.test_parameters import change
from tests.quick_chassis import quick_config
from woosh_robot_agent.simulator import SimulatorThread

ROBOT_INFO = "woosh.robot.RobotInfo"


@pytest.fixture
def timeouts() -> dict[str, Any]:
    """Timeouts long enough for a slow machine to find the link and the goal again."""
    return {"goal_link_timeout": 10.0, "poll_timeout": 1000}


short_timeouts = pytest.mark.parametrize(
    "timeouts", [{"goal_link_timeout": 0.8, "poll_timeout": 300}], ids=["short"]
)
"""Timeouts with which a goal is given up soon."""


@pytest.fixture(scope="module")
def shared_parameters() -> dict[str, Any]:
    return {"backoff_max": 0.1}


@pytest.fixture
def robot(shared_robot: Robot, timeouts: dict[str, Any]) -> Robot:
    """A client of the agent that the tests of this file share, with timeouts for this test."""
    assert change(shared_robot, **timeouts) == (True, "")
    return shared_robot


@pytest.fixture(autouse=True)
def frequent_polls(robot: Robot) -> None:
    robot.set_goal_timing(poll_period=0.6)


def switch_off(simulator: SimulatorThread) -> None:
    simulator.stop_listening()
    wait_until(lambda: simulator.connections == 0)


def medium(robot: Robot, kind: Kind) -> GoalClient:
    """Start a goal that ends within a second once the simulator hurries."""
    return task(robot) if kind is TASK else step(robot, 8.0)


# The link is lost and comes back


@each_kind
def test_goal_goes_on_after_a_reconnect(robot: Robot, kind: Kind) -> None:
    slow_down(robot.chassis)
    goal = medium(robot, kind)
    goal.feedback.wait_count(3)
    robot.chassis.drop()
    robot.chassis.wait_received(ROBOT_INFO, 2)
    count = len(goal.feedback.messages)
    hurry(robot.chassis)
    goal.feedback.wait_count(count + 1)
    assert goal.result()[0] == SUCCEEDED
    assert robot.chassis.counts[kind.starts] == 1, "nothing is replayed"


def test_action_that_ended_without_a_link_succeeds(robot: Robot) -> None:
    """tasks/test_special_cases.py has the same for tasks."""
    goal = until(step(robot, 2.0), ACTION.runs)
    switch_off(robot.chassis)
    chassis = robot.chassis
    wait_until(lambda: chassis.call(lambda sim: sim.chassis.actions.last[STEP].state == 1))
    robot.chassis.listen()
    status, ret = goal.result()
    assert (status, ret.state.value) == (SUCCEEDED, ACTION.done)


@short_timeouts
@each_kind
def test_goal_unknown_to_the_chassis_is_aborted(robot: Robot, kind: Kind) -> None:
    goal = kind.running(robot)
    switch_off(robot.chassis)
    with SimulatorThread(quick_config(port=robot.chassis.port, tcp_port=0)):
        ret = goal.wait_aborted()
    assert ret.state.value == kind.failed
    assert "link was lost" in ret.msg or (kind is TASK and "does not know the task" in ret.msg)


# The link does not come back


def test_new_goal_without_a_link_is_aborted_and_not_sent_later(robot: Robot) -> None:
    switch_off(robot.chassis)
    task(robot).wait_aborted("not connected to ws://127.0.0.1")
    robot.chassis.listen()
    robot.chassis.wait_received(ROBOT_INFO, 2)
    assert robot.chassis.counts[EXEC_TASK] == 0


@pytest.mark.parametrize(
    "timeouts", [{"goal_link_timeout": 3.0, "poll_timeout": 1000}], ids=["medium"]
)
def test_goal_is_aborted_if_the_chassis_hangs(robot: Robot) -> None:
    """It answers pings, which keeps the link, and nothing else."""
    slow_down(robot.chassis)
    goal = TASK.running(robot)
    robot.chassis.inject("freeze")
    goal.wait_aborted("does not answer", "the robot may still be executing it")


# The start request gets no answer


def ignore(simulator: SimulatorThread, request: str) -> None:
    """Let the chassis neither execute nor answer requests of a type."""
    simulator.refuse(request, "")
    simulator.mute(request)


@pytest.mark.parametrize(
    ("kind", "told"),
    [(TASK, True), (ACTION, True), (ACTION, False)],
    ids=["task, by reports", "action, by reports", "action, by polls"],
)
def test_goal_goes_on_without_an_answer_to_its_start(robot: Robot, kind: Kind, told: bool) -> None:
    robot.chassis.mute(kind.starts)
    if not told:
        robot.chassis.intercept(without_reports)
        # if the first poll found an end, it might be that of an earlier goal
        slow_down(robot.chassis)
    goal = medium(robot, kind)
    if not told:
        robot.chassis.wait_received(kind.polls, 2)  # the first one is of the new link
        hurry(robot.chassis)
    assert goal.result()[0] == SUCCEEDED


@short_timeouts
@each_kind
def test_goal_that_never_arrived_is_aborted(robot: Robot, kind: Kind) -> None:
    """The chassis reports the end of an earlier goal with the same name."""

    def start() -> GoalClient:
        return short_task(robot, 0.2, task_id=3) if kind is TASK else step(robot, 0.3)

    assert start().result()[0] == SUCCEEDED
    ignore(robot.chassis, kind.starts)
    start().wait_aborted("no answer to the goal", "did not answer")


@short_timeouts
def test_newer_action_that_never_arrived_does_not_replace_the_older_one(robot: Robot) -> None:
    old = ACTION.running(robot)
    ignore(robot.chassis, CALL_ACTION)
    step(robot, 1.0).wait_aborted("no answer to the goal")
    assert not old.done
    robot.chassis.push(feedbacks(1, "the end"))
    assert old.result()[0] == SUCCEEDED


def test_goal_goes_on_if_the_link_is_lost_before_its_answer(robot: Robot) -> None:
    robot.chassis.mute(EXEC_TASK)
    robot.chassis.intercept(without_reports)
    goal = task(robot)
    robot.chassis.wait_received(EXEC_TASK)
    robot.chassis.drop()
    assert goal.result()[0] == SUCCEEDED
    assert robot.chassis.counts[EXEC_TASK] == 1
