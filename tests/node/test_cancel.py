"""Cancelling goals, with cancel requests, the chassis's answers and its reports in any order."""

from __future__ import annotations

import threading
from collections.abc import Callable

import pytest
from action_msgs.srv import CancelGoal

from tests.harness import Client, Collector, GoalClient, RunningAgent, wait_until
from tests.node.goals import (
    ABORTED,
    ACTION_ORDER,
    CALL_ACTION,
    CANCEL,
    CANCELED,
    COMPLETED,
    EXEC_TASK,
    EXECUTE,
    EXECUTING,
    FEEDBACKS,
    SUCCEEDED,
    TASK_CANCELED,
    TASK_PROC,
    Held,
    hurry,
    lift,
    lift3,
    move_base,
    pause_task,
    proc,
    set_timing,
    short_task,
    slow_down,
    step,
    task,
)
from woosh_robot_agent.pb.util import action_pb2 as util_action_pb2
from woosh_robot_agent.ros.actions.run import REPLACED
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.simulator.serving.exchange import Outgoing
from woosh_robot_msgs.srv import RobotState

ACTIONS = ("robot/ExecTask", "ros/StepControl", "ros/LiftControl", "ros/LiftControl3")


@pytest.fixture(autouse=True)
def unhurried(agent: RunningAgent, simulator: SimulatorThread) -> None:
    """Slow simulated time down, so that no goal ends before it is cancelled."""
    slow_down(simulator)


def in_state(goal: GoalClient, state: int) -> GoalClient:
    goal.feedback.wait(lambda fb: fb.state.value == state)
    return goal


def losing(*types: str, state: int | None = None) -> Callable[[Outgoing], list[Outgoing]]:
    """Return a filter that drops pushes of some types; with `state`, only those with it."""

    def pass_on(out: Outgoing) -> list[Outgoing]:
        lost = out.type in types and not out.sn and state in (None, getattr(out.body, "state", 0))
        return [] if lost else [out]

    return pass_on


def cancel_everything(client: Client, name: str) -> CancelGoal.Response:
    return client.call(CancelGoal, f"{name}/_action/cancel_goal")


def test_task_can_be_cancelled(client: Client, simulator: SimulatorThread) -> None:
    goal = in_state(task(client), EXECUTING)
    assert len(goal.cancel().goals_canceling) == 1
    status, ret = goal.result()
    assert (status, ret.state.value) == (CANCELED, TASK_CANCELED)
    assert simulator.counts[ACTION_ORDER] == 1
    assert simulator.last(ACTION_ORDER).order == util_action_pb2.kCancel


@pytest.mark.parametrize(
    ("start", "member"),
    [
        (lambda client: step(client, 20.0), "step_control"),
        (lambda client: move_base(client, 4.0), "move_base"),
        (lift, "lift_control"),
        (lambda client: lift3(client, 0.4), "lift_control3"),
    ],
)
def test_action_can_be_cancelled(
    client: Client,
    simulator: SimulatorThread,
    start: Callable[[Client], GoalClient],
    member: str,
) -> None:
    goal = in_state(start(client), 2)
    goal.cancel()
    status, ret = goal.result()
    assert (status, ret.state.value) == (CANCELED, -2)
    sent = [each.message for each in simulator.received if each.type == CALL_ACTION]
    assert [getattr(call, member).action for call in sent] == [EXECUTE, CANCEL]


def test_action_can_be_cancelled_before_its_first_report(
    client: Client, simulator: SimulatorThread
) -> None:
    simulator.call(lambda sim: setattr(sim.chassis.actions, "tick", lambda dt: None))
    goal = step(client, 20.0)
    simulator.wait_received(CALL_ACTION)
    goal.cancel()
    assert goal.result()[0] == CANCELED
    assert simulator.counts[FEEDBACKS] == 0, "the end is known without a poll"


def test_goal_ends_only_when_the_chassis_says_so(
    client: Client, simulator: SimulatorThread
) -> None:
    simulator.intercept(losing(TASK_PROC, state=TASK_CANCELED))
    goal = in_state(task(client, task_id=4), EXECUTING)
    goal.cancel()
    simulator.wait_received(ACTION_ORDER)
    assert not goal.done
    simulator.push(proc(4, COMPLETED, "had just arrived"))
    assert goal.result()[0] == SUCCEEDED


def test_refused_cancel_can_be_repeated(client: Client, simulator: SimulatorThread) -> None:
    simulator.refuse(ACTION_ORDER, "not on the lift")
    goal = in_state(task(client), EXECUTING)
    goal.cancel()
    simulator.wait_received(ACTION_ORDER)
    simulator.accept(ACTION_ORDER)
    assert not goal.done
    goal.cancel()
    assert goal.result()[0] == CANCELED
    assert simulator.counts[ACTION_ORDER] == 2


def test_cancel_can_be_repeated_before_the_first_is_refused(
    client: Client, simulator: SimulatorThread
) -> None:
    simulator.refuse(ACTION_ORDER, "not on the lift")
    simulator.delay(ACTION_ORDER, 0.2)
    goal = in_state(task(client), EXECUTING)
    goal.cancel()
    simulator.wait_received(ACTION_ORDER)
    simulator.accept(ACTION_ORDER)
    goal.cancel()
    assert goal.result()[0] == CANCELED
    assert simulator.counts[ACTION_ORDER] == 2


def test_refused_cancel_lets_the_goal_succeed(
    client: Client, simulator: SimulatorThread, logs: Collector
) -> None:
    simulator.refuse(ACTION_ORDER, "not on the lift")
    goal = in_state(task(client), EXECUTING)
    goal.cancel()
    logs.wait(lambda record: "refused to cancel" in record.getMessage())
    hurry(simulator)
    assert goal.result()[0] == SUCCEEDED
    told = [each for each in logs.messages if ": not on the lift" in each.getMessage()]
    assert [each.name for each in told] == ["woosh_robot_agent.ros.actions.giving_up"]


def test_cancel_waits_until_the_chassis_has_accepted_the_goal(
    client: Client, simulator: SimulatorThread
) -> None:
    """The chassis may still execute another goal, which an early cancel would end."""
    answered = threading.Event()

    def hold(out: Outgoing) -> list[Outgoing]:
        return [out] if answered.is_set() or out.type != TASK_PROC else []

    simulator.intercept(hold)
    simulator.mute(EXEC_TASK)
    goal = task(client, task_id=4)
    simulator.wait_received(EXEC_TASK)
    goal.cancel()
    assert client_is_served(client)
    assert simulator.counts[ACTION_ORDER] == 0
    answered.set()
    simulator.push(proc(4, EXECUTING))  # a report on the goal proves that it was accepted
    assert goal.result()[0] == CANCELED
    assert simulator.counts[ACTION_ORDER] == 1


def test_cancel_of_a_refused_goal_is_not_sent(client: Client, simulator: SimulatorThread) -> None:
    other = in_state(task(client), EXECUTING)
    simulator.refuse(EXEC_TASK, "busy")
    held = Held(simulator, EXEC_TASK)
    goal = task(client, mark="U5")
    goal.cancel()
    simulator.wait_received(EXEC_TASK, 2)
    held.release()
    assert goal.result()[1].msg.startswith("busy")
    hurry(simulator)
    assert other.result()[0] == SUCCEEDED
    assert simulator.counts[ACTION_ORDER] == 0


def test_cancel_of_a_replaced_goal_does_not_hit_the_newer_one(
    client: Client, simulator: SimulatorThread
) -> None:
    old = in_state(task(client), EXECUTING)
    remove = simulator.intercept(losing(TASK_PROC))
    held = Held(simulator, EXEC_TASK)
    new = task(client, mark="U5")
    simulator.wait_received(EXEC_TASK, 2)
    old.cancel()
    held.release()
    assert old.result()[1].msg == REPLACED
    remove()
    hurry(simulator)
    assert new.result()[0] == SUCCEEDED
    assert simulator.counts[ACTION_ORDER] == 0


@pytest.mark.parametrize("turn", range(5))
def test_cancel_near_the_end_of_the_goal_gives_one_result(
    client: Client, simulator: SimulatorThread, turn: int
) -> None:
    hurry(simulator)
    goal = short_task(client, 0.05)
    if turn:
        goal.feedback.wait_count(turn)
    goal.cancel()
    status, ret = goal.result()
    ends = {SUCCEEDED: COMPLETED, CANCELED: TASK_CANCELED}
    assert ret.state.value == ends[status]
    assert short_task(client, 0.1).result()[0] == SUCCEEDED, (
        "the first goal must not affect the next one"
    )


def test_cancel_after_the_end_does_nothing(client: Client, simulator: SimulatorThread) -> None:
    hurry(simulator)
    goal = short_task(client, 0.05)
    assert goal.result()[0] == SUCCEEDED
    assert not goal.cancel().goals_canceling
    assert simulator.counts[ACTION_ORDER] == 0


def test_unanswered_cancel_succeeds_with_the_report(
    client: Client, simulator: SimulatorThread
) -> None:
    simulator.mute(ACTION_ORDER)
    goal = in_state(task(client), EXECUTING)
    goal.cancel()
    assert goal.result()[0] == CANCELED


def test_lost_report_of_a_cancel_is_found_by_polling(
    client: Client, simulator: SimulatorThread, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_timing(monkeypatch, poll_period=0.3)
    goal = in_state(task(client), EXECUTING)
    simulator.intercept(losing(TASK_PROC))
    goal.cancel()
    assert goal.result()[0] == CANCELED
    assert simulator.counts[ACTION_ORDER] == 1


def test_cancel_of_a_task_without_a_link_is_sent_once_when_it_is_back(
    client: Client, simulator: SimulatorThread
) -> None:
    goal = in_state(task(client, mark="A23"), EXECUTING)
    pause_task(simulator)
    simulator.stop_listening()
    wait_until(lambda: simulator.connections == 0)
    goal.cancel()
    simulator.listen()
    assert goal.result()[0] == CANCELED
    assert simulator.counts[ACTION_ORDER] == 1


def test_cancel_of_an_action_without_a_link_is_sent_once_when_it_is_back(
    client: Client, simulator: SimulatorThread
) -> None:
    goal = in_state(step(client, 100.0), 2)
    simulator.stop_listening()
    goal.cancel()
    simulator.listen()
    assert goal.result()[0] == CANCELED
    assert simulator.counts[CALL_ACTION] == 2


def test_refused_cancel_is_not_sent_again_after_a_lost_link(
    client: Client, simulator: SimulatorThread
) -> None:
    """A refusal is an answer, so only the client may repeat the cancel."""
    goal = in_state(task(client), EXECUTING)
    simulator.refuse(ACTION_ORDER, "later")
    goal.cancel()
    simulator.wait_received(ACTION_ORDER)
    client_is_served(client)
    connected = simulator.counts["woosh.robot.RobotInfo"]
    simulator.drop()
    simulator.wait_received("woosh.robot.RobotInfo", connected + 1)
    hurry(simulator)
    assert goal.result()[0] == SUCCEEDED
    assert simulator.counts[ACTION_ORDER] == 1


def test_all_goals_of_one_action_can_be_cancelled_at_once(
    client: Client, simulator: SimulatorThread
) -> None:
    goal = in_state(task(client), EXECUTING)
    assert len(cancel_everything(client, "robot/ExecTask").goals_canceling) == 1
    assert goal.result()[0] == CANCELED
    assert not cancel_everything(client, "robot/ExecTask").goals_canceling


def test_goals_of_every_action_can_be_cancelled_at_once(
    client: Client, simulator: SimulatorThread
) -> None:
    goals = [
        in_state(step(client, 20.0), 2),
        in_state(lift(client), 2),
        in_state(lift3(client, 0.4), 2),
    ]
    for name in ACTIONS:
        cancel_everything(client, name)
    assert [goal.result()[0] for goal in goals] == [CANCELED] * 3
    assert simulator.counts[ACTION_ORDER] == 0


def test_all_goals_can_be_cancelled_while_one_replaces_another(
    client: Client, simulator: SimulatorThread, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_timing(monkeypatch, poll_period=0.5)
    old = in_state(task(client), EXECUTING)
    held = Held(simulator, EXEC_TASK)
    remove = simulator.intercept(losing(TASK_PROC))
    new = task(client, mark="U5")
    simulator.wait_received(EXEC_TASK, 2)
    assert len(cancel_everything(client, "robot/ExecTask").goals_canceling) == 2
    held.release()
    assert old.result()[0] == ABORTED
    remove()
    assert new.result()[0] == CANCELED
    assert simulator.counts[ACTION_ORDER] == 1


def client_is_served(client: Client) -> bool:
    """Call a service; its answer shows that the agent has handled everything sent earlier."""
    return client.call(RobotState, "robot/RobotState") is not None
