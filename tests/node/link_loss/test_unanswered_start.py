"""Goals whose start request gets no answer."""

from __future__ import annotations

import pytest

from tests.harness import Client, GoalClient
from tests.node.goals import (
    ABORTED,
    CALL_ACTION,
    EXEC_TASK,
    FEEDBACKS,
    SUCCEEDED,
    TASK_PROC,
    feedbacks,
    hurry,
    set_timing,
    short_task,
    slow_down,
    step,
    task,
)
from tests.node.link_loss.timeouts import short_timeouts
from woosh_robot_agent.ros.actions.goal import Event, Phase, Tick
from woosh_robot_agent.ros.actions.run import GoalRun
from woosh_robot_agent.simulator import SimulatorThread

pytestmark = pytest.mark.usefixtures("agent")


def ignore(simulator: SimulatorThread, *requests: str) -> None:
    """Let the chassis neither execute nor answer requests of these types."""
    for name in requests:
        simulator.refuse(name, "")
        simulator.mute(name)


@pytest.mark.parametrize("kind", ["task", "action"])
def test_goal_goes_on_without_an_answer_to_its_start(
    client: Client, simulator: SimulatorThread, kind: str
) -> None:
    simulator.mute(EXEC_TASK)
    simulator.mute(CALL_ACTION)
    goal = task(client) if kind == "task" else step(client, 10.0)
    assert goal.result()[0] == SUCCEEDED


@pytest.mark.parametrize("kind", ["task", "action"])
def test_unanswered_goal_without_pushes_is_found_by_polling(
    client: Client, simulator: SimulatorThread, kind: str
) -> None:
    simulator.mute(EXEC_TASK)
    simulator.mute(CALL_ACTION)
    simulator.intercept(lambda out: [out] if out.sn else [])
    slow_down(simulator)  # if the first poll found an end, it might be that of an earlier goal
    goal = task(client) if kind == "task" else step(client, 8.0)
    simulator.wait_received(TASK_PROC if kind == "task" else FEEDBACKS)
    hurry(simulator)
    assert goal.result()[0] == SUCCEEDED


@short_timeouts
@pytest.mark.parametrize("kind", ["task", "action"])
def test_goal_that_never_arrived_is_aborted(
    client: Client, simulator: SimulatorThread, kind: str
) -> None:
    ignore(simulator, EXEC_TASK, CALL_ACTION)
    status, ret = (task(client) if kind == "task" else step(client, 1.0)).result()
    assert status == ABORTED
    assert "no answer to the goal" in ret.msg
    assert "did not answer" in ret.msg


@short_timeouts
@pytest.mark.parametrize("kind", ["task", "action"])
def test_goal_that_never_arrived_does_not_get_the_end_of_an_earlier_one(
    client: Client, simulator: SimulatorThread, kind: str
) -> None:
    """Both have the same name, and the chassis reports the end of the earlier one under it."""

    def start() -> GoalClient:
        return short_task(client, 0.2, task_id=3) if kind == "task" else step(client, 0.3)

    assert start().result()[0] == SUCCEEDED
    ignore(simulator, EXEC_TASK, CALL_ACTION)
    status, ret = start().result()
    assert (status, "no answer to the goal" in ret.msg) == (ABORTED, True)


@short_timeouts
def test_newer_action_that_never_arrived_does_not_replace_the_older_one(
    client: Client, simulator: SimulatorThread
) -> None:
    old = step(client, 100.0)
    old.feedback.wait(lambda fb: fb.state.value == 2)
    ignore(simulator, CALL_ACTION)
    status, ret = step(client, 1.0).result()
    assert (status, "no answer to the goal" in ret.msg) == (ABORTED, True)
    assert not old.done
    simulator.push(feedbacks(1, "the end"))
    assert old.result()[0] == SUCCEEDED


def test_goal_is_not_polled_before_its_answer(
    client: Client, simulator: SimulatorThread, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A report before the answer may be on an earlier goal. Waiting must not be a busy loop."""
    set_timing(monkeypatch, poll_period=0.02)
    ticks: list[tuple[Phase, int]] = []

    def asked() -> int:
        return simulator._simulator.counts[FEEDBACKS]

    post = GoalRun.post

    def count_ticks(run: GoalRun, event: Event) -> None:
        if isinstance(event, Tick):
            ticks.append((run.phase, asked()))
        post(run, event)

    monkeypatch.setattr(GoalRun, "post", count_ticks)
    simulator.mute(CALL_ACTION)
    simulator.intercept(lambda out: [out] if out.sn else [])
    slow_down(simulator)
    goal = step(client, 8.0)
    simulator.wait_received(FEEDBACKS)
    hurry(simulator)
    assert goal.result()[0] == SUCCEEDED
    before = [count for phase, count in ticks if phase is Phase.STARTING]
    assert 5 < len(before) < 100, "every 0.02 s for 1 s"
    assert set(before) == {0}
    assert simulator.counts[FEEDBACKS] > 0


def test_goal_goes_on_if_the_link_is_lost_before_its_answer(
    client: Client, simulator: SimulatorThread
) -> None:
    simulator.mute(EXEC_TASK)
    simulator.intercept(lambda out: [] if out.type == TASK_PROC and not out.sn else [out])
    goal = task(client)
    simulator.wait_received(EXEC_TASK)
    simulator.drop()
    assert goal.result()[0] == SUCCEEDED
    assert simulator.counts[EXEC_TASK] == 1
