"""Goals given up because the chassis does not report on them, although the link is up."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import pytest

from tests.harness import Robot, wait_until
from tests.node.goals import (
    ACTION,
    CANCELED,
    FEEDBACKS,
    TASK,
    TASK_PROC,
    Kind,
    each_kind,
    slow_down,
    without_reports,
)
from tests.node.test_parameters import change
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed
from woosh_robot_agent.pb.ros.ros_pack_pb2 import Feedbacks
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.simulator.serving.exchange import Outgoing


@pytest.fixture(scope="module")
def shared_parameters() -> dict[str, Any]:
    """Return timeouts that are short, but longer than the pauses of a busy machine."""
    return {"goal_link_timeout": 2.0, "poll_timeout": 1000}


@pytest.fixture
def robot(shared_robot: Robot) -> Robot:
    """A client of the agent that the tests of this file share, and its new chassis."""
    slow_down(shared_robot.chassis)
    return shared_robot


@pytest.fixture(autouse=True)
def short_timing(robot: Robot) -> None:
    robot.set_goal_timing(poll_period=0.1, min_cancel_timeout=2.0)


def hide_actions(out: Outgoing) -> list[Outgoing]:
    """Drop pushed reports, and empty the answers to polls of actions."""
    answered = out.request == FEEDBACKS
    return without_reports(dataclasses.replace(out, body=Feedbacks()) if answered else out)


def wait_polled(simulator: SimulatorThread, kind: Kind, more: int) -> None:
    simulator.wait_received(kind.polls, simulator.counts[kind.polls] + more)


# The chassis sends no report


def test_goal_never_reported_on_is_given_up(robot: Robot) -> None:
    robot.chassis.intercept(hide_actions)
    ret = ACTION.start(robot).wait_aborted("accepted the goal", "no report on it")
    assert ret.state.value == ACTION.failed
    assert "the robot may still be executing it" in ret.msg
    assert "`stop` service" in ret.msg
    assert robot.chassis.counts[FEEDBACKS] >= 3


# The chassis does not answer polls


@each_kind
def test_goal_is_given_up_if_polls_are_not_answered(robot: Robot, kind: Kind) -> None:
    goal = kind.running(robot)
    robot.chassis.intercept(without_reports)
    robot.chassis.mute(kind.polls)

    def ended() -> bool:
        robot.chassis.push(PoseSpeed())  # the chassis is not silent
        return bool(goal.done)

    wait_until(ended)
    goal.wait_aborted("no report on it", "did not answer", "`stop` service")


# The chassis accepts a cancel


@pytest.mark.parametrize(
    ("kind", "told"), [(TASK, False), (ACTION, True)], ids=["silent", "reported as running"]
)
def test_goal_is_given_up_if_an_accepted_cancel_has_no_effect(
    robot: Robot, kind: Kind, told: bool
) -> None:
    goal = kind.running(robot)
    robot.chassis.call(ignore_cancels)
    if not told:
        robot.chassis.intercept(without_reports)
        robot.chassis.refuse(kind.polls, "unknown type")
    goal.cancel()
    reported = len(goal.feedback.messages)

    def ended() -> bool:
        if told:
            count = len(goal.feedback.messages)
            robot.chassis.push(kind.report(kind.runs, f"report {count}"))
        return bool(goal.done)

    wait_until(ended)
    assert not told or len(goal.feedback.messages) > reported + 1, "they reached the client"
    goal.wait_aborted("accepted the cancel, but the goal did not end within 4 s", "`stop` service")


def ignore_cancels(sim: Any) -> None:
    """Make the chassis accept cancels and go on."""
    sim.chassis.tasks.cancel = lambda *args, **options: None
    sim.chassis.actions.cancel = lambda *args, **options: None


# The chassis refuses a cancel


@pytest.mark.parametrize(
    ("kind", "refuses"),
    [(TASK, True), (ACTION, True), (ACTION, False)],
    ids=["task, polls refused", "action, polls refused", "action, polls without it"],
)
def test_goal_is_given_up_if_its_cancel_is_refused_and_nothing_reports_on_it(
    robot: Robot, kind: Kind, refuses: bool
) -> None:
    """It has ended if the report of its end was lost, and would otherwise stay open for ever."""
    goal = kind.running(robot)
    robot.chassis.intercept(hide_actions)
    if refuses:
        robot.chassis.refuse(kind.polls, "unknown type")
    robot.chassis.refuse(kind.cancels, "nothing is running")
    wait_polled(robot.chassis, kind, 3)
    assert not goal.done
    goal.cancel()
    goal.wait_aborted("refused the cancel", "the robot may still be executing it")


# The chassis does not answer a cancel


@pytest.fixture
def patient(robot: Robot) -> Iterator[None]:
    """A timeout that no goal of the test exceeds."""
    assert change(robot, goal_link_timeout=10.0) == (True, "")
    yield
    assert change(robot, goal_link_timeout=2.0) == (True, "")


@pytest.mark.parametrize(("kind", "lost"), [(TASK, "answer"), (TASK, "link"), (ACTION, "answer")])
@pytest.mark.usefixtures("patient")
def test_cancel_is_repeated_only_after_a_report(robot: Robot, kind: Kind, lost: str) -> None:
    """A cancel of a task names no task, so it could end another client's newer task."""
    goal = kind.running(robot)
    sent = robot.chassis.counts[kind.cancels] + 1
    remove = robot.chassis.intercept(hide_actions)
    robot.chassis.refuse(TASK_PROC, "unknown type")
    robot.chassis.refuse(kind.cancels, "")  # so that the chassis does not execute it
    robot.chassis.mute(kind.cancels)
    goal.cancel()
    robot.chassis.wait_received(kind.cancels, sent)
    if lost == "link":
        robot.chassis.drop()
    wait_polled(robot.chassis, kind, 6)
    assert robot.chassis.counts[kind.cancels] == sent
    robot.chassis.accept(kind.cancels)
    remove()
    robot.chassis.accept(TASK_PROC)
    assert goal.result()[0] == CANCELED
    assert robot.chassis.counts[kind.cancels] == sent + 1
