"""The actions of woosh.ros.CallAction (steps, lifts and paths), and pause, resume and cancel."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import pytest

from tests.harness import Client, GoalClient, wait_until
from tests.node.goals import (
    ABORTED,
    CALL_ACTION,
    CANCEL,
    EXECUTE,
    FEEDBACKS,
    PAUSE,
    RESUME,
    START,
    STEP,
    SUCCEEDED,
    feedbacks,
    hurry,
    lift,
    lift3,
    move_base,
    set_timing,
    slow_down,
    step,
    step_goal,
)
from woosh_common_msgs.msg import Pose2D
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction
from woosh_robot_agent.ros.actions.run import REPLACED
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.simulator.serving.exchange import Outgoing
from woosh_robot_msgs.srv import RobotState
from woosh_ros_msgs.action import ChargeControl, LiftControl2, MoveBase, StepControl
from woosh_ros_msgs.msg import StepControlStep

pytestmark = pytest.mark.usefixtures("agent")


def running(client: Client, value: float = 500.0) -> GoalClient:
    """Start a long step and wait until it runs."""
    goal = step(client, value)
    goal.feedback.wait(lambda fb: fb.state.value == 2)
    return goal


@pytest.mark.parametrize(
    ("start", "name"),
    [
        (lambda client: step(client, 0.3), "StepControl"),
        (lift, "LiftControl"),
        (lambda client: lift3(client, 0.1), "LiftControl3"),
        (lambda client: move_base(client, 0.5), "MoveBase"),
    ],
)
def test_each_action_succeeds_with_feedback(
    client: Client, start: Callable[[Client], GoalClient], name: str
) -> None:
    goal = start(client)
    status, ret = goal.result()
    assert (status, ret.state.value) == (SUCCEEDED, 1)
    assert ret.action == f"woosh.ros.action.{name}"
    assert ret.msg
    goal.feedback.wait(lambda fb: fb.state.value == 1)
    assert goal.feedback.messages[-1].state.value == 1
    assert 2 in [fb.state.value for fb in goal.feedback.messages]


@pytest.mark.parametrize(("state", "status"), [(1, SUCCEEDED), (-1, ABORTED), (5, ABORTED)])
def test_goal_ends_with_the_state_and_text_of_the_chassis(
    client: Client, simulator: SimulatorThread, state: int, status: int
) -> None:
    goal = running(client)
    simulator.push(feedbacks(state, "as it is"))
    ended, ret = goal.result()
    assert (ended, ret.state.value, ret.msg, ret.action) == (status, state, "as it is", STEP)


def test_states_before_the_end_are_feedback(client: Client, simulator: SimulatorThread) -> None:
    goal = running(client)
    for state in (3, 4, 10, 2):
        simulator.push(feedbacks(state, f"state {state}"))
        goal.feedback.wait(lambda fb, state=state: fb.msg == f"state {state}")
    assert not goal.done


def test_reports_on_another_action_are_ignored(client: Client, simulator: SimulatorThread) -> None:
    goal = running(client)
    simulator.push(feedbacks(100, "wifi"))
    simulator.push(feedbacks(101, "{}"))
    simulator.push(feedbacks(-1, "failed", "woosh.ros.action.MoveBase"))
    simulator.push(feedbacks(1, "the end"))
    assert goal.result()[1].msg == "the end"
    goal.feedback.wait(lambda fb: fb.msg == "the end")
    assert not {"wifi", "{}", "failed"} & {fb.msg for fb in goal.feedback.messages}


def test_refusal_reaches_the_client(client: Client, simulator: SimulatorThread) -> None:
    simulator.refuse(CALL_ACTION, "the lift is locked")
    status, ret = lift(client).result()
    assert (status, ret.state.value, ret.msg) == (ABORTED, -1, "the lift is locked")
    assert ret.action == "woosh.ros.action.LiftControl"


def test_nan_is_not_sent(client: Client, simulator: SimulatorThread) -> None:
    status, ret = step(client, math.nan).result()
    assert (status, ret.state.value) == (ABORTED, -1)
    assert "arg.steps[0].value" in ret.msg
    assert "nothing was sent" in ret.msg
    assert simulator.counts[CALL_ACTION] == 0


def test_poses_without_a_target_are_driven_to(client: Client, simulator: SimulatorThread) -> None:
    goal = MoveBase.Goal()
    x, y, theta = START
    goal.arg.poses = [Pose2D(x=x + ahead, y=y, theta=theta) for ahead in (0.2, 0.4)]
    goal.arg.action.value = EXECUTE
    assert client.send_goal(MoveBase, "ros/MoveBase", goal).result()[0] == SUCCEEDED


# A cancel, which is also what a goal without an action means


def charge_exit(client: Client) -> GoalClient:
    goal = ChargeControl.Goal()
    goal.arg.execute_mode.value = 2
    return client.send_goal(ChargeControl, "ros/ChargeControl", goal)


def lift2(client: Client) -> GoalClient:
    goal = LiftControl2.Goal()
    goal.arg.height = 0.1
    return client.send_goal(LiftControl2, "ros/LiftControl2", goal)


CANCELS: dict[str, Callable[[Client], GoalClient]] = {
    "step_control": lambda client: step(client, 0.4, CANCEL),
    "move_base": lambda client: move_base(client, 0.5, CANCEL),
    "lift_control": lambda client: lift(client, action=CANCEL),
    "lift_control2": lift2,
    "lift_control3": lambda client: lift3(client, 0.1, action=CANCEL),
    "charge_control": charge_exit,
}
"""A cancel with a complete command, by the member of CallAction."""
HINT = "action: {value: 1}"


@pytest.mark.parametrize("member", CANCELS)
def test_cancel_moves_nothing_whatever_else_the_goal_contains(
    client: Client, simulator: SimulatorThread, member: str
) -> None:
    before = simulator.state
    goal = CANCELS[member](client)
    status, ret = goal.result()
    assert (status, ret.state.value, HINT in ret.msg) == (ABORTED, -1, True), ret.msg
    assert "not running" in ret.msg
    assert not goal.feedback.messages
    sent = getattr(simulator.last(CALL_ACTION), member)
    assert (sent.action, len(sent.ListFields()) > 0) == (CANCEL, True), "as given"
    after = simulator.state
    assert (after.pose, after.jack, after.column) == (before.pose, before.jack, before.column)


def test_step_of_zeros_with_a_cancel_cancels_the_running_step(
    client: Client, simulator: SimulatorThread
) -> None:
    """A public teleoperation node cancels like this."""
    goal = running(client)
    cancel = StepControl.Goal()
    cancel.arg.steps = [StepControlStep()]
    status, ret = client.send_goal(StepControl, "ros/StepControl", cancel).result()
    assert (status, ret.state.value, HINT in ret.msg) == (SUCCEEDED, 1, True)
    assert simulator.last(CALL_ACTION).step_control.action == CANCEL
    assert len(simulator.last(CALL_ACTION).step_control.steps) == 1
    status, ret = goal.result()
    assert (status, ret.state.value) == (ABORTED, -2), "not the client of the goal asked for it"


def test_cancel_with_a_value_that_must_not_be_sent_cancels(
    client: Client, simulator: SimulatorThread
) -> None:
    goal = running(client)
    assert step(client, math.nan, CANCEL).result()[0] == SUCCEEDED
    assert goal.result()[1].state.value == -2


def test_empty_command_cancels_the_running_goal(client: Client, simulator: SimulatorThread) -> None:
    goal = running(client)
    status, ret = step(client, action=CANCEL).result()
    assert (status, ret.state.value) == (SUCCEEDED, 1)
    assert simulator.last(CALL_ACTION).step_control.action == CANCEL
    assert goal.result()[0] == ABORTED


def test_cancel_that_a_chassis_accepts_although_nothing_runs_is_aborted(
    client: Client, simulator: SimulatorThread, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_timing(monkeypatch, cancel_report_timeout=0.2)
    simulator.intercept(lenient)
    status, ret = move_base(client, 0.5, CANCEL).result()
    assert (status, ret.state.value) == (ABORTED, -1)
    assert "reported no end" in ret.msg
    assert HINT in ret.msg


def test_cancel_of_an_action_that_the_agent_does_not_know_succeeds_with_its_end(
    client: Client, simulator: SimulatorThread
) -> None:
    """Another client started it before the agent, and the robot has not reported on it since."""
    simulator.intercept(lenient)
    goal = step(client, action=CANCEL)
    simulator.wait_received(CALL_ACTION)
    simulator.push(feedbacks(-2, "cancelled"))
    assert goal.result()[0] == SUCCEEDED


def test_cancel_of_a_goal_that_runs_succeeds_with_the_answer(
    client: Client, simulator: SimulatorThread
) -> None:
    running(client)
    simulator.intercept(lambda out: [] if out.type == FEEDBACKS and not out.sn else [out])
    assert step(client, action=CANCEL).result()[0] == SUCCEEDED


def test_goal_goes_on_after_pause_and_resume(client: Client, simulator: SimulatorThread) -> None:
    slow_down(simulator)  # so that it reports once a second
    goal = running(client, 3.0)
    for order, reported in ((PAUSE, 3), (RESUME, 2)):
        count = len(goal.feedback.messages)
        ordering = step(client, action=order)
        assert ordering.result()[0] == SUCCEEDED
        assert not ordering.feedback.messages
        goal.feedback.wait_count(count + 1)
        assert goal.feedback.messages[count].state.value == reported
        assert not goal.done
    hurry(simulator)
    assert goal.result()[0] == SUCCEEDED
    sent = [each.message for each in simulator.received if each.type == CALL_ACTION]
    assert [call.step_control.action for call in sent] == [EXECUTE, PAUSE, RESUME]


def test_pause_without_a_running_goal_is_refused(client: Client) -> None:
    status, ret = step(client, action=PAUSE).result()
    assert (status, "not running" in ret.msg) == (ABORTED, True)


def test_unanswered_pause_does_not_delay_a_cancel(
    client: Client, simulator: SimulatorThread
) -> None:
    goal = running(client)
    simulator.mute(CALL_ACTION)
    pause = step(client, action=PAUSE)
    simulator.wait_received(CALL_ACTION, 2)
    goal.cancel()
    assert goal.result()[1].state.value == -2
    assert not pause.done, "the pause still waits for its answer"


def test_newer_goal_replaces_an_older_one(client: Client, simulator: SimulatorThread) -> None:
    old = running(client)
    new = step(client, 0.4)
    status, ret = old.result()
    assert (status, ret.msg) == (ABORTED, REPLACED)
    assert new.result()[0] == SUCCEEDED
    assert -2 not in [fb.state.value for fb in new.feedback.messages]


def test_late_end_of_an_older_goal_does_not_end_the_newer_one(
    client: Client, simulator: SimulatorThread
) -> None:
    old = running(client)
    remove = simulator.intercept(lambda out: [] if out.type == FEEDBACKS else [out])
    new = step(client, 499.0)
    assert old.result()[1].msg == REPLACED
    remove()
    simulator.push(feedbacks(2, "still the old one"))
    simulator.push(feedbacks(-2, "the old one's end"))
    new.feedback.wait(lambda fb: fb.msg.startswith("step 1"))
    assert not new.done


def test_end_of_another_programs_action_does_not_end_the_goal(
    client: Client, simulator: SimulatorThread
) -> None:
    """The same happens after a restart of the agent."""
    request = CallAction()
    request.step_control.steps.add(mode=1, value=500.0, speed=0.5)
    request.step_control.action = EXECUTE
    simulator.call(lambda sim: dispatched(sim, request))
    goal = step(client, 0.4)
    assert goal.result()[0] == SUCCEEDED


@pytest.mark.parametrize("end", [-2, -1, 1])
def test_last_reports_on_another_programs_action_do_not_end_the_goal(
    client: Client, simulator: SimulatorThread, end: int
) -> None:
    """They come between the start request and its answer."""
    reports = feedbacks(2, "on its way"), feedbacks(end, "its end")

    def report_first(out: Outgoing) -> list[Outgoing]:
        before = reports if out.request == CALL_ACTION else ()
        return [*(Outgoing(FEEDBACKS, report) for report in before), out]

    simulator.intercept(report_first)
    simulator.call(freeze_steps)
    goal = step(client, 0.4)
    goal.feedback.wait(lambda fb: fb.msg == "on its way")
    client.call(RobotState, "robot/RobotState")
    assert not goal.done
    client.call(RobotState, "robot/RobotState")
    simulator.push(feedbacks(1, "the goal's"))
    assert goal.result()[1].msg == "the goal's"


def test_refused_newer_goal_does_not_replace_the_older_one(
    client: Client, simulator: SimulatorThread
) -> None:
    slow_down(simulator)
    old = running(client, 5.0)
    goal = step_goal(1.0)
    goal.arg.steps[0].mode.value = 9
    status, ret = client.send_goal(StepControl, "ros/StepControl", goal).result()
    assert (status, "mode" in ret.msg) == (ABORTED, True)
    hurry(simulator)
    assert old.result()[0] == SUCCEEDED


def test_lost_end_is_found_by_polling(
    client: Client, simulator: SimulatorThread, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_timing(monkeypatch, poll_period=0.3)
    simulator.intercept(
        lambda out: (
            [] if out.type == FEEDBACKS and not out.sn and out.body.fbs[0].state == 1 else [out]
        )
    )
    assert step(client, 0.3).result()[0] == SUCCEEDED
    # the second goal ends with exactly the same report
    assert step(client, 0.3).result()[0] == SUCCEEDED


def test_refused_polls_do_not_end_the_goal(
    client: Client, simulator: SimulatorThread, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_timing(monkeypatch, poll_period=0.05)
    simulator.refuse(FEEDBACKS, "unknown type")
    goal = running(client)
    simulator.wait_received(FEEDBACKS, 2)
    simulator.push(feedbacks(1, "the end"))
    assert goal.result()[1].msg == "the end"


def test_earlier_goals_end_in_a_poll_is_ignored(
    client: Client, simulator: SimulatorThread, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The chassis accepted the goal, and when polled still reports the end of the earlier one."""
    set_timing(monkeypatch, poll_period=0.3)
    assert step(client, 0.3).result()[0] == SUCCEEDED
    dropped = simulator.intercept(lambda out: [] if out.type == FEEDBACKS and not out.sn else [out])
    simulator.call(freeze_steps)
    asked: list[Outgoing] = []

    def answer_once(out: Outgoing) -> list[Outgoing]:
        """Drop all answers but the first: a repeated one would count as the end of this goal."""
        if out.request != FEEDBACKS:
            return [out]
        asked.append(out)
        return [out] if len(asked) == 1 else []

    simulator.intercept(answer_once)
    goal = step(client, 0.3)
    wait_until(lambda: asked, "the poll")
    dropped()
    simulator.push(feedbacks(2, "on its way"))
    goal.feedback.wait(lambda fb: fb.msg == "on its way")
    assert not goal.done


def lenient(out: Outgoing) -> list[Outgoing]:
    """Accept all actions, as a chassis that does not check whether there is one to cancel."""
    refused = out.request == CALL_ACTION and not out.ok
    return [replace(out, ok=True, msg="Request succeed") if refused else out]


def dispatched(sim: object, request: CallAction) -> None:
    from woosh_robot_agent.simulator.protocol.dispatch import dispatch

    dispatch(sim.chassis, request)  # type: ignore[attr-defined]


def freeze_steps(sim: object) -> None:
    """Make the chassis accept actions without executing them."""
    sim.chassis.actions.tick = lambda dt: None  # type: ignore[attr-defined]


@pytest.mark.parametrize("late", [0.0, 0.2])
@pytest.mark.parametrize("count", [3, 8])
def test_last_goal_of_a_burst_wins(
    client: Client, simulator: SimulatorThread, count: int, late: float
) -> None:
    """The ends of all goals that it replaces come before the answer to its start request."""
    simulator.delay(CALL_ACTION, late)
    slow_down(simulator)
    goals = [step(client, 6.0) for _ in range(count)]  # longer than the delay of the answers
    simulator.wait_received(CALL_ACTION, count)
    hurry(simulator)
    status, ret = goals[-1].result()
    assert (status, ret.state.value) == (SUCCEEDED, 1)
    assert [goal.result()[0] for goal in goals[:-1]] == [ABORTED] * (count - 1)
    assert simulator.counts[CALL_ACTION] == count
