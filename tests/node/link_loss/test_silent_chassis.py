"""Goals whose chassis keeps the connection, but does not answer."""

from __future__ import annotations

import pytest

from tests.harness import Client, wait_until
from tests.node.goals import (
    ABORTED,
    CANCELED,
    EXECUTING,
    FEEDBACKS,
    SUCCEEDED,
    TASK_PROC,
    pause_task,
    short_task,
    slow_down,
    step,
    task,
)
from tests.node.link_loss.timeouts import medium_timeouts, short_timeouts
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed
from woosh_robot_agent.simulator import SimulatorThread

pytestmark = pytest.mark.usefixtures("agent")


@short_timeouts
def test_goals_end_despite_a_half_open_link(client: Client, simulator: SimulatorThread) -> None:
    """The chassis neither answers nor closes the connection."""
    goal = short_task(client, 1.0)
    goal.feedback.wait(lambda fb: fb.state.value == EXECUTING)
    simulator.inject("half_open")
    new = short_task(client, 2.0)
    status, ret = new.result()
    assert (status, "no answer to the goal" in ret.msg) == (ABORTED, True)
    simulator.clear_faults()
    assert goal.done or goal.result()


@medium_timeouts
@pytest.mark.parametrize("kind", ["task", "action"])
def test_goal_is_aborted_if_the_chassis_hangs(
    client: Client, simulator: SimulatorThread, kind: str
) -> None:
    """It answers pings, which keeps the link, and nothing else."""
    slow_down(simulator)
    goal = task(client, mark="A23") if kind == "task" else step(client, 100.0)
    goal.feedback.wait_count(1)
    simulator.inject("freeze")
    status, ret = goal.result()
    assert status == ABORTED
    assert "does not answer" in ret.msg
    assert "the robot may still be executing it" in ret.msg


@pytest.mark.parametrize("kind", ["task", "action"])
def test_goal_goes_on_if_the_chassis_hung_for_a_while(
    client: Client, simulator: SimulatorThread, kind: str
) -> None:
    goal = task(client) if kind == "task" else step(client, 8.0)
    goal.feedback.wait_count(2)
    asks = TASK_PROC if kind == "task" else FEEDBACKS
    mute = simulator.inject("lose_answer", type=asks, count=1)
    silence = simulator.intercept(lambda out: [out] if out.sn else [])
    wait_until(lambda: not mute.active, "a poll without an answer")
    simulator.wait_received(asks, 2)
    silence()
    assert goal.result()[0] == SUCCEEDED


def test_cancel_is_repeated_only_if_the_goal_still_runs(
    client: Client, simulator: SimulatorThread
) -> None:
    """A cancel of a task names no task, so it could end another client's newer task."""
    goal = task(client, task_id=5)
    goal.feedback.wait(lambda fb: fb.state.value == EXECUTING)
    pause_task(simulator)
    simulator.inject("lose_answer", type="woosh.robot.ActionOrder")
    simulator.refuse("woosh.robot.ActionOrder", "")  # so that the chassis does not execute it
    asked = simulator.counts[TASK_PROC]
    simulator.mute(TASK_PROC)
    goal.cancel()

    def asked_twice() -> bool:
        simulator.push(PoseSpeed())  # the chassis is not silent
        return simulator.counts[TASK_PROC] >= asked + 2

    wait_until(asked_twice)
    assert simulator.counts["woosh.robot.ActionOrder"] == 1
    simulator.accept(TASK_PROC)
    simulator.clear_faults()
    simulator.accept("woosh.robot.ActionOrder")
    assert goal.result()[0] == CANCELED
