"""Actions that the manufacturer's agent lacks: ChargeControl, LiftControl2, NavigationMode."""

from __future__ import annotations

import pytest

from tests.harness import Client, GoalClient, Robot, fill, wait_until
from tests.node.goals import (
    CALL_ACTION,
    CANCELED,
    EXECUTE,
    EXECUTING,
    SUCCEEDED,
    slow_down,
    task,
)
from woosh_robot_agent.pb.robot.robot_pb2 import Battery
from woosh_robot_agent.simulator import SimulatorThread
from woosh_ros_msgs.action import ChargeControl, LiftControl2, NavigationMode

FURTHER_ACTIONS = ("ros/ChargeControl", "ros/LiftControl2", "ros/NavigationMode")
"""Names of the actions that these tests cover."""
CHARGE, LEAVE = 1, 2
RUNNING, DONE, FAILED, CANCELLED = 2, 1, -1, -2
"""States of feedback."""


@pytest.fixture
def robot(shared_robot: Robot) -> Robot:
    """A client of the agent that the tests of this file share, and its new chassis."""
    return shared_robot


def charge(client: Client, mode: int = CHARGE) -> GoalClient:
    goal = fill(ChargeControl.Goal(), arg={"execute_mode": mode, "action": EXECUTE})
    return client.send_goal(ChargeControl, "ros/ChargeControl", goal)


def set_mode(client: Client, max_speed: float = 0.25) -> GoalClient:
    goal = NavigationMode.Goal()
    fill(goal.arg, mode=goal.arg.mode.K_ACCURATE_AVOID, max_speed=max_speed)
    return client.send_goal(NavigationMode, "ros/NavigationMode", goal)


def stand_at_charger(client: Client) -> None:
    assert client.command("robot/InitRobot", pose={"x": -10.8, "y": 0.5, "theta": 3.14}).ok


def battery(simulator: SimulatorThread) -> int:
    return int(simulator.state.info.battery.charge_state)


# ChargeControl and LiftControl2: as the other actions


def test_lift_moves_to_its_height(robot: Robot) -> None:
    goal = fill(LiftControl2.Goal(), arg={"height": 0.1, "action": EXECUTE})
    sent = robot.send_goal(LiftControl2, "ros/LiftControl2", goal)
    status, ret = sent.result()
    assert (status, ret.state.value) == (SUCCEEDED, DONE)
    assert ret.action == "woosh.ros.action.LiftControl2"
    assert [fb.state.value for fb in sent.feedback.messages][-1] == DONE
    assert robot.chassis.state.column == pytest.approx(0.1, abs=0.01)


def test_charging_can_be_cancelled_and_the_charger_left(robot: Robot) -> None:
    assert charge(robot).wait_aborted("charger").state.value == FAILED
    stand_at_charger(robot)
    goal = charge(robot)
    goal.feedback.wait(lambda fb: fb.state.value == RUNNING)
    wait_until(lambda: battery(robot.chassis) == Battery.kAuto, "the charging")
    goal.cancel()
    status, ret = goal.result()
    assert (status, ret.state.value) == (CANCELED, CANCELLED)
    status, ret = charge(robot, LEAVE).result()
    assert (status, ret.action) == (SUCCEEDED, "woosh.ros.action.ChargeControl")
    assert battery(robot.chassis) == Battery.kNot


# NavigationMode: a setting of the navigation under way, which nothing can cancel


def test_navigation_mode_is_set_while_a_task_navigates(robot: Robot) -> None:
    slow_down(robot.chassis)
    task(robot).feedback.wait(lambda fb: fb.state.value == EXECUTING)
    status, ret = set_mode(robot).result()
    assert (status, ret.state.value) == (SUCCEEDED, DONE)
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
    assert goal.wait_aborted("the link was lost before the chassis answered").state.value == FAILED
    assert robot.chassis.counts[CALL_ACTION] == 1
