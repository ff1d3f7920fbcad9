"""Both executors behave alike: services, topics, goals, cancellation and shutdown."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable

import pytest

from tests.harness import TIMEOUT, Client, RunningAgent, wait_future, wait_until
from tests.node.goals import (
    ABORTED,
    CALL_ACTION,
    CANCELED,
    EXECUTING,
    START,
    SUCCEEDED,
    Held,
    hurry,
    lift,
    lift3,
    move_base,
    short_task,
    slow_down,
    step,
    task,
)
from woosh_robot_agent.agent import _spin_once
from woosh_robot_agent.parameters import EXECUTORS
from woosh_robot_agent.ros.actions.run import REPLACED, STOPPING
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_msgs.msg import PoseSpeed as PoseSpeedMsg
from woosh_robot_msgs.msg import TaskProc as TaskProcMsg
from woosh_robot_msgs.srv import Mode, PoseSpeed


@pytest.fixture(params=EXECUTORS)
def agent(
    request: pytest.FixtureRequest,
    simulator: SimulatorThread,
    start_agent: Callable[..., RunningAgent],
) -> RunningAgent:
    started = start_agent(
        ip="127.0.0.1",
        port=simulator.port,
        backoff_min=0.1,
        executor=request.param,
        result_timeout=3,
    )
    started.wait_connected()
    return started


pytestmark = pytest.mark.usefixtures("agent")


def test_concurrent_service_calls_are_answered(client: Client) -> None:
    calls = [client.call_async(Mode, "robot/Mode") for _ in range(200)]
    calls += [client.call_async(PoseSpeed, "robot/PoseSpeed") for _ in range(40)]
    for call in calls:
        assert wait_future(call) is not None


def test_deferred_replies_overtake_each_other(client: Client, simulator: SimulatorThread) -> None:
    held = Held(simulator, "woosh.robot.Mode")
    slow = client.call_async(Mode, "robot/Mode")
    simulator.wait_received("woosh.robot.Mode")
    client.call(PoseSpeed, "robot/PoseSpeed")
    assert not slow.done()
    held.release()
    assert wait_future(slow).info.ctrl.value == 1


def test_pushes_are_published(client: Client, simulator: SimulatorThread) -> None:
    poses = client.echo(PoseSpeedMsg, "robot/PoseSpeed")
    tasks = client.echo(TaskProcMsg, "robot/TaskProc")
    poses.wait_count(1)
    goal = short_task(client, 0.3)
    assert goal.result()[0] == SUCCEEDED
    tasks.wait(lambda proc: proc.state.value == EXECUTING)
    poses.wait(lambda pose: pose.pose.x > START[0] + 0.28)


def test_goals_succeed(client: Client) -> None:
    assert short_task(client, 0.3).result()[0] == SUCCEEDED
    goals = [step(client, 0.3), lift(client)]
    assert [goal.result()[0] for goal in goals] == [SUCCEEDED, SUCCEEDED]
    assert move_base(client, 0.5).result()[0] == SUCCEEDED
    assert all(goal.feedback.wait_count(1) for goal in goals)


def test_goals_can_be_cancelled_or_a_cancel_refused(
    client: Client, simulator: SimulatorThread
) -> None:
    slow_down(simulator)
    goals = [step(client, 30.0), lift(client)]
    for goal in goals:
        goal.feedback.wait_count(1)
        assert len(goal.cancel().goals_canceling) == 1
    assert [goal.result()[0] for goal in goals] == [CANCELED, CANCELED]
    simulator.refuse("woosh.robot.ActionOrder", "no")
    hurry(simulator)
    refused = short_task(client, 0.3)
    refused.cancel()
    assert refused.result()[0] == SUCCEEDED


def test_goals_are_refused_and_replaced(client: Client, simulator: SimulatorThread) -> None:
    assert task(client, mark="nowhere").result()[0] == ABORTED
    slow_down(simulator)
    old, new = task(client), task(client, mark="U5")
    assert old.result()[1].msg == REPLACED
    hurry(simulator)
    assert new.result()[0] == SUCCEEDED


def test_goal_is_aborted_by_a_lost_link(
    client: Client, simulator: SimulatorThread, agent: RunningAgent
) -> None:
    slow_down(simulator)
    goal = task(client, mark="A23")
    goal.feedback.wait(lambda fb: fb.state.value == EXECUTING)
    simulator.stop_listening()
    status, ret = goal.result()
    assert (status, "link was lost" in ret.msg) == (ABORTED, True)
    simulator.listen()
    hurry(simulator)
    agent.wait_connected(times=2)
    assert step(client, 0.1).result()[0] == SUCCEEDED


def test_result_is_kept_for_late_clients_until_the_timeout(client: Client) -> None:
    goal = step(client, 0.2)
    assert goal.result()[0] == SUCCEEDED

    def ask_again() -> int:
        return int(wait_future(goal.ask_result()).status)

    assert ask_again() == SUCCEEDED
    wait_until(lambda: ask_again() == 0, "the result to expire")
    assert step(client, 0.2).result()[0] == SUCCEEDED


def test_other_clients_are_served_after_one_vanishes(
    client: Client, simulator: SimulatorThread, domain: int
) -> None:
    """Clients leave while goals are running and responses are pending."""
    simulator.delay("woosh.robot.Mode", 0.2)
    gone = Client(domain)
    step(gone, 3.0)
    gone.call_async(Mode, "robot/Mode")
    gone.close()
    status, ret = step(client, 0.2).result()
    assert status == SUCCEEDED, ret
    assert client.call(Mode, "robot/Mode").info.ctrl.value == 1


def test_goal_during_shutdown_is_aborted(
    agent: RunningAgent, client: Client, simulator: SimulatorThread
) -> None:
    agent.agent.robot.thread.run(agent.agent.actions.stop(), TIMEOUT)
    status, ret = step(client, 0.2).result()
    assert (status, ret.msg) == (ABORTED, STOPPING)
    assert simulator.counts[CALL_ACTION] == 0


def test_shutdown_leaves_nothing_in_the_graph(agent: RunningAgent, client: Client) -> None:
    """An EventsExecutor keeps its entities alive until it is shut down."""
    mode = client.service(Mode, "robot/Mode")
    agent.close()
    wait_until(lambda: not mode.service_is_ready(), "the end of a service")
    wait_until(lambda: not client.publishers("robot/PoseSpeed"), "the end of a publisher")


def test_agent_can_be_restarted_with_open_goals(
    agent: RunningAgent,
    client: Client,
    simulator: SimulatorThread,
    start_agent: Callable[..., RunningAgent],
) -> None:
    slow_down(simulator)
    goals = [step(client, 100.0), lift3(client, 0.4, speed=0.001)]
    for goal in goals:
        goal.feedback.wait_count(1)
    agent.close()
    for goal in goals:
        status, ret = goal.result()
        assert (status, "stopping" in ret.msg) == (ABORTED, True)
    wait_until(lambda: simulator.connections == 0)
    start_agent(ip="127.0.0.1", port=simulator.port, executor=agent.agent.settings.executor)

    def status_of_the_old_goal() -> int | None:
        """Response of the new agent, or None if it has not been discovered yet."""
        asked = goals[0].ask_result()
        with contextlib.suppress(AssertionError):
            return int(wait_future(asked, 0.5).status)
        return None

    wait_until(lambda: status_of_the_old_goal() == 0)
    wait_until(lambda: client.call(Mode, "robot/Mode").info.ctrl.value)
    hurry(simulator)
    status, ret = step(client, 0.2).result()
    assert status == SUCCEEDED, ret


def test_error_in_a_callback_does_not_end_the_program(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(logging.getLogger("woosh_robot_agent"), "propagate", True)

    class Failing:
        def spin_once(self, timeout_sec: float) -> None:
            raise RuntimeError("mistake")

    _spin_once(Failing(), 0.0)
    assert "mistake" in caplog.text
