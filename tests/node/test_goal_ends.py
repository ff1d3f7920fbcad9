"""Goals given up because the chassis does not report on them, although the link is up."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import pytest

from tests.harness import Client, GoalClient, RunningAgent, wait_until
from tests.node.goals import (
    ABORTED,
    ACTION_ORDER,
    CALL_ACTION,
    CANCELED,
    EXECUTING,
    FEEDBACKS,
    SUCCEEDED,
    TASK_PROC,
    feedbacks,
    proc,
    set_timing,
    slow_down,
    step,
    task,
)
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed
from woosh_robot_agent.pb.ros.ros_pack_pb2 import Feedbacks
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.simulator.serving.exchange import Outgoing

pytestmark = pytest.mark.usefixtures("agent")

KINDS = pytest.mark.parametrize("kind", ["task", "action"])


@pytest.fixture
def link_timeout() -> float:
    """Return a timeout in seconds: short, but longer than the pauses of a busy machine."""
    return 2.0


@pytest.fixture
def agent(
    simulator: SimulatorThread,
    start_agent: Callable[..., RunningAgent],
    link_timeout: float,
    monkeypatch: pytest.MonkeyPatch,
) -> RunningAgent:
    """Start the agent with short timeouts."""
    set_timing(monkeypatch, poll_period=0.1, min_cancel_timeout=2.0)
    started = start_agent(
        ip="127.0.0.1", port=simulator.port, goal_link_timeout=link_timeout, poll_timeout=1000
    )
    started.wait_connected()
    slow_down(simulator)
    return started


def start_goal(client: Client, kind: str) -> GoalClient:
    """Start a goal and wait for a report on it."""
    goal = task(client, mark="A23", task_id=11) if kind == "task" else step(client, 100.0)
    goal.feedback.wait(lambda fb: fb.state.value == (EXECUTING if kind == "task" else 2))
    return goal


def poll_type(kind: str) -> str:
    return TASK_PROC if kind == "task" else FEEDBACKS


def drop_reports(out: Outgoing) -> list[Outgoing]:
    return [] if out.type in (TASK_PROC, FEEDBACKS) and not out.sn else [out]


def hide_actions(out: Outgoing) -> list[Outgoing]:
    """Drop pushed reports, and empty the answers to polls of actions."""
    answered = out.request == FEEDBACKS
    return drop_reports(dataclasses.replace(out, body=Feedbacks()) if answered else out)


def wait_polled(simulator: SimulatorThread, kind: str, more: int) -> None:
    asks = poll_type(kind)
    simulator.wait_received(asks, simulator.counts[asks] + more)


# The chassis sends no report


def test_goal_never_reported_on_is_given_up(client: Client, simulator: SimulatorThread) -> None:
    simulator.intercept(hide_actions)
    status, ret = step(client, 100.0).result()
    assert (status, ret.state.value) == (ABORTED, -1)
    assert "accepted the goal" in ret.msg
    assert "no report on it" in ret.msg
    assert "the robot may still be executing it" in ret.msg
    assert "`stop` service" in ret.msg
    assert simulator.counts[FEEDBACKS] >= 3


@KINDS
def test_goal_never_reported_on_is_given_up_if_polls_are_refused(
    client: Client, simulator: SimulatorThread, kind: str
) -> None:
    simulator.intercept(drop_reports)
    simulator.refuse(poll_type(kind), "unknown type")
    goal = task(client, mark="A23") if kind == "task" else step(client, 100.0)
    status, ret = goal.result()
    assert (status, "no report on it" in ret.msg) == (ABORTED, True)


@pytest.mark.parametrize("refused", [False, True])
def test_goal_reported_on_once_goes_on(
    client: Client, simulator: SimulatorThread, refused: bool
) -> None:
    """A chassis rarely reports on a long step, and may omit it from its answers to polls."""
    goal = start_goal(client, "action")
    remove = simulator.intercept(hide_actions)
    if refused:
        simulator.refuse(FEEDBACKS, "unknown type")
    wait_polled(simulator, "action", 30)  # 3 s
    assert not goal.done
    remove()
    simulator.push(feedbacks(1, "the end"))
    assert goal.result()[0] == SUCCEEDED


# The chassis does not answer polls


@KINDS
def test_goal_is_given_up_if_polls_are_not_answered(
    client: Client, simulator: SimulatorThread, kind: str
) -> None:
    goal = start_goal(client, kind)
    simulator.intercept(drop_reports)
    simulator.mute(poll_type(kind))

    def ended() -> bool:
        simulator.push(PoseSpeed())  # the chassis is not silent
        return bool(goal.done)

    wait_until(ended)
    status, ret = goal.result()
    assert status == ABORTED
    assert "no report on it" in ret.msg
    assert "did not answer" in ret.msg
    assert "`stop` service" in ret.msg


def test_goal_goes_on_if_reports_come_between_unanswered_polls(
    client: Client, simulator: SimulatorThread
) -> None:
    goal = start_goal(client, "action")
    asked: list[Outgoing] = []

    def seldom(out: Outgoing) -> list[Outgoing]:
        if out.request != FEEDBACKS:
            return drop_reports(out)
        asked.append(out)
        told = dataclasses.replace(out, sn=0, request="", body=feedbacks(2, f"step {len(asked)}"))
        return [told] if len(asked) % 2 == 0 else []

    remove = simulator.intercept(seldom)

    def enough() -> bool:
        simulator.push(PoseSpeed())
        return len(asked) >= 7

    wait_until(enough)
    assert not goal.done
    remove()
    simulator.push(feedbacks(1, "the end"))
    assert goal.result()[0] == SUCCEEDED


# The chassis accepts a cancel


@KINDS
def test_goal_is_given_up_if_an_accepted_cancel_has_no_effect(
    client: Client, simulator: SimulatorThread, kind: str
) -> None:
    goal = start_goal(client, kind)
    simulator.intercept(drop_reports)
    simulator.refuse(poll_type(kind), "unknown type")
    goal.cancel()
    status, ret = goal.result()
    assert status == ABORTED
    assert "accepted the cancel" in ret.msg
    assert "within 4 s" in ret.msg
    assert "`stop` service" in ret.msg


@KINDS
def test_goal_that_is_reported_as_running_after_an_accepted_cancel_ends_in_time(
    client: Client, simulator: SimulatorThread, kind: str
) -> None:
    goal = start_goal(client, kind)
    simulator.call(ignore_cancels)
    goal.cancel()
    simulator.wait_received(ACTION_ORDER if kind == "task" else CALL_ACTION, 1 + (kind != "task"))
    reported = len(goal.feedback.messages)

    def ended() -> bool:
        count = len(goal.feedback.messages)
        simulator.push(
            proc(11, EXECUTING, f"report {count}")
            if kind == "task"
            else feedbacks(2, f"report {count}")
        )
        return bool(goal.done)

    wait_until(ended)
    assert len(goal.feedback.messages) > reported + 1, "the reports reached the client"
    status, ret = goal.result()
    assert status == ABORTED
    assert "accepted the cancel, but the goal did not end within 4 s" in ret.msg
    assert "`stop` service" in ret.msg


def ignore_cancels(sim: Any) -> None:
    """Make the chassis accept cancels and go on."""
    sim.chassis.tasks.cancel = lambda *args, **options: None
    sim.chassis.actions.cancel = lambda *args, **options: None


# The chassis does not answer a cancel


@pytest.mark.parametrize("link_timeout", [10.0])
@pytest.mark.parametrize("lost", ["answer", "link"])
@KINDS
def test_cancel_is_repeated_only_after_a_report(
    client: Client, simulator: SimulatorThread, kind: str, lost: str
) -> None:
    goal = start_goal(client, kind)
    cancels = ACTION_ORDER if kind == "task" else CALL_ACTION
    sent = simulator.counts[cancels] + 1
    remove = simulator.intercept(drop_reports if kind == "task" else hide_actions)
    if kind == "task":
        simulator.refuse(TASK_PROC, "unknown type")
    simulator.refuse(cancels, "")  # so that the chassis does not execute it
    simulator.mute(cancels)
    goal.cancel()
    simulator.wait_received(cancels, sent)
    if lost == "link":
        simulator.drop()
    wait_polled(simulator, kind, 6)
    assert simulator.counts[cancels] == sent
    simulator.accept(cancels)
    remove()
    simulator.accept(TASK_PROC)
    assert goal.result()[0] == CANCELED
    assert simulator.counts[cancels] == sent + 1
