"""The actions of woosh.ros.CallAction (steps, lifts and paths), and pause, resume and cancel."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from tests.harness import Client, GoalClient, Robot, fill, wait_until
from tests.node.goals import (
    ABORTED,
    CALL_ACTION,
    CANCEL,
    CANCELED,
    EXECUTE,
    EXECUTING,
    PAUSE,
    RESUME,
    STEP,
    SUCCEEDED,
    feedbacks,
    hurry,
    lift,
    lift3,
    move_base,
    slow_down,
    step,
    task,
)
from woosh_robot_agent.pb.robot.robot_pb2 import Battery
from woosh_robot_agent.pb.ros.ros_pack_pb2 import Feedbacks
from woosh_robot_agent.simulator.serving.exchange import Outgoing
from woosh_robot_msgs.srv import RobotState
from woosh_ros_msgs.action import ChargeControl, LiftControl2, NavigationMode, StepControl
from woosh_ros_msgs.msg import StepControlStep


@pytest.fixture
def robot(shared_robot: Robot) -> Robot:
    """A client of the agent that the tests of this file share, and its new chassis."""
    return shared_robot


def running(client: Client, value: float = 500.0) -> GoalClient:
    """Start a long step and wait until it runs."""
    goal = step(client, value)
    goal.feedback.wait(lambda fb: fb.state.value == 2)
    return goal


@pytest.mark.parametrize(("state", "status"), [(1, SUCCEEDED), (-1, ABORTED), (5, ABORTED)])
def test_goal_ends_with_the_state_and_text_of_the_chassis(
    robot: Robot, state: int, status: int
) -> None:
    goal = running(robot)
    robot.chassis.push(feedbacks(state, "as it is"))
    ended, ret = goal.result()
    assert (ended, ret.state.value, ret.msg, ret.action) == (status, state, "as it is", STEP)


def test_states_before_the_end_are_feedback_and_other_reports_are_ignored(robot: Robot) -> None:
    goal = running(robot)
    for state in (3, 4, 10, 2):
        robot.chassis.push(feedbacks(state, f"state {state}"))
        goal.feedback.wait(lambda fb, state=state: fb.msg == f"state {state}")
    robot.chassis.push(feedbacks(100, "wifi"))
    robot.chassis.push(feedbacks(101, "{}"))
    robot.chassis.push(feedbacks(-1, "failed", "woosh.ros.action.MoveBase"))
    assert not goal.done
    robot.chassis.push(feedbacks(1, "the end"))
    assert goal.result()[1].msg == "the end"
    goal.feedback.wait(lambda fb: fb.msg == "the end")
    assert not {"wifi", "{}", "failed"} & {fb.msg for fb in goal.feedback.messages}


def test_nan_is_not_sent(robot: Robot) -> None:
    ret = step(robot, math.nan).wait_aborted("arg.steps[0].value", "nothing was sent")
    assert ret.state.value == -1
    assert robot.chassis.counts[CALL_ACTION] == 0


# A cancel, which is also what a goal without an action means


def charge_exit(client: Client) -> GoalClient:
    goal = fill(ChargeControl.Goal(), arg={"execute_mode": 2})
    return client.send_goal(ChargeControl, "ros/ChargeControl", goal)


def lift2(client: Client) -> GoalClient:
    goal = fill(LiftControl2.Goal(), arg={"height": 0.1})
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


def test_cancel_moves_nothing_whatever_else_the_goal_contains(robot: Robot) -> None:
    before = robot.chassis.state
    for member, cancel in CANCELS.items():
        goal = cancel(robot)
        status, ret = goal.result()
        assert (status, ret.state.value, HINT in ret.msg) == (ABORTED, -1, True), ret.msg
        assert "not running" in ret.msg
        assert not goal.feedback.messages
        sent = getattr(robot.chassis.last(CALL_ACTION), member)
        assert (sent.action, len(sent.ListFields()) > 0) == (CANCEL, True), "as given"
    after = robot.chassis.state
    assert (after.pose, after.jack, after.column) == (before.pose, before.jack, before.column)


@pytest.mark.parametrize(
    "steps",
    [[StepControlStep()], [StepControlStep(value=math.nan)]],
    ids=["zeros", "a value that must not be sent"],
)
def test_cancel_with_any_command_cancels_the_running_goal(robot: Robot, steps: list[Any]) -> None:
    """A public teleoperation node cancels by a step of zeros."""
    goal = running(robot)
    cancel = StepControl.Goal()
    cancel.arg.steps = steps
    status, ret = robot.send_goal(StepControl, "ros/StepControl", cancel).result()
    assert (status, ret.state.value, HINT in ret.msg) == (SUCCEEDED, 1, True)
    assert robot.chassis.last(CALL_ACTION).step_control.action == CANCEL
    status, ret = goal.result()
    assert (status, ret.state.value) == (ABORTED, -2), "not the client of the goal asked for it"


def test_cancel_that_a_chassis_accepts_although_nothing_runs_is_aborted(robot: Robot) -> None:
    robot.set_goal_timing(cancel_report_timeout=0.2)
    robot.chassis.intercept(lenient)
    assert move_base(robot, 0.5, CANCEL).wait_aborted("reported no end", HINT).state.value == -1


def test_cancel_of_an_action_that_the_agent_does_not_know_succeeds_with_its_end(
    robot: Robot,
) -> None:
    """Another client started it before the agent, and the robot has not reported on it since."""
    robot.chassis.intercept(lenient)
    goal = step(robot, action=CANCEL)
    robot.chassis.wait_received(CALL_ACTION)
    robot.chassis.push(feedbacks(-2, "cancelled"))
    assert goal.result()[0] == SUCCEEDED


def test_goal_goes_on_after_pause_and_resume(robot: Robot) -> None:
    step(robot, action=PAUSE).wait_aborted("not running")
    slow_down(robot.chassis)  # so that it reports once a second
    goal = running(robot, 3.0)
    for order, reported in ((PAUSE, 3), (RESUME, 2)):
        count = len(goal.feedback.messages)
        ordering = step(robot, action=order)
        assert ordering.result()[0] == SUCCEEDED
        assert not ordering.feedback.messages
        goal.feedback.wait_count(count + 1)
        assert goal.feedback.messages[count].state.value == reported
        assert not goal.done
    hurry(robot.chassis)
    assert goal.result()[0] == SUCCEEDED
    sent = [each.message for each in robot.chassis.received if each.type == CALL_ACTION]
    assert [call.step_control.action for call in sent] == [PAUSE, EXECUTE, PAUSE, RESUME]


def test_unanswered_pause_does_not_delay_a_cancel(robot: Robot) -> None:
    goal = running(robot)
    robot.chassis.mute(CALL_ACTION)
    pause = step(robot, action=PAUSE)
    robot.chassis.wait_received(CALL_ACTION, 2)
    goal.cancel()
    assert goal.result()[1].state.value == -2
    assert not pause.done, "the pause still waits for its answer"


@pytest.mark.parametrize("replaced", [False, True])
def test_an_end_that_the_chassis_repeats_does_not_end_the_next_goal(
    robot: Robot, replaced: bool
) -> None:
    first = running(robot) if replaced else step(robot, 0.3)
    if not replaced:
        assert first.result()[0] == SUCCEEDED
    robot.chassis.call(lambda sim: setattr(sim.chassis.actions, "tick", lambda dt: None))
    goal = step(robot, 0.4)
    wait_until(lambda: robot.agent.agent.actions.accepted_goals, "its acceptance")
    first.result()
    end: Any = robot.chassis.call(lambda sim: sim.chassis.actions.last[STEP])
    for _ in range(3):
        robot.chassis.push(Feedbacks(fbs=[end]))
    for _ in range(2):
        robot.call(RobotState, "robot/RobotState")
    assert not goal.done
    robot.chassis.push(feedbacks(2, "on its way"))
    robot.chassis.push(feedbacks(1, "its end"))
    assert goal.result()[1].msg == "its end"


def lenient(out: Outgoing) -> list[Outgoing]:
    """Accept all actions, as a chassis that does not check whether there is one to cancel."""
    refused = out.request == CALL_ACTION and not out.ok
    return [replace(out, ok=True, msg="Request succeed") if refused else out]


def test_last_goal_of_a_burst_wins(robot: Robot) -> None:
    """The ends of all goals that it replaces come before the answer to its start request."""
    robot.chassis.delay(CALL_ACTION, 0.2)
    slow_down(robot.chassis)
    goals = [step(robot, 6.0) for _ in range(3)]  # longer than the delay of the answers
    robot.chassis.wait_received(CALL_ACTION, 3)
    hurry(robot.chassis)
    status, ret = goals[-1].result()
    assert (status, ret.state.value) == (SUCCEEDED, 1)
    assert [goal.result()[0] for goal in goals[:-1]] == [ABORTED] * 2
    assert robot.chassis.counts[CALL_ACTION] == 3


# ChargeControl


def charge(client: Client, mode: int) -> GoalClient:
    """Charge with the mode 1, or leave the charger with the mode 2."""
    goal = fill(ChargeControl.Goal(), arg={"execute_mode": mode, "action": EXECUTE})
    return client.send_goal(ChargeControl, "ros/ChargeControl", goal)


def test_charging_can_be_cancelled_and_the_charger_left(robot: Robot) -> None:
    def charges() -> bool:
        return robot.chassis.state.info.battery.charge_state == Battery.kAuto

    assert charge(robot, 1).wait_aborted("charger").state.value == -1
    at_charger = {"x": -10.8, "y": 0.5, "theta": 3.14}
    assert robot.command("robot/InitRobot", pose=at_charger).ok
    goal = charge(robot, 1)
    wait_until(charges, "the charging")
    goal.cancel()
    status, ret = goal.result()
    assert (status, ret.state.value) == (CANCELED, -2)
    status, ret = charge(robot, 2).result()
    assert (status, ret.action) == (SUCCEEDED, "woosh.ros.action.ChargeControl")
    assert not charges()


# NavigationMode: a setting of the navigation under way, which nothing can cancel


def set_mode(client: Client) -> GoalClient:
    goal = NavigationMode.Goal()
    fill(goal.arg, mode=goal.arg.mode.K_ACCURATE_AVOID, max_speed=0.25)
    return client.send_goal(NavigationMode, "ros/NavigationMode", goal)


def test_navigation_mode_is_set_while_a_task_navigates(robot: Robot) -> None:
    slow_down(robot.chassis)
    task(robot).feedback.wait(lambda fb: fb.state.value == EXECUTING)
    status, ret = set_mode(robot).result()
    assert (status, ret.state.value) == (SUCCEEDED, 1)
    assert ret.action == "woosh.ros.action.NavigationMode"
    sent = robot.chassis.last(CALL_ACTION).nav_mode
    assert (sent.mode, sent.max_speed) == (sent.kAccurateAvoid, 0.25)
    # with all its fields at their defaults, it is not taken for a cancel
    goal = NavigationMode.Goal()
    assert robot.send_goal(NavigationMode, "ros/NavigationMode", goal).result()[0] == SUCCEEDED
    assert robot.chassis.last(CALL_ACTION).WhichOneof("action") == "nav_mode"


def test_a_navigation_mode_without_an_answer_is_aborted_with_the_link(robot: Robot) -> None:
    robot.chassis.mute(CALL_ACTION)
    goal = set_mode(robot)
    robot.chassis.wait_received(CALL_ACTION)
    goal.cancel()  # there is nothing to cancel, and nothing is sent
    robot.chassis.drop()
    assert goal.wait_aborted("the link was lost before the chassis answered").state.value == -1
    assert robot.chassis.counts[CALL_ACTION] == 1
