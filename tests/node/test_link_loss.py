"""Goals whose link is lost, or whose start request gets no answer."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from tests.harness import Client, GoalClient, RunningAgent, wait_until
from tests.node.goals import (
    ABORTED,
    CALL_ACTION,
    CANCELED,
    EXEC_TASK,
    EXECUTING,
    FEEDBACKS,
    STEP,
    SUCCEEDED,
    TASK_PROC,
    feedbacks,
    hurry,
    move_base,
    proc,
    set_timing,
    short_task,
    slow_down,
    step,
    task,
)
from tests.quick_chassis import quick_config
from woosh_robot_agent.actions.events import Event, Tick
from woosh_robot_agent.actions.phase import Phase
from woosh_robot_agent.actions.run import GoalRun
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed
from woosh_robot_agent.simulator import SimulatorThread

pytestmark = pytest.mark.usefixtures("agent")


SHORT = {"goal_link_timeout": 0.8, "poll_timeout": 300}
"""Timeouts with which a goal is given up soon."""
MEDIUM = {"goal_link_timeout": 3.0, "poll_timeout": 1000}
"""Timeouts with which a goal is given up, but not before the test makes the chassis hang."""


@pytest.fixture
def timeouts() -> dict[str, Any]:
    """Timeouts long enough for a slow machine to find the link and the goal again."""
    return {"goal_link_timeout": 10.0, "poll_timeout": 1000}


@pytest.fixture
def agent(
    simulator: SimulatorThread,
    start_agent: Callable[..., RunningAgent],
    timeouts: dict[str, Any],
) -> RunningAgent:
    """The agent, connected, with short back-offs."""
    started = start_agent(
        ip="127.0.0.1",
        port=simulator.port,
        backoff_min=0.1,
        backoff_max=0.1,
        **timeouts,
    )
    started.wait_connected()
    return started


@pytest.fixture(autouse=True)
def frequent_polls(monkeypatch: pytest.MonkeyPatch) -> None:
    set_timing(monkeypatch, poll_period=0.6)


def pause(simulator: SimulatorThread) -> None:
    simulator.call(lambda sim: sim.chassis.tasks.pause("waits"))


def switch_off(simulator: SimulatorThread) -> None:
    simulator.stop_listening()
    wait_until(lambda: simulator.connections == 0)


# The link is lost and comes back


@pytest.mark.parametrize("kind", ["task", "action"])
def test_goal_goes_on_after_a_reconnect(
    client: Client, simulator: SimulatorThread, kind: str
) -> None:
    slow_down(simulator)
    goal = task(client) if kind == "task" else step(client, 8.0)
    goal.feedback.wait_count(3)
    known = simulator.counts["woosh.robot.RobotInfo"]
    simulator.drop()
    simulator.wait_received("woosh.robot.RobotInfo", known + 1)
    count = len(goal.feedback.messages)
    hurry(simulator)
    goal.feedback.wait_count(count + 1)
    assert goal.result()[0] == SUCCEEDED
    assert simulator.counts[EXEC_TASK] + simulator.counts[CALL_ACTION] == 1, "nothing is replayed"


def test_goal_goes_on_after_repeated_losses(client: Client, simulator: SimulatorThread) -> None:
    slow_down(simulator)
    goal = task(client)
    goal.feedback.wait(lambda fb: fb.state.value == EXECUTING)
    pause(simulator)
    for _ in range(4):
        known = simulator.counts[TASK_PROC]
        simulator.drop()
        simulator.wait_received(TASK_PROC, known + 1)
    simulator.call(lambda sim: sim.chassis.tasks.resume())
    hurry(simulator)
    assert goal.result()[0] == SUCCEEDED


def test_task_that_ended_without_a_link_succeeds(
    client: Client, simulator: SimulatorThread
) -> None:
    goal = short_task(client, 1.0)
    goal.feedback.wait(lambda fb: fb.state.value == EXECUTING)
    switch_off(simulator)
    wait_until(lambda: not simulator.call(lambda sim: sim.chassis.tasks.active))
    simulator.listen()
    assert goal.result()[0] == SUCCEEDED


def test_end_of_a_task_before_the_current_one_is_found_in_the_history(
    client: Client, simulator: SimulatorThread
) -> None:
    slow_down(simulator)
    goal = task(client, task_id=5)
    goal.feedback.wait(lambda fb: fb.state.value == EXECUTING)
    switch_off(simulator)
    simulator.call(lambda sim: sim.chassis.tasks.cancel("at the screen"))
    simulator.call(lambda sim: setattr(sim.chassis.tasks, "proc", proc(6, EXECUTING)))
    simulator.listen()
    status, ret = goal.result()
    assert (status, ret.robot_task_id, ret.msg) == (ABORTED, 5, "at the screen")
    assert simulator.counts["woosh.robot.TaskHistory"] == 1


def test_action_that_ended_without_a_link_succeeds(
    client: Client, simulator: SimulatorThread
) -> None:
    goal = step(client, 2.0)
    goal.feedback.wait(lambda fb: fb.state.value == 2)
    switch_off(simulator)
    wait_until(lambda: simulator.call(lambda sim: sim.chassis.actions.last[STEP].state == 1))
    simulator.listen()
    status, ret = goal.result()
    assert (status, ret.state.value) == (SUCCEEDED, 1)


def test_task_unknown_to_the_chassis_is_aborted(client: Client, simulator: SimulatorThread) -> None:
    goal = task(client)
    goal.feedback.wait(lambda fb: fb.state.value == EXECUTING)
    port = simulator.port
    switch_off(simulator)
    with SimulatorThread(quick_config(port=port, tcp_port=0)):
        status, ret = goal.result()
    assert status == ABORTED
    assert "does not know the task" in ret.msg


@pytest.mark.parametrize("timeouts", [SHORT], ids=["short"])
def test_action_unknown_to_the_chassis_is_aborted(
    client: Client, simulator: SimulatorThread
) -> None:
    goal = move_base(client, 4.0)
    goal.feedback.wait(lambda fb: fb.state.value == 2)
    port = simulator.port
    switch_off(simulator)
    with SimulatorThread(quick_config(port=port, tcp_port=0)):
        status, ret = goal.result()
    assert (status, ret.state.value) == (ABORTED, -1)
    assert "link was lost" in ret.msg


def test_goal_goes_on_with_reports_though_polls_are_refused(
    client: Client, simulator: SimulatorThread
) -> None:
    simulator.refuse(FEEDBACKS, "unknown type")
    slow_down(simulator)
    goal = step(client, 15.0)
    goal.feedback.wait(lambda fb: fb.state.value == 2)
    known = simulator.counts["woosh.robot.RobotInfo"]
    simulator.drop()
    simulator.wait_received("woosh.robot.RobotInfo", known + 1)
    hurry(simulator)
    assert goal.result()[0] == SUCCEEDED


# The link does not come back


@pytest.mark.parametrize("timeouts", [SHORT], ids=["short"])
@pytest.mark.parametrize("kind", ["task", "action"])
def test_goal_is_aborted_if_the_link_stays_lost(
    client: Client, simulator: SimulatorThread, kind: str
) -> None:
    slow_down(simulator)
    goal = task(client, mark="A23") if kind == "task" else step(client, 100.0)
    goal.feedback.wait_count(1)
    simulator.stop_listening()
    status, ret = goal.result()
    assert status == ABORTED
    assert "link was lost" in ret.msg
    assert "0.8 s" in ret.msg
    assert ret.state.value == (9 if kind == "task" else -1)


def test_new_goal_without_a_link_is_aborted_and_not_sent_later(
    client: Client, simulator: SimulatorThread
) -> None:
    switch_off(simulator)
    status, ret = task(client).result()
    assert status == ABORTED
    assert "not connected to ws://127.0.0.1" in ret.msg
    simulator.listen()
    simulator.wait_received("woosh.robot.RobotInfo", 2)
    assert simulator.counts[EXEC_TASK] == 0


# The answer to the start is lost


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
    slow_down(simulator)  # an end found by the first poll might be that of an earlier goal
    goal = task(client) if kind == "task" else step(client, 8.0)
    simulator.wait_received(TASK_PROC if kind == "task" else FEEDBACKS)
    hurry(simulator)
    assert goal.result()[0] == SUCCEEDED


@pytest.mark.parametrize("timeouts", [SHORT], ids=["short"])
@pytest.mark.parametrize("kind", ["task", "action"])
def test_goal_that_never_arrived_is_aborted(
    client: Client, simulator: SimulatorThread, kind: str
) -> None:
    for name in (EXEC_TASK, CALL_ACTION):
        simulator.refuse(name, "")  # so that the chassis does not execute it
        simulator.mute(name)
    status, ret = (task(client) if kind == "task" else step(client, 1.0)).result()
    assert status == ABORTED
    assert "no answer to the goal" in ret.msg
    assert "did not answer" in ret.msg


@pytest.mark.parametrize("timeouts", [SHORT], ids=["short"])
@pytest.mark.parametrize("kind", ["task", "action"])
def test_goal_that_never_arrived_does_not_get_the_end_of_an_earlier_one(
    client: Client, simulator: SimulatorThread, kind: str
) -> None:
    """Both have the same name, and the chassis reports the end of the earlier one under it."""

    def start() -> GoalClient:
        return short_task(client, 0.2, task_id=3) if kind == "task" else step(client, 0.3)

    assert start().result()[0] == SUCCEEDED
    for name in (EXEC_TASK, CALL_ACTION):
        simulator.refuse(name, "")
        simulator.mute(name)
    status, ret = start().result()
    assert (status, "no answer to the goal" in ret.msg) == (ABORTED, True)


@pytest.mark.parametrize("timeouts", [SHORT], ids=["short"])
def test_newer_action_that_never_arrived_does_not_replace_the_older_one(
    client: Client, simulator: SimulatorThread
) -> None:
    old = step(client, 100.0)
    old.feedback.wait(lambda fb: fb.state.value == 2)
    simulator.refuse(CALL_ACTION, "")
    simulator.mute(CALL_ACTION)
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


@pytest.mark.parametrize("timeouts", [SHORT], ids=["short"])
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


@pytest.mark.parametrize("timeouts", [MEDIUM], ids=["medium"])
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
    pause(simulator)
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
