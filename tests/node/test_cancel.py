"""Cancelling goals, with the cancel request, the chassis's answers and its reports in any order."""

from __future__ import annotations

import threading
from collections.abc import Callable

import pytest
from action_msgs.srv import CancelGoal

from tests.harness import Client, GoalClient, RunningAgent, wait_until
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
    proc,
    set_timing,
    short_task,
    slow_down,
    step,
    task,
)
from woosh_robot_agent.actions.run import REPLACED
from woosh_robot_agent.pb.util import action_pb2 as util_action_pb2
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.simulator.serving.hooks import Outgoing
from woosh_robot_msgs.srv import RobotState

ACTIONS = ("robot/ExecTask", "ros/StepControl", "ros/LiftControl", "ros/LiftControl3")


@pytest.fixture(autouse=True)
def unhurried(agent: RunningAgent, simulator: SimulatorThread) -> None:
    """Let no goal end by itself before it is cancelled."""
    slow_down(simulator)


def begun(goal: GoalClient, state: int) -> GoalClient:
    goal.feedback.wait(lambda fb: fb.state.value == state)
    return goal


def without(*types: str, state: int | None = None) -> Callable[[Outgoing], list[Outgoing]]:
    """Lose pushes of some types, if `state` is given only those with that state."""

    def pass_on(out: Outgoing) -> list[Outgoing]:
        lost = out.type in types and not out.sn and state in (None, getattr(out.body, "state", 0))
        return [] if lost else [out]

    return pass_on


def cancel_everything(client: Client, name: str) -> CancelGoal.Response:
    return client.call(CancelGoal, f"{name}/_action/cancel_goal")


def test_task(client: Client, simulator: SimulatorThread) -> None:
    goal = begun(task(client), EXECUTING)
    assert len(goal.cancel().goals_canceling) == 1
    status, ret = goal.result()
    assert (status, ret.state.value) == (CANCELED, TASK_CANCELED)
    assert simulator.counts[ACTION_ORDER] == 1
    assert simulator.last(ACTION_ORDER).order == util_action_pb2.kCancel


@pytest.mark.parametrize(
    ("start", "member"),
    [
        (lambda client: step(client, 20.0), "step_control"),
        (lambda client: move_base(client, 4.0, EXECUTE), "move_base"),
        (lift, "lift_control"),
        (lambda client: lift3(client, 0.4), "lift_control3"),
    ],
)
def test_action(
    client: Client,
    simulator: SimulatorThread,
    start: Callable[[Client], GoalClient],
    member: str,
) -> None:
    goal = begun(start(client), 2)
    goal.cancel()
    status, ret = goal.result()
    assert (status, ret.state.value) == (CANCELED, -2)
    sent = [each.message for each in simulator.received if each.type == CALL_ACTION]
    assert [getattr(call, member).action for call in sent] == [EXECUTE, CANCEL]


def test_action_before_its_first_report(client: Client, simulator: SimulatorThread) -> None:
    simulator.call(lambda sim: setattr(sim.chassis.actions, "tick", lambda dt: None))
    goal = step(client, 20.0)
    simulator.wait_received(CALL_ACTION)
    goal.cancel()
    assert goal.result()[0] == CANCELED
    assert simulator.counts[FEEDBACKS] == 0, "without asking"


def test_goal_ends_only_when_the_chassis_says_so(
    client: Client, simulator: SimulatorThread
) -> None:
    simulator.intercept(without(TASK_PROC, state=TASK_CANCELED))
    goal = begun(task(client, task_id=4), EXECUTING)
    goal.cancel()
    simulator.wait_received(ACTION_ORDER)
    assert not goal.done
    simulator.push(proc(4, COMPLETED, "had just arrived"))
    assert goal.result()[0] == SUCCEEDED


def test_refused_cancel_can_be_repeated(client: Client, simulator: SimulatorThread) -> None:
    simulator.refuse(ACTION_ORDER, "not on the lift")
    goal = begun(task(client), EXECUTING)
    goal.cancel()
    simulator.wait_received(ACTION_ORDER)
    simulator.accept(ACTION_ORDER)
    assert not goal.done
    goal.cancel()
    assert goal.result()[0] == CANCELED
    assert simulator.counts[ACTION_ORDER] == 2


def test_repeated_before_the_first_answer(client: Client, simulator: SimulatorThread) -> None:
    simulator.refuse(ACTION_ORDER, "not on the lift")
    simulator.delay(ACTION_ORDER, 0.2)
    goal = begun(task(client), EXECUTING)
    goal.cancel()
    simulator.wait_received(ACTION_ORDER)
    simulator.accept(ACTION_ORDER)
    goal.cancel()
    assert goal.result()[0] == CANCELED
    assert simulator.counts[ACTION_ORDER] == 2


def test_refused_cancel_lets_the_goal_succeed(client: Client, simulator: SimulatorThread) -> None:
    simulator.refuse(ACTION_ORDER, "not on the lift")
    goal = begun(task(client), EXECUTING)
    goal.cancel()
    hurry(simulator)
    assert goal.result()[0] == SUCCEEDED


def test_before_the_chassis_answered_the_start(client: Client, simulator: SimulatorThread) -> None:
    """The chassis may still execute another goal, which a cancel would hit."""
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
    simulator.push(proc(4, EXECUTING))  # tells as much as the answer would
    assert goal.result()[0] == CANCELED
    assert simulator.counts[ACTION_ORDER] == 1


def test_of_a_goal_that_is_refused_cancels_nothing(
    client: Client, simulator: SimulatorThread
) -> None:
    other = begun(task(client), EXECUTING)
    simulator.refuse(EXEC_TASK, "busy")
    held = Held(simulator, EXEC_TASK)
    goal = task(client, mark="U5")
    goal.cancel()
    simulator.wait_received(EXEC_TASK, 2)
    held.release()
    assert goal.result()[1].msg == "busy"
    hurry(simulator)
    assert other.result()[0] == SUCCEEDED
    assert simulator.counts[ACTION_ORDER] == 0


def test_of_a_replaced_goal_does_not_hit_the_newer_one(
    client: Client, simulator: SimulatorThread
) -> None:
    old = begun(task(client), EXECUTING)
    remove = simulator.intercept(without(TASK_PROC))
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
def test_races_with_the_end(client: Client, simulator: SimulatorThread, turn: int) -> None:
    hurry(simulator)
    goal = short_task(client, 0.05)
    if turn:
        goal.feedback.wait_count(turn)
    goal.cancel()
    status, ret = goal.result()
    ends = {SUCCEEDED: COMPLETED, CANCELED: TASK_CANCELED}
    assert ret.state.value == ends[status]
    assert short_task(client, 0.1).result()[0] == SUCCEEDED, "nothing is left of the first goal"


def test_after_the_end_does_nothing(client: Client, simulator: SimulatorThread) -> None:
    hurry(simulator)
    goal = short_task(client, 0.05)
    assert goal.result()[0] == SUCCEEDED
    assert not goal.cancel().goals_canceling
    assert simulator.counts[ACTION_ORDER] == 0


def test_unanswered_cancel_ends_with_the_report(client: Client, simulator: SimulatorThread) -> None:
    simulator.mute(ACTION_ORDER)
    goal = begun(task(client), EXECUTING)
    goal.cancel()
    assert goal.result()[0] == CANCELED


def test_lost_report_of_the_cancel_is_found_by_polling(
    client: Client, simulator: SimulatorThread, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_timing(monkeypatch, poll_period=0.3)
    goal = begun(task(client), EXECUTING)
    simulator.intercept(without(TASK_PROC))
    goal.cancel()
    assert goal.result()[0] == CANCELED
    assert simulator.counts[ACTION_ORDER] == 1


def test_while_the_link_is_lost_is_sent_once_when_it_is_back(
    client: Client, simulator: SimulatorThread
) -> None:
    goal = begun(task(client, mark="A23"), EXECUTING)
    simulator.call(lambda sim: sim.chassis.tasks.pause("waits"))
    simulator.stop_listening()
    wait_until(lambda: simulator.connections == 0)
    goal.cancel()
    simulator.listen()
    assert goal.result()[0] == CANCELED
    assert simulator.counts[ACTION_ORDER] == 1


def test_while_the_link_is_lost_of_an_action(client: Client, simulator: SimulatorThread) -> None:
    goal = begun(step(client, 100.0), 2)
    simulator.stop_listening()
    goal.cancel()
    simulator.listen()
    assert goal.result()[0] == CANCELED
    assert simulator.counts[CALL_ACTION] == 2


def test_refused_cancel_is_not_sent_again_after_a_lost_link(
    client: Client, simulator: SimulatorThread
) -> None:
    """A refusal is an answer: it is up to the client to ask again."""
    goal = begun(task(client), EXECUTING)
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


def test_everything_of_one_action(client: Client, simulator: SimulatorThread) -> None:
    goal = begun(task(client), EXECUTING)
    assert len(cancel_everything(client, "robot/ExecTask").goals_canceling) == 1
    assert goal.result()[0] == CANCELED
    assert not cancel_everything(client, "robot/ExecTask").goals_canceling


def test_everything_of_every_action(client: Client, simulator: SimulatorThread) -> None:
    goals = [
        begun(step(client, 20.0), 2),
        begun(lift(client), 2),
        begun(lift3(client, 0.4), 2),
    ]
    for name in ACTIONS:
        cancel_everything(client, name)
    assert [goal.result()[0] for goal in goals] == [CANCELED] * 3
    assert simulator.counts[ACTION_ORDER] == 0


def test_everything_while_a_goal_is_being_replaced(
    client: Client, simulator: SimulatorThread, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_timing(monkeypatch, poll_period=0.5)
    old = begun(task(client), EXECUTING)
    held = Held(simulator, EXEC_TASK)
    remove = simulator.intercept(without(TASK_PROC))
    new = task(client, mark="U5")
    simulator.wait_received(EXEC_TASK, 2)
    assert len(cancel_everything(client, "robot/ExecTask").goals_canceling) == 2
    held.release()
    assert old.result()[0] == ABORTED
    remove()
    assert new.result()[0] == CANCELED
    assert simulator.counts[ACTION_ORDER] == 1


def client_is_served(client: Client) -> bool:
    """Make a round trip through agent and chassis, so that everything before it is done."""
    return client.call(RobotState, "robot/RobotState") is not None
