"""odom and /tf, compared with the pose of the simulated robot.

tests/standard has the rules for jumps and predictions, in simulated time.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile
from tf2_msgs.msg import TFMessage

from tests.harness import Client, fill, wait_until
from tests.node.cmd_vel import Sender
from tests.node.goals import SUCCEEDED
from tests.node.test_parameters import change
from tests.quick_chassis import quick_config, set_speed
from woosh_robot_agent.link import LinkState
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed
from woosh_robot_agent.ros.standard.poses import Pose2D
from woosh_robot_agent.simulator import Outgoing, SimulatorThread
from woosh_ros_msgs.action import StepControl
from woosh_ros_msgs.msg import StepControlStep

POSE_SPEED = "woosh.robot.PoseSpeed"
STRAIGHT, ROTATE, LATERAL = 1, 2, 3
EXECUTE = 1


@pytest.fixture
def simulator() -> Any:
    """A simulator at three times real time. Faster motion would look like a jump of the pose."""
    with SimulatorThread(quick_config(port=0, tcp_port=0, speed=3, seed=1)) as running:
        yield running


@pytest.fixture
def truth(simulator: SimulatorThread) -> list[Pose2D]:
    """All poses that the robot has reported, oldest first."""
    poses: list[Pose2D] = []

    def note(frame: Outgoing) -> list[Outgoing]:
        if frame.type == POSE_SPEED:
            poses.append(Pose2D.from_message(frame.body.pose))  # type: ignore[union-attr]
        return [frame]

    simulator.intercept(note)
    return poses


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


def step_goal(*steps: tuple[int, float], speed: float = 1.0) -> Any:
    """Return a goal of steps, each a mode and a value."""
    made = [fill(StepControlStep(), mode=mode, value=value, speed=speed) for mode, value in steps]
    return fill(StepControl.Goal(), arg={"action": EXECUTE, "steps": made})


def drive(client: Client, *steps: tuple[int, float]) -> None:
    """Execute steps, and wait for their end."""
    status, ret = client.send_goal(StepControl, "ros/StepControl", step_goal(*steps)).result(60.0)
    assert status == SUCCEEDED, ret


def frames(client: Client) -> Any:
    return client.echo_with(TFMessage, "/tf", QoSProfile(depth=1000))


def start_pose(simulator: SimulatorThread) -> Pose2D:
    pose = simulator.state.pose
    return Pose2D(pose.x, pose.y, pose.theta)


def test_odom_follows_a_square(simulator, truth, connect, client):
    """Without predictions: each report is published, with its own pose."""
    begin = start_pose(simulator)
    connect()
    assert change(client, odom_prediction=False) == (True, "")
    odom = odoms(client)
    first = odom.wait_count(1)[0]
    assert first.header.frame_id == "odom"
    assert first.child_frame_id == "base_link"
    drive(client, *[(STRAIGHT, 1.0), (ROTATE, math.pi / 2)] * 4)
    end = start_pose(simulator)
    odom.wait(lambda m: near(begin * planar_pose(m.pose.pose), end) and not m.twist.twist.angular.z)
    at = 0
    for message in odom.messages:
        pose = begin * planar_pose(message.pose.pose)
        found = [i for i in range(at, len(truth)) if near(pose, truth[i])]
        if near(pose, begin) and not at:
            continue
        assert found, f"{pose} is nowhere on the way after {truth[at]}"
        at = found[0]
    stamps = [stamp(m) for m in odom.messages]
    assert stamps == sorted(set(stamps))
    assert 0.7 < max(m.twist.twist.linear.x for m in odom.messages) <= 1.0


def test_odom_follows_a_sideways_drive(simulator, connect, client):
    begin = start_pose(simulator)
    connect()
    odom = odoms(client)
    odom.wait_count(1)
    drive(client, (LATERAL, 0.8))
    end = start_pose(simulator)
    odom.wait(lambda m: near(begin * planar_pose(m.pose.pose), end))
    speeds = [m.twist.twist.linear.y for m in odom.messages]
    assert max(speeds) > 0.3
    wait_until(lambda: odom.messages[-1].twist.twist.linear.y == 0.0, "standing still")
    odom.messages.clear()
    client.send_goal(StepControl, "ros/StepControl", step_goal((LATERAL, 3.0), speed=0.5))
    odom.wait(lambda m: m.twist.twist.linear.y > 0.2)
    # as a robot that was stopped: it does not report while it stands
    simulator.intercept(lambda frame: [] if frame.type == POSE_SPEED else [frame])
    wait_until(lambda: odom.messages[-1].twist.twist.linear.y == 0.0, "the end of the velocity")


def test_a_pose_set_by_another_client_ends_the_velocity(simulator, connect, client):
    connect(publish_tf=True)
    odom = odoms(client)
    sender = Sender(client)
    sender.repeat(20, x=0.2)
    odom.wait(lambda m: m.twist.twist.linear.x > 0.15 and m.pose.pose.position.x > 0.03)
    sender.pause()

    def set_aside(sim: Any) -> None:
        sim.chassis.localise(sim.chassis.base.pose.moved(0.0, 0.4, 0.0))

    simulator.call(set_aside)
    odom.wait(lambda m: not m.twist.twist.linear.x and m.pose.pose.position.x > 0.03)
    assert abs(odom.messages[-1].pose.pose.position.y) < 0.05
    assert max(abs(m.twist.twist.linear.y) for m in odom.messages) < 1.0


def test_the_pose_of_a_standing_robot_is_repeated(connect, client):
    connect(odom_rate=50.0)
    odom = odoms(client)
    odom.wait_count(25)
    stamps = [stamp(m) for m in odom.messages]
    assert stamps == sorted(set(stamps))
    assert stamps[-1] - stamps[0] > 0.8 * (len(stamps) - 1) / 50.0, "no faster than the rate"
    assert len({(m.pose.pose.position.x, m.twist.twist.linear.x) for m in odom.messages}) == 1


def test_an_impossible_report_does_not_move_odom_and_is_told_once(reports, connect, client, logs):
    """test_hostile_values.py has poses that are not finite."""
    connect()
    odom = odoms(client)
    odom.wait_count(1)
    told = "the robot cannot have them"
    for _ in range(3):
        reports.push(Pose2D(), 1e6)
    logs.wait_text(told, level="WARNING")
    odom.wait_count(len(odom.messages) + 10)
    assert not any(moving(m) or planar_pose(m.pose.pose).distance for m in odom.messages)
    assert len(logs.with_text(told, "WARNING")) == 1


def test_covariances_and_frames_are_configurable(connect, client):
    diagonal = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
    names = {"frame_prefix": "r1/", "map_frame": "world", "odom_frame": "o", "base_frame": "b"}
    connect(twist_covariance=diagonal[::-1], publish_tf=True, **names)
    transforms = frames(client).wait_count(1)[0].transforms
    assert [(t.header.frame_id, t.child_frame_id) for t in transforms] == [
        ("r1/world", "r1/o"),
        ("r1/o", "r1/b"),
    ]
    odom = odoms(client)
    odom.wait_count(1)
    assert change(client, pose_covariance=diagonal) == (True, "")
    message = odom.wait(lambda m: m.pose.covariance[0] == diagonal[0])
    for covariance, wanted in (
        (message.pose.covariance, diagonal),
        (message.twist.covariance, diagonal[::-1]),
    ):
        assert [covariance[7 * i] for i in range(6)] == wanted
        assert sum(covariance) == pytest.approx(sum(wanted))


def test_odom_stops_while_the_link_is_lost(simulator, connect, client):
    agent = connect()
    odom = odoms(client)
    odom.wait_count(3)
    simulator.stop_listening()
    link = agent.agent.robot.chassis
    wait_until(lambda: link.state is not LinkState.READY, "the loss")
    diagnostics = client.echo_with(DiagnosticArray, "/diagnostics", QoSProfile(depth=10))
    first, second = map(stamp, diagnostics.wait_count(2)[:2])
    simulator.listen()
    agent.wait_connected(2)
    odom.wait(lambda m: stamp(m) > second)
    between = [stamp(m) for m in odom.messages if first < stamp(m) < second]
    assert not between, "odom was published between two messages of an agent without a link"


class TestTransforms:
    def test_odom_does_not_jump_with_a_pose_or_map(self, simulator, connect, client):
        connect(publish_tf=True)
        odom = odoms(client)
        transforms = frames(client)
        odom.wait_count(1)
        drive(client, (STRAIGHT, 0.5))
        for name, x, y, theta in (("SetRobotPose", 1.0, 1.5, 1.0), ("InitRobot", 2.0, -7.5, -3.0)):
            pose = {"x": x, "y": y, "theta": theta}
            assert client.command(f"robot/{name}", pose=pose).ok
            transforms.wait(lambda m: near(chain(m), Pose2D(x, y, theta)))  # noqa: B023
            drive(client, (ROTATE, 0.5))
        assert client.command("robot/SwitchMap", scene_name="scenex").ok
        drive(client, (ROTATE, 0.5))
        end = start_pose(simulator)
        transforms.wait(lambda m: near(chain(m), end))
        for one, other in pairwise(planar_pose(m.pose.pose) for m in odom.messages):
            assert near(one, other, 0.5, 0.6), f"{one} jumped to {other}"
        for message in transforms.messages:
            assert [(t.header.frame_id, t.child_frame_id) for t in message.transforms] == [
                ("map", "odom"),
                ("odom", "base_link"),
            ]
        # the jumps did not change the pose in odom
        assert near(planar_pose(odom.messages[-1].pose.pose), Pose2D(0.5, 0.0, 1.5))


def chain(message: Any) -> Pose2D:
    to_odom, to_base = (transform_pose(t.transform) for t in message.transforms)
    return to_odom * to_base


# Between the reports: the tests push them, or thin out those of the simulated robot


class Reports:
    """Pushes reports of a robot that drives away from where it stands."""

    def __init__(self, robot: SimulatorThread) -> None:
        self._robot = robot
        self._origin = start_pose(robot)
        self._map_id = robot.call(lambda sim: sim.chassis.map.id)

    def push(self, pose: Pose2D, linear: float = 0.0, angular: float = 0.0) -> None:
        """Push a report with a pose relative to the start."""
        in_map = self._origin * pose
        report = PoseSpeed(map_id=self._map_id)
        report.pose.x, report.pose.y, report.pose.theta = in_map.x, in_map.y, in_map.theta
        report.twist.linear, report.twist.angular = linear, angular
        self._robot.push(report)


@pytest.fixture
def reports(simulator: SimulatorThread) -> Reports:
    return Reports(simulator)


def moving(message: Any) -> bool:
    return bool(message.twist.twist.linear.x or message.twist.twist.angular.z)


def thin_out(simulator: SimulatorThread) -> list[PoseSpeed]:
    """Let the robot report at 5 Hz while it moves; return the list of its reports."""
    chassis = simulator.call(lambda sim: sim.chassis)
    passed: list[PoseSpeed] = []
    last = [-math.inf]

    def pass_some(frame: Outgoing) -> list[Outgoing]:
        if frame.type != POSE_SPEED or frame.request:
            return [frame]
        if chassis.base.moving and chassis.elapsed < last[0] + 0.2 - 1e-6:
            return []
        last[0] = chassis.elapsed
        passed.append(frame.body)  # type: ignore[arg-type]
        return [frame]

    simulator.intercept(pass_some)
    return passed


class TestPrediction:
    def test_a_moving_robot_has_several_messages_for_each_report(self, simulator, connect, client):
        set_speed(simulator, 1.0)
        connect(publish_tf=True)
        odom = odoms(client)
        transforms = frames(client)
        odom.wait_count(1)
        transforms.wait_count(1)
        passed = thin_out(simulator)
        drive(client, (STRAIGHT, 1.5))
        odom.wait(lambda m: not moving(m) and near(planar_pose(m.pose.pose), Pose2D(1.5), 0.001))
        sent = sum(1 for report in passed if report.twist.linear)
        published = [m for m in odom.messages if moving(m)]
        assert 5 < sent < 20, "the robot reports at 5 Hz"
        # four at 20 Hz; a busy machine skips some
        assert 1.5 * sent < len(published) < 5 * sent
        stamps = [stamp(m) for m in odom.messages]
        assert stamps == sorted(set(stamps)), "stamps increase"
        poses = {stamp(m.transforms[1]): m.transforms[1].transform for m in transforms.messages}
        both = [m for m in odom.messages if stamp(m) in poses]
        assert len(both) > 5
        for message in both:
            assert near(transform_pose(poses[stamp(message)]), planar_pose(message.pose.pose))
