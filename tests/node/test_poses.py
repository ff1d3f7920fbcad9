"""initialpose and goal_pose, as sent by RViz, and cancel."""

from __future__ import annotations

import math
from typing import Any

import pytest
from action_msgs.srv import CancelGoal
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from std_srvs.srv import Trigger

from tests.harness import Client, wait_until
from tests.node.goals import SUCCEEDED, move_base, replace_answers
from tests.node.nav2.goals import pose
from woosh_robot_agent.pb.ros.action_pb2 import kCancel
from woosh_robot_agent.simulator import SimulatorThread

CALL_ACTION = "woosh.ros.CallAction"
SET_POSE = "woosh.robot.SetRobotPose"


class Sender:
    """Publishes like the tools of RViz."""

    def __init__(self, client: Client) -> None:
        self.publishers = {
            "initialpose": client.publisher(PoseWithCovarianceStamped, "initialpose"),
            "goal_pose": client.publisher(PoseStamped, "goal_pose"),
        }

    def initialpose(self, x: float, y: float, yaw: float, frame: str = "map") -> None:
        there = pose(x, y, yaw, frame)
        message = PoseWithCovarianceStamped(header=there.header)
        message.pose.pose = there.pose
        self.publishers["initialpose"].publish(message)

    def goal_pose(self, x: float, y: float, yaw: float, frame: str = "map") -> None:
        self.publishers["goal_pose"].publish(pose(x, y, yaw, frame))


@pytest.fixture
def sender(agent: Any, client: Client) -> Sender:
    return Sender(client)


def at(simulator: SimulatorThread, x: float, y: float, yaw: float) -> bool:
    here = simulator.state.pose
    return (here.x, here.y, here.theta) == pytest.approx((x, y, yaw), abs=0.02)


class TestInitialpose:
    def test_it_sets_the_pose_and_what_is_wrong_is_logged(self, simulator, sender, logs):
        message = PoseWithCovarianceStamped()
        message.header.frame_id = "map"
        orientation = message.pose.pose.orientation
        for size in (0.0, 1e18):
            orientation.x = orientation.y = orientation.z = orientation.w = size
            sender.publishers["initialpose"].publish(message)
            logs.wait_text("not a unit quaternion", level="ERROR")
            logs.messages.clear()
        for x in (math.nan, math.inf, 1e308):
            sender.initialpose(x, 1.5, 0.0)
            logs.wait_text("not finite", level="ERROR")
            logs.messages.clear()
        sender.initialpose(1.0, 1.5, 0.0, frame="odom")
        logs.wait_text("set the fixed frame to map", level="ERROR")
        assert simulator.counts[SET_POSE] == 0
        sender.initialpose(1.0, 1.5, 2.0)
        wait_until(lambda: at(simulator, 1.0, 1.5, 2.0))
        sender.initialpose(500.0, 0.0, 0.0)
        logs.wait_text("refused initialpose", level="ERROR")
        replace_answers(simulator, SET_POSE, ok=False, msg="")
        sender.initialpose(1.0, 1.5, 2.0)
        logs.wait_text(": refused without a reason", level="ERROR")


class TestGoalPose:
    def test_it_drives_there_and_the_next_goal_replaces_it(self, simulator, sender, logs):
        sender.goal_pose(-8.0, 8.0, 0.5)
        simulator.wait_received(CALL_ACTION)
        sender.goal_pose(5.0, -6.8, 0.5)
        wait_until(lambda: at(simulator, 5.0, -6.8, 0.5))
        logs.wait(lambda r: r.getMessage() == "goal_pose was reached")
        assert not any("replaced" in each.getMessage() for each in logs.messages)
        sender.goal_pose(500.0, 0.0, 0.0)
        logs.wait(lambda r: r.getMessage().startswith("goal_pose was not reached: no "))

    def test_cancel_ends_it(self, simulator, sender, client):
        assert not client.call(Trigger, "cancel").success
        sender.goal_pose(-8.0, 8.0, 0.5)
        simulator.wait_received(CALL_ACTION)
        assert client.call(Trigger, "cancel").success
        wait_until(lambda: not client.call(Trigger, "cancel").success)
        wait_until(lambda: simulator.state.velocity.forward == 0)

    def test_it_is_no_goal_of_the_action_but_a_cancel_order_of_the_action_ends_it(
        self, simulator, sender, client, logs
    ):
        sender.goal_pose(-8.0, 8.0, 0.5)
        simulator.wait_received(CALL_ACTION)
        assert not client.call(CancelGoal, "ros/MoveBase/_action/cancel_goal").goals_canceling
        wait_until(lambda: simulator.state.velocity.forward > 0)
        assert simulator.counts[CALL_ACTION] == 1
        assert move_base(client, 0.0, action=kCancel).result()[0] == SUCCEEDED
        logs.wait_text("goal_pose was not reached: cancelled")
        wait_until(lambda: simulator.state.velocity.forward == 0)

    @pytest.mark.parametrize("is_cancelled", [True, False])
    def test_a_goal_whose_successor_was_refused_can_be_cancelled_and_its_failure_is_logged(
        self, simulator, sender, client, logs, is_cancelled
    ):
        sender.goal_pose(-8.0, 8.0, 0.5)
        simulator.wait_received(CALL_ACTION)
        simulator.inject("refuse", type=CALL_ACTION, text="not there", count=1)
        sender.goal_pose(5.0, -6.8, 0.5)
        logs.wait_text("goal_pose was not reached: not there")
        if is_cancelled:
            assert client.call(Trigger, "cancel").success
            wait_until(lambda: not client.call(Trigger, "cancel").success)
        else:
            logs.messages.clear()
            simulator.set_emergency_stop(True)
            logs.wait_text("goal_pose was not reached")

    def test_a_message_that_was_left_blank_moves_nothing(self, simulator, sender, logs):
        sender.goal_pose(1.0, 1.5, 0.0, frame="odom")
        logs.wait_text("set the fixed frame to map")
        sender.publishers["goal_pose"].publish(PoseStamped())
        logs.wait_text("goal_pose is ignored: the pose has no frame: set header.frame_id to map")
        sender.publishers["initialpose"].publish(PoseWithCovarianceStamped())
        logs.wait_text("initialpose is ignored: the pose has no frame")
        assert simulator.counts[CALL_ACTION] == simulator.counts["woosh.robot.SetRobotPose"] == 0
