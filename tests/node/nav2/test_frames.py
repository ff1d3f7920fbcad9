"""Goal poses in other frames than that of the map."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import pytest
from action_msgs.msg import GoalInfo
from action_msgs.srv import CancelGoal
from geometry_msgs.msg import TransformStamped
from rclpy.qos import DurabilityPolicy, QoSProfile
from unique_identifier_msgs.msg import UUID

from tests.harness import Client, Logs, Robot, RunningAgent, wait_future, wait_until
from tests.node.goals import CALL_ACTION, START, hurry, slow_down
from tests.node.nav2.goals import CANCELED, SUCCEEDED, Nav2Client, ahead, pose
from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction
from woosh_robot_agent.ros.nav2 import frames

pytest.importorskip("nav2_msgs.action")


def transform(
    parent: str,
    child: str,
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0),
    rotation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0),
) -> TransformStamped:
    message = TransformStamped()
    message.header.frame_id, message.child_frame_id = parent, child
    target = message.transform
    target.translation.x, target.translation.y, target.translation.z = shift
    (target.rotation.x, target.rotation.y, target.rotation.z, target.rotation.w) = rotation
    return message


@pytest.fixture
def static(robot: Robot) -> Callable[..., None]:
    """Function that publishes transforms on /tf_static."""
    return publish_static(robot)


def publish_static(robot: Robot) -> Callable[..., None]:
    message = class_of("tf2_msgs/TFMessage")
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publisher = robot.node.create_publisher(message, "/tf_static", latched)
    return lambda *transforms: publisher.publish(message(transforms=list(transforms)))


def target(robot: Robot) -> tuple[float, float, float]:
    """Return the pose to which the chassis was sent last: ahead of START, left of it, heading."""
    commands = [each.message for each in robot.chassis.received if type(each.message) is CallAction]
    there = commands[-1].move_base.target_pose
    x, y, theta = START
    cos, sin = math.cos(theta), math.sin(theta)
    dx, dy = there.x - x, there.y - y
    heading = math.remainder(there.theta - theta, math.tau)
    return cos * dx + sin * dy, cos * dy - sin * dx, heading


def go(client: Client, message: Any) -> Nav2Client:
    return Nav2Client(client, "navigate_to_pose", pose=message)


def near(*numbers: float) -> Any:
    return pytest.approx(numbers, abs=0.01)


class TestFrames:
    def test_the_frames_of_the_robot(self, own_robot: Robot) -> None:
        """The origin of odom is where the robot was first."""
        robot = own_robot
        for there in (pose(0.5, 0.0, 0.3, "base_link"), pose(0.5, 0.0, 0.3, "odom")):
            assert go(robot, there).result()[0] == SUCCEEDED
            assert target(robot) == near(0.5, 0.0, 0.3)
        assert go(robot, ahead(0.2, "/map")).result()[0] == SUCCEEDED
        assert target(robot) == near(0.2, 0.0, 0.0), "the slash is ignored"

    def test_a_chain_on_tf(self, robot: Robot, static: Callable[..., None]) -> None:
        """A camera on a mast: its optical axis z looks ahead, x to the right."""
        optical = (-0.5, 0.5, -0.5, 0.5)
        static(
            transform("base_link", "mast", (0.2, 0.0, 1.0)),
            transform("mast", "camera", (0.0, 0.1, 0.0), optical),
        )
        seen = pose(0.0, 0.0, frame="camera")
        seen.pose.position.z = 0.5
        x, y, z, w = optical
        inverse = seen.pose.orientation  # upright, with the heading of the robot
        inverse.x, inverse.y, inverse.z, inverse.w = -x, -y, -z, w
        assert go(robot, seen).result()[0] == SUCCEEDED
        assert target(robot) == near(0.7, 0.1, 0.0)

    def test_another_odometry_on_tf_does_not_matter(self, own_robot: Robot) -> None:
        publish_static(own_robot)(
            transform("odom", "base_link", (5.0, 0.0, 0.0)),
            transform("base_link", "mast", (0.2, 0.0, 1.0)),
        )
        assert go(own_robot, pose(0.3, 0.0, frame="mast")).result()[0] == SUCCEEDED
        assert target(own_robot) == near(0.5, 0.0, 0.0)

    def test_a_frame_above_the_robot(self, robot: Robot, static: Callable[..., None]) -> None:
        half = math.pi / 4
        static(
            transform("base_footprint", "base_link", (0.1, 0.0, 0.2)),
            transform("earth", "map", (10.0, 0.0, 0.0), (0.0, 0.0, math.sin(half), math.cos(half))),
        )
        assert go(robot, pose(0.6, 0.0, frame="base_footprint")).result()[0] == SUCCEEDED
        assert target(robot) == near(0.5, 0.0, 0.0)
        x, y, theta = START
        there = pose(10.0 - y, x, theta + math.pi / 2, "earth")
        assert go(robot, there).result()[0] == SUCCEEDED
        assert target(robot) == near(0.0, 0.0, 0.0)

    def test_an_unknown_frame_is_refused(self, robot: Robot, logs: Logs, static: Any) -> None:
        static(transform("world", "shelf"))
        for frame, text in (("nowhere", "the frame nowhere with"), ("shelf", "world, which is")):
            goal = Nav2Client(robot, "follow_waypoints", poses=[ahead(1.0), ahead(1.0, frame)])
            refusal = goal.refusal(logs)
            assert text in refusal
            assert "pose 1 of 2" in refusal
            path = Nav2Client(robot, "compute_path_to_pose", goal=ahead(1.0, frame))
            assert text in path.refusal(logs)
        assert robot.chassis.counts["woosh.ros.CallAction"] == 0

    def test_a_pose_that_only_its_frame_makes_too_large_is_refused(
        self, robot: Robot, logs: Logs, static: Callable[..., None]
    ) -> None:
        """The running goal goes on."""
        slow_down(robot.chassis)
        running = go(robot, ahead(3.0))
        robot.chassis.wait_received(CALL_ACTION)
        static(transform("base_link", "far", (3e38, 0.0, 0.0)))
        assert "too large" in go(robot, pose(3e38, 0.0, frame="far")).refusal(logs)
        hurry(robot.chassis)
        assert running.result()[0] == SUCCEEDED

    @pytest.mark.parametrize("by_id", [False, True], ids=["all goals", "its id"])
    def test_a_goal_is_cancelled_while_it_waits_for_its_frame(
        self,
        robot: Robot,
        static: Callable[..., None],
        by_id: bool,
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        """The goal before goes on if only the waiting one is cancelled."""
        frame = f"cancelled_by_id_{by_id}"  # the agent keeps the transforms of earlier tests
        monkeypatch.setattr(frames, "_WAIT", 60.0)
        slow_down(robot.chassis)
        running = go(robot, ahead(3.0))
        robot.chassis.wait_received(CALL_ACTION)
        parts = class_of("nav2_msgs/NavigateToPose", "action").Impl
        there = parts.SendGoalService.Request(goal_id=UUID(uuid=[7 + by_id] * 16))
        there.goal.pose = pose(-1.0, 0.0, frame=frame)
        send = robot.service(parts.SendGoalService, "navigate_to_pose/_action/send_goal")
        sent = send.call_async(there)
        which = {"goal_info": GoalInfo(goal_id=there.goal_id)} if by_id else {}

        def cancelled() -> bool:
            answer = robot.call(CancelGoal, "navigate_to_pose/_action/cancel_goal", **which)
            return there.goal_id in [each.goal_id for each in answer.goals_canceling]

        wait_until(cancelled)  # the cancel may overtake the goal
        static(transform("base_link", frame))
        assert wait_future(sent).accepted
        results = robot.service(parts.GetResultService, "navigate_to_pose/_action/get_result")
        request = parts.GetResultService.Request(goal_id=there.goal_id)
        assert wait_future(results.call_async(request)).status == CANCELED
        hurry(robot.chassis)
        assert running.result()[0] == (SUCCEEDED if by_id else CANCELED)
        drives = [
            each.message.move_base for each in robot.chassis.received if each.type == CALL_ACTION
        ]
        assert [drive.action for drive in drives] == ([1] if by_id else [1, 0])

    def test_goals_in_unknown_frames_do_not_wait_for_each_other(
        self, robot: Robot, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """They would hold up a later goal in a known frame, which could then drive too late."""
        monkeypatch.setattr(frames, "_WAIT", 3.0)  # one after the other, they would take 63 s
        action = class_of("nav2_msgs/NavigateToPose", "action")
        server = robot.action(action, "navigate_to_pose")
        goals = [action.Goal(pose=ahead(1.0, "nowhere")) for _ in range(21)]
        for goal in goals:
            robot.in_executor(partial(server.send_goal_async, goal))
        assert go(robot, ahead(0.5)).result()[0] == SUCCEEDED


def test_frames_with_a_prefix(
    client: Client, connect: Callable[..., RunningAgent], logs: Logs
) -> None:
    connect(nav2=True, frame_prefix="r1/")
    goal = go(client, ahead(0.5, "r1/map"))
    goal.feedback.wait(lambda each: each.current_pose.header.frame_id == "r1/map")
    assert goal.result()[0] == SUCCEEDED
    assert "give the pose in one of r1/map" in go(client, ahead(0.5, "map")).refusal(logs)
