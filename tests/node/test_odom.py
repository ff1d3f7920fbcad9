"""odom and /tf, compared with the pose of the simulated robot."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from tf2_msgs.msg import TFMessage

from tests.harness import Client, wait_until
from tests.node.goals import SUCCEEDED
from tests.quick_chassis import quick_config, set_speed
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed
from woosh_robot_agent.ros.standard.poses import Pose2D
from woosh_robot_agent.simulator import Outgoing, SimulatorThread
from woosh_robot_msgs.srv import InitRobot, SetRobotPose, SwitchMap, Twist
from woosh_robot_msgs.srv import PoseSpeed as PoseSpeedQuery
from woosh_ros_msgs.action import StepControl
from woosh_ros_msgs.msg import StepControlStep

POSE_SPEED = "woosh.robot.PoseSpeed"
STRAIGHT, ROTATE, LATERAL = 1, 2, 3
EXECUTE = 1


@pytest.fixture
def slow_simulator() -> Any:
    """A simulator at three times real time. Faster motion would look like a jump of the pose."""
    with SimulatorThread(quick_config(port=0, tcp_port=0, speed=3, seed=1)) as running:
        yield running


@pytest.fixture
def truth(slow_simulator: SimulatorThread) -> list[Pose2D]:
    """All poses that the robot has reported, oldest first."""
    poses: list[Pose2D] = []

    def note(frame: Outgoing) -> list[Outgoing]:
        if frame.type == POSE_SPEED:
            poses.append(Pose2D.from_message(frame.body.pose))  # type: ignore[union-attr]
        return [frame]

    slow_simulator.intercept(note)
    return poses


@pytest.fixture
def start(slow_simulator: SimulatorThread, start_agent: Callable[..., Any]) -> Callable[..., Any]:
    def start(**parameters: Any) -> Any:
        agent = start_agent(ip="127.0.0.1", port=slow_simulator.port, backoff_min=0.1, **parameters)
        agent.wait_connected()
        return agent

    return start


def odoms(client: Client) -> Any:
    return client.echo_with(Odometry, "odom", QoSProfile(depth=1000))


def planar_pose(pose: Any) -> Pose2D:
    return Pose2D(
        pose.position.x, pose.position.y, 2 * math.atan2(pose.orientation.z, pose.orientation.w)
    )


def transform_pose(transform: Any) -> Pose2D:
    shift, rotation = transform.translation, transform.rotation
    return Pose2D(shift.x, shift.y, 2 * math.atan2(rotation.z, rotation.w))


def near(one: Pose2D, other: Pose2D, metres: float = 0.01, radians: float = 0.01) -> bool:
    off = one.inverse * other
    return off.distance <= metres and abs(off.theta) <= radians


def stamp(message: Any) -> float:
    return message.header.stamp.sec + message.header.stamp.nanosec / 1e9


def drive(client: Client, *steps: tuple[int, float]) -> None:
    """Execute steps, each a mode and a value, and wait for their end."""
    goal = StepControl.Goal()
    goal.arg.action.value = EXECUTE
    for mode, value in steps:
        step = StepControlStep(value=value, speed=1.0)
        step.mode.value = mode
        goal.arg.steps.append(step)
    status, ret = client.send_goal(StepControl, "ros/StepControl", goal).result(60.0)
    assert status == SUCCEEDED, ret


def start_pose(simulator: SimulatorThread) -> Pose2D:
    pose = simulator.state.pose
    return Pose2D(pose.x, pose.y, pose.theta)


@pytest.mark.parametrize(
    ("prediction", "speed", "sides", "tolerance"),
    # a prediction fits only if the robot drives as fast as it reports
    [(True, 1.0, 2, 0.05), (False, 3.0, 4, 0.01)],
)
def test_odom_follows_a_square(
    slow_simulator, truth, start, client, prediction, speed, sides, tolerance
):
    begin = start_pose(slow_simulator)
    set_speed(slow_simulator, speed)
    start(odom_prediction=prediction)
    odom = odoms(client)
    first = odom.wait_count(1)[0]
    assert first.header.frame_id == "odom"
    assert first.child_frame_id == "base_link"
    drive(client, *[(STRAIGHT, 1.0), (ROTATE, math.pi / 2)] * sides)
    end = start_pose(slow_simulator)
    odom.wait(lambda m: near(begin * planar_pose(m.pose.pose), end) and not m.twist.twist.angular.z)
    at = 0
    for message in odom.messages:
        pose = begin * planar_pose(message.pose.pose)
        found = [i for i in range(at, len(truth)) if near(pose, truth[i], tolerance, tolerance)]
        if near(pose, begin, tolerance, tolerance) and not at:
            continue
        assert found, f"{pose} is nowhere on the way after {truth[at]}"
        at = found[0]
    stamps = [stamp(m) for m in odom.messages]
    assert stamps == sorted(set(stamps))
    assert 0.7 < max(m.twist.twist.linear.x for m in odom.messages) <= 1.0


def test_odom_follows_a_sideways_drive(slow_simulator, start, client):
    begin = start_pose(slow_simulator)
    start()
    odom = odoms(client)
    drive(client, (LATERAL, 0.8))
    end = start_pose(slow_simulator)
    odom.wait(lambda m: near(begin * planar_pose(m.pose.pose), end))
    speeds = [m.twist.twist.linear.y for m in odom.messages]
    assert max(speeds) > 0.3
    wait_until(lambda: odom.messages[-1].twist.twist.linear.y == 0.0, "standing still")


def test_the_stamp_of_a_report_is_the_time_of_receipt(slow_simulator, start, client):
    """It lies between the sending of the report and the arrival of the message."""
    sent: dict[float, float] = {}
    arrived: list[tuple[float, Odometry]] = []

    def note(frame: Outgoing) -> list[Outgoing]:
        if frame.type == POSE_SPEED and not frame.request:
            sent.setdefault(round(frame.body.pose.x, 4), time.time())  # type: ignore[union-attr]
        return [frame]

    begin = start_pose(slow_simulator)
    start(odom_prediction=False)
    client.node.create_subscription(
        Odometry,
        client.path("odom"),
        lambda message: arrived.append((time.time(), message)),
        QoSProfile(depth=1000),
    )
    wait_until(lambda: arrived, "odom")
    slow_simulator.intercept(note)
    drive(client, (STRAIGHT, 1.0))
    compared = 0
    for arrival, message in list(arrived):
        at = sent.get(round((begin * planar_pose(message.pose.pose)).x, 4))
        if at is not None and message.twist.twist.linear.x:
            assert at <= stamp(message) <= arrival
            compared += 1
    assert compared > 5


class TestAtRest:
    """odom of a standing robot, which does not report its pose."""

    def test_a_small_correction_does_not_move_odom(self, slow_simulator, start, client):
        begin = start_pose(slow_simulator)
        start()
        odom = odoms(client)
        odom.wait_count(1)
        aside = begin * Pose2D(0.0, 0.03, 0.0)
        request = SetRobotPose.Request()
        request.arg.pose.x, request.arg.pose.y, request.arg.pose.theta = (
            aside.x,
            aside.y,
            aside.theta,
        )
        assert client.call(SetRobotPose, "robot/SetRobotPose", arg=request.arg).ok
        before = len(odom.messages)
        odom.wait_count(before + 20)
        assert all(near(planar_pose(m.pose.pose), Pose2D(), 0.001, 0.001) for m in odom.messages)
        assert not any(m.twist.twist.linear.y for m in odom.messages)

    def test_an_emergency_stop_ends_the_sideways_velocity(self, slow_simulator, start, client):
        start()
        odom = odoms(client)
        goal = StepControl.Goal()
        goal.arg.action.value = EXECUTE
        step = StepControlStep(value=3.0, speed=0.5)
        step.mode.value = LATERAL
        goal.arg.steps.append(step)
        running = client.send_goal(StepControl, "ros/StepControl", goal)
        odom.wait(lambda m: m.twist.twist.linear.y > 0.2)
        slow_simulator.set_emergency_stop(True)
        running.result()
        wait_until(lambda: odom.messages[-1].twist.twist.linear.y == 0.0)
        odom.wait_count(len(odom.messages) + 10)


def test_a_pose_set_by_another_client_ends_the_velocity(slow_simulator, start, client):
    start(publish_tf=True)
    odom = odoms(client)
    twist = Twist.Request()
    twist.arg.linear = 0.2
    assert client.call(Twist, "robot/Twist", arg=twist.arg).ok
    odom.wait(lambda m: m.twist.twist.linear.x > 0.15)

    def set_aside(sim: Any) -> None:
        sim.chassis.localise(sim.chassis.base.pose.moved(0.0, 0.4, 0.0))

    slow_simulator.call(set_aside)
    odom.wait(lambda m: not m.twist.twist.linear.x and m.pose.pose.position.x > 0.03)
    assert abs(odom.messages[-1].pose.pose.position.y) < 0.05
    assert max(abs(m.twist.twist.linear.y) for m in odom.messages) < 1.0


@pytest.mark.parametrize("prediction", [True, False])
def test_the_pose_of_a_standing_robot_is_repeated(start, client, prediction):
    start(odom_rate=50.0, odom_prediction=prediction)
    odom = odoms(client)
    odom.wait_count(25)
    stamps = [stamp(m) for m in odom.messages]
    assert stamps == sorted(set(stamps))
    assert stamps[-1] - stamps[0] > 0.8 * (len(stamps) - 1) / 50.0, "no faster than the rate"
    assert len({(m.pose.pose.position.x, m.twist.twist.linear.x) for m in odom.messages}) == 1


@pytest.mark.parametrize("field", ["x", "theta", "linear"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_report_with_non_finite_numbers_is_ignored(
    slow_simulator, start, client, logs, field, value
):
    start()
    odom = odoms(client)
    odom.wait(lambda m: True)
    info = client.call(PoseSpeedQuery, "robot/PoseSpeed").info
    good = PoseSpeed(map_id=info.map_id)
    good.pose.x, good.pose.y, good.pose.theta = info.pose.x, info.pose.y, info.pose.theta
    bad = PoseSpeed(map_id=info.map_id)
    setattr(bad.twist if field == "linear" else bad.pose, field, value)
    slow_simulator.push(bad)
    slow_simulator.push(bad)
    wait_until(lambda: any("is not finite" in text for text in warnings_in(logs)), "the warning")
    slow_simulator.push(good)
    odom.wait_count(len(odom.messages) + 5)
    for message in list(odom.messages):
        assert planar_pose(message.pose.pose).distance == pytest.approx(0.0, abs=1e-6)
        assert message.twist.twist.linear.x == 0.0
    assert sum("is not finite" in text for text in warnings_in(logs)) == 1


def warnings_in(logs: Any) -> list[str]:
    return [r.getMessage() for r in list(logs.messages) if r.levelname == "WARNING"]


def test_covariances_are_configurable(start, client):
    diagonal = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
    start(pose_covariance=diagonal, twist_covariance=diagonal[::-1])
    (message,) = odoms(client).wait_count(1)[:1]
    for covariance, wanted in (
        (message.pose.covariance, diagonal),
        (message.twist.covariance, diagonal[::-1]),
    ):
        assert [covariance[7 * i] for i in range(6)] == wanted
        assert sum(covariance) == pytest.approx(sum(wanted))


def test_covariance_can_be_changed_at_runtime(start, client):
    start()
    odom = odoms(client)
    odom.wait_count(1)
    diagonal = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
    parameter = Parameter("pose_covariance", value=diagonal).to_parameter_msg()
    (result,) = client.call(SetParameters, "agent/set_parameters", parameters=[parameter]).results
    assert result.successful, result.reason
    odom.wait(lambda m: [m.pose.covariance[7 * i] for i in range(6)] == diagonal)


def test_odom_stops_while_the_link_is_lost(slow_simulator, start, client):
    agent = start()
    odom = odoms(client)
    odom.wait_count(3)
    slow_simulator.stop_listening()
    wait_until(lambda: agent.agent._chassis.state.value != "ready", "the loss")
    diagnostics = client.echo_with(DiagnosticArray, "/diagnostics", QoSProfile(depth=10))
    first, second = map(stamp, diagnostics.wait_count(2)[:2])
    slow_simulator.listen()
    agent.wait_connected(2)
    odom.wait(lambda m: stamp(m) > second)
    between = [stamp(m) for m in odom.messages if first < stamp(m) < second]
    assert not between, "odom was published between two messages of an agent without a link"


def test_odom_can_be_switched_off(start, client):
    start(disabled_parts=["odom"])
    wait_until(lambda: client.publishers("robot/PoseSpeed"), "the agent")
    assert not client.publishers("odom")
    assert not client.publishers("/tf")


class TestTransforms:
    def test_odom_does_not_jump_with_the_map_pose(self, slow_simulator, start, client):
        start(publish_tf=True)
        odom = odoms(client)
        transforms = client.echo_with(TFMessage, "/tf", QoSProfile(depth=1000))
        odom.wait_count(1)
        drive(client, (STRAIGHT, 0.5))
        for x, y, theta in ((1.0, 1.5, 1.0), (2.0, -7.5, -3.0)):
            request = SetRobotPose.Request()
            request.arg.pose.x, request.arg.pose.y, request.arg.pose.theta = x, y, theta
            assert client.call(SetRobotPose, "robot/SetRobotPose", arg=request.arg).ok
            transforms.wait(lambda m: near(chain(m), Pose2D(x, y, theta)))  # noqa: B023
            drive(client, (ROTATE, 0.5))
        end = start_pose(slow_simulator)
        transforms.wait(lambda m: near(chain(m), end))
        self._is_continuous(odom.messages)
        for message in transforms.messages:
            assert [(t.header.frame_id, t.child_frame_id) for t in message.transforms] == [
                ("map", "odom"),
                ("odom", "base_link"),
            ]
        # the jumps did not change the pose in odom
        assert near(planar_pose(odom.messages[-1].pose.pose), Pose2D(0.5, 0.0, 1.0))

    def test_odom_does_not_jump_with_a_new_pose_or_map(self, slow_simulator, start, client):
        start(publish_tf=True)
        odom = odoms(client)
        transforms = client.echo_with(TFMessage, "/tf", QoSProfile(depth=1000))
        drive(client, (STRAIGHT, 0.5))
        request = InitRobot.Request()
        request.arg.pose.x, request.arg.pose.y, request.arg.pose.theta = 1.0, 1.5, 1.0
        assert client.call(InitRobot, "robot/InitRobot", arg=request.arg).ok
        transforms.wait(lambda m: near(chain(m), Pose2D(1.0, 1.5, 1.0)))
        switch = SwitchMap.Request()
        switch.arg.scene_name = "scenex"
        assert client.call(SwitchMap, "robot/SwitchMap", arg=switch.arg).ok
        drive(client, (ROTATE, 0.5))
        end = start_pose(slow_simulator)
        transforms.wait(lambda m: near(chain(m), end))
        self._is_continuous(odom.messages)
        odom.wait(lambda m: near(planar_pose(m.pose.pose), Pose2D(0.5, 0.0, 0.5)))

    def test_odom_does_not_jump_with_a_new_pose_while_driving(self, slow_simulator, start, client):
        start(publish_tf=True)
        odom = odoms(client)
        transforms = client.echo_with(TFMessage, "/tf", QoSProfile(depth=1000))
        twist = Twist.Request()
        twist.arg.angular = 0.5
        for _ in range(3):
            assert client.call(Twist, "robot/Twist", arg=twist.arg).ok
        odom.wait(lambda m: m.twist.twist.angular.z > 0.2)
        request = SetRobotPose.Request()
        request.arg.pose.x, request.arg.pose.y = 1.0, 1.5
        assert client.call(SetRobotPose, "robot/SetRobotPose", arg=request.arg).ok
        odom.wait(lambda m: m.twist.twist.angular.z == 0.0 and m.pose.pose.orientation.z)
        wait_until(lambda: near(chain(transforms.messages[-1]), start_pose(slow_simulator)))
        self._is_continuous(odom.messages)

    def test_frames_have_the_configured_names_and_prefix(self, start, client):
        start(
            publish_tf=True, frame_prefix="r1/", map_frame="world", odom_frame="o", base_frame="b"
        )
        transforms = client.echo_with(TFMessage, "/tf", QoSProfile(depth=10))
        message = transforms.wait_count(1)[0]
        assert [(t.header.frame_id, t.child_frame_id) for t in message.transforms] == [
            ("r1/world", "r1/o"),
            ("r1/o", "r1/b"),
        ]

    @staticmethod
    def _is_continuous(messages: list[Any]) -> None:
        poses = [planar_pose(m.pose.pose) for m in messages]
        for one, other in pairwise(poses):
            assert near(one, other, 0.5, 0.6), f"{one} jumped to {other}"


def chain(message: Any) -> Pose2D:
    to_odom, to_base = (transform_pose(t.transform) for t in message.transforms)
    return to_odom * to_base
