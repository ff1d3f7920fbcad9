"""odom and /tf between the reports of a robot, with the real node over DDS.

The tests push the reports themselves, or thin out those of the simulated robot. They judge times by
the stamps of the messages only.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from tf2_msgs.msg import TFMessage

from tests.harness import Client, Collector, wait_until
from tests.node.goals import SUCCEEDED
from tests.quick_chassis import quick_config
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed
from woosh_robot_agent.ros.standard.odometry import HORIZON
from woosh_robot_agent.ros.standard.poses import Pose2D
from woosh_robot_agent.simulator import Outgoing, SimulatorThread
from woosh_ros_msgs.action import StepControl
from woosh_ros_msgs.msg import StepControlStep

POSE_SPEED = "woosh.robot.PoseSpeed"
PERIOD = 0.2
"""Time between two reports, in seconds."""
BLEND = 0.15
"""Time in which the error of a prediction disappears, in seconds."""


@pytest.fixture
def robot() -> Iterator[SimulatorThread]:
    """A simulated robot in real time, which stands until a test moves it."""
    with SimulatorThread(quick_config(port=0, tcp_port=0, seed=1)) as running:
        yield running


@pytest.fixture
def start(robot: SimulatorThread, start_agent: Callable[..., Any]) -> Callable[..., Any]:
    def start(**parameters: Any) -> Any:
        agent = start_agent(ip="127.0.0.1", port=robot.port, publish_tf=True, **parameters)
        agent.wait_connected()
        return agent

    return start


class Reports:
    """Pushes reports of a robot that drives away from where it stands."""

    def __init__(self, robot: SimulatorThread) -> None:
        self._robot = robot
        pose = robot.state.pose
        self.origin = Pose2D(pose.x, pose.y, pose.theta)
        self._map_id = robot.call(lambda sim: sim.chassis.map.id)

    def push(self, pose: Pose2D, linear: float = 0.0, angular: float = 0.0) -> None:
        """Push a report with a pose relative to the start."""
        in_map = self.origin * pose
        report = PoseSpeed(map_id=self._map_id)
        report.pose.x, report.pose.y, report.pose.theta = in_map.x, in_map.y, in_map.theta
        report.twist.linear, report.twist.angular = linear, angular
        self._robot.push(report)


@pytest.fixture
def reports(robot: SimulatorThread) -> Reports:
    return Reports(robot)


def odoms(client: Client) -> Collector:
    """Subscribe to odom, and wait for its first message."""
    collector = client.echo_with(Odometry, "odom", QoSProfile(depth=1000))
    collector.wait_count(1)
    return collector


def predicted(
    reports: Reports,
    odom: Collector,
    wanted: Callable[[Any], bool],
    pose: Pose2D,
    linear: float,
    angular: float = 0.0,
) -> Any:
    """Push a report, and return the first message that is wanted.

    A busy machine may not come to publish a message before the horizon. Then this begins anew.
    """
    for _ in range(20):
        reports.push(pose, linear, angular)
        with contextlib.suppress(AssertionError):
            return odom.wait(wanted, 10 * HORIZON)
        odom.messages.clear()
    raise AssertionError("no message is predicted from the reports")


def pose_of(message: Any) -> Pose2D:
    position, rotation = message.pose.pose.position, message.pose.pose.orientation
    return Pose2D(position.x, position.y, 2 * math.atan2(rotation.z, rotation.w))


def transform_pose(transform: Any) -> Pose2D:
    shift, rotation = transform.translation, transform.rotation
    return Pose2D(shift.x, shift.y, 2 * math.atan2(rotation.z, rotation.w))


def stamp(message: Any) -> float:
    return float(message.header.stamp.sec) + message.header.stamp.nanosec / 1e9


def moving(message: Any) -> bool:
    return bool(message.twist.twist.linear.x or message.twist.twist.angular.z)


def pass_two_seconds(client: Client) -> None:
    """Wait until the agent has published further topics for longer than the horizon."""
    diagnostics = client.echo_with(DiagnosticArray, "/diagnostics", QoSProfile(depth=10))
    diagnostics.wait_count(3)


def step(client: Client, mode: int, value: float) -> None:
    """Let the robot drive one step, and wait for its end."""
    goal = StepControl.Goal()
    goal.arg.action.value = 1
    goal.arg.steps.append(StepControlStep(value=value, speed=1.0))
    goal.arg.steps[0].mode.value = mode
    status, ret = client.send_goal(StepControl, "ros/StepControl", goal).result()
    assert status == SUCCEEDED, ret


def thin_out(robot: SimulatorThread) -> list[PoseSpeed]:
    """Let the robot report every 0.2 s while it moves; return the list of reports it sends."""
    chassis = robot.call(lambda sim: sim.chassis)
    passed: list[PoseSpeed] = []
    last = [-math.inf]

    def pass_some(frame: Outgoing) -> list[Outgoing]:
        if frame.type != POSE_SPEED or frame.request:
            return [frame]
        body: Any = frame.body
        if chassis.base.moving and chassis.elapsed < last[0] + PERIOD - 1e-6:
            return []
        last[0] = chassis.elapsed
        passed.append(body)
        return [frame]

    robot.intercept(pass_some)
    return passed


def test_a_moving_robot_has_several_messages_for_each_report(
    robot: SimulatorThread, start: Callable[..., Any], client: Client
) -> None:
    start()
    odom = odoms(client)
    transforms = client.echo_with(TFMessage, "/tf", QoSProfile(depth=1000))
    transforms.wait_count(1)
    passed = thin_out(robot)
    step(client, 1, 1.5)
    odom.wait(lambda m: not moving(m) and abs(pose_of(m).x - 1.5) < 0.001)
    sent = sum(1 for report in passed if report.twist.linear)
    published = [m for m in odom.messages if moving(m)]
    assert 5 < sent < 20, "the robot reports at 5 Hz"
    # four at 20 Hz; a busy machine skips some
    assert 1.5 * sent < len(published) < 5 * sent
    stamps = [stamp(m) for m in odom.messages]
    assert stamps == sorted(set(stamps)), "stamps increase"
    poses = {
        stamp(m.transforms[1]): transform_pose(m.transforms[1].transform)
        for m in transforms.messages
    }
    both = [m for m in odom.messages if stamp(m) in poses]
    assert len(both) > 5
    for message in both:
        assert poses[stamp(message)].seen_from(pose_of(message)).distance < 1e-6


def test_the_pose_moves_by_the_velocity(
    reports: Reports, start: Callable[..., Any], client: Client
) -> None:
    """Between two messages, the pose moves along the arc that their stamps give."""
    start(odom_rate=100.0)
    odom = odoms(client)
    predicted(reports, odom, lambda m: moving(m) and pose_of(m).theta > 0.2, Pose2D(), 0.5, 1.0)
    # after the first blend, in which the pose leaves the standstill
    first = next(stamp(m) for m in odom.messages if moving(m))
    checked = 0
    for one, other in pairwise(m for m in odom.messages if moving(m) and stamp(m) > first + BLEND):
        seconds = stamp(other) - stamp(one)
        forward, left, turn = pose_of(other).seen_from(pose_of(one)).arc
        # the stamp is taken a moment after the time of the prediction
        assert forward == pytest.approx(0.5 * seconds, abs=0.005)
        assert turn == pytest.approx(1.0 * seconds, abs=0.01)
        assert left == pytest.approx(0.0, abs=1e-6)
        checked += 1
    assert checked


def test_nothing_is_predicted_beyond_the_horizon(
    reports: Reports, start: Callable[..., Any], client: Client
) -> None:
    start()
    odom = odoms(client)
    predicted(reports, odom, lambda m: pose_of(m).x > 0.05, Pose2D(), 0.5)
    pass_two_seconds(client)
    driven = [m for m in odom.messages if moving(m)]
    assert stamp(driven[-1]) - stamp(driven[0]) <= HORIZON
    assert max(pose_of(m).x for m in driven) <= 0.5 * HORIZON + 1e-6
    reports.push(Pose2D(0.08))
    odom.wait(lambda m: not moving(m) and abs(pose_of(m).x - 0.08) < 1e-6)


@pytest.mark.parametrize("prediction", [True, False])
@pytest.mark.parametrize(
    ("linear", "angular"), [(0.5, 0.0), (0.001, 0.0), (0.0, -1e-7)], ids=["fast", "slow", "turn"]
)
def test_a_robot_that_stays_silent_stands(
    reports: Reports,
    start: Callable[..., Any],
    client: Client,
    linear: float,
    angular: float,
    prediction: bool,
) -> None:
    """A real robot does not report while it stands, and its last speed may be any."""
    start(odom_prediction=prediction)
    odom = odoms(client)
    last = predicted(reports, odom, moving, Pose2D(0.02), linear, angular)

    def stands(message: Any) -> bool:
        return not moving(message) and abs(pose_of(message).x - 0.02) < 1e-6

    first = odom.wait(lambda m: stamp(m) > stamp(last) and stands(m))
    odom.wait_count(len(odom.messages) + 20)
    later = [m for m in odom.messages if stamp(m) >= stamp(first)]
    assert all(map(stands, later))
    predicted(
        reports,
        odom,
        lambda m: moving(m) and abs(m.twist.twist.linear.x - 0.1) < 1e-6,
        Pose2D(0.03),
        0.1,
    )


@pytest.mark.parametrize("turn", [0.0, 1.0])
def test_the_pose_does_not_jump_back_with_a_late_report(
    reports: Reports, start: Callable[..., Any], client: Client, turn: float
) -> None:
    """The robot has stopped, but its report comes when odom has paused for 0.2 s."""
    start()
    odom = odoms(client)
    predicted(reports, odom, lambda m: pose_of(m).x > 0.08, Pose2D(), 0.5, turn)
    clock = client.node.get_clock()
    wait_until(
        lambda: clock.now().nanoseconds / 1e9 - stamp(odom.messages[-1]) > 0.2, "odom pauses"
    )
    behind = Pose2D.from_arc(0.03, 0.0, 0.06 * turn)
    reports.push(behind)
    odom.wait(lambda m: not moving(m) and pose_of(m).seen_from(behind).distance < 1e-6)
    number = max(number for number, m in enumerate(odom.messages) if moving(m))
    last, after = pose_of(odom.messages[number]), pose_of(odom.messages[number + 1])
    assert last.seen_from(behind).arc[0] > 0.04
    forward, _, turned = after.seen_from(last).arc
    assert forward >= -0.005, f"{last} jumped to {after}"
    assert turned >= -0.005, f"{last} jumped to {after}"


@pytest.mark.parametrize("turn", [0.0, 0.5])
def test_the_pose_does_not_jump_back_with_a_report(
    reports: Reports, start: Callable[..., Any], client: Client, turn: float
) -> None:
    """The robot was slower than predicted: the error disappears within the time of the blend."""
    start()
    odom = odoms(client)
    ahead = pose_of(predicted(reports, odom, lambda m: pose_of(m).x > 0.09, Pose2D(), 0.5, turn))
    behind = Pose2D.from_arc(0.03, 0.0, 0.06 * turn)
    reports.push(behind)
    odom.wait(lambda m: not moving(m) and pose_of(m).seen_from(behind).distance < 1e-6)
    error = max(pose_of(m).seen_from(behind).distance for m in odom.messages)
    assert error >= ahead.seen_from(behind).distance
    for one, other in pairwise(odom.messages):
        share = (stamp(other) - stamp(one)) / BLEND
        step = pose_of(other).seen_from(pose_of(one))
        assert step.x >= -error * share - 0.005, f"{pose_of(one)} jumped to {pose_of(other)}"
        assert abs(step.theta) <= (error * turn * 2 + 0.5 * BLEND) * share + 0.005


def test_a_jump_in_the_map_does_not_move_odom(
    reports: Reports, start: Callable[..., Any], client: Client
) -> None:
    start()
    odom = odoms(client)
    transforms = client.echo_with(TFMessage, "/tf", QoSProfile(depth=1000))
    predicted(reports, odom, lambda m: pose_of(m).x > 0.05, Pose2D(), 0.5)
    elsewhere = Pose2D(1.0, 2.0, 0.5)
    reports.push(elsewhere, 0.5)
    reports.push(elsewhere)
    target = reports.origin * elsewhere

    def arrived(message: Any) -> bool:
        to_odom, to_base = (transform_pose(each.transform) for each in message.transforms)
        return (to_odom * to_base).seen_from(target).distance < 1e-3

    transforms.wait(arrived)
    for one, other in pairwise(odom.messages):
        step = pose_of(other).seen_from(pose_of(one))
        seconds = stamp(other) - stamp(one)
        assert step.distance <= (0.5 + 0.15 / BLEND) * seconds + 0.005
    assert pose_of(odom.messages[-1]).distance < 0.5


def test_prediction_can_be_switched_off(
    reports: Reports, start: Callable[..., Any], client: Client
) -> None:
    """Then each report is published once, with its own pose."""
    start(odom_rate=200.0)  # so that reports in quick succession are all published
    odom = odoms(client)
    off = Parameter("odom_prediction", value=False).to_parameter_msg()
    (result,) = client.call(SetParameters, "agent/set_parameters", parameters=[off]).results
    assert result.successful, result.reason
    for number in range(1, 4):
        reports.push(Pose2D(0.1 * number), 0.5)
        wait_until(lambda: sum(map(moving, odom.messages)) == number)  # noqa: B023
        reports.push(Pose2D(0.1 * number))
        # wait several periods, so that the rate does not suppress the next report
        odom.wait_count(len(odom.messages) + 5)
    reports.push(Pose2D(0.4), 0.5)
    pass_two_seconds(client)
    driven = [m for m in odom.messages if moving(m)]
    assert [pose_of(m).x for m in driven] == pytest.approx([0.1, 0.2, 0.3, 0.4], abs=1e-5)
    assert [m.twist.twist.linear.x for m in driven] == pytest.approx([0.5] * 4)


def test_impossible_speeds_do_not_move_odom(
    reports: Reports, start: Callable[..., Any], client: Client, logs: Any
) -> None:
    start()
    odom = odoms(client)
    for linear, angular in ((1e6, 0.0), (0.0, -1e6), (5.0, 0.0)):
        reports.push(Pose2D(), linear, angular)
    wait_until(lambda: warnings_in(logs), "the warning")
    odom.wait_count(len(odom.messages) + 10)
    assert not any(moving(m) or pose_of(m).distance for m in odom.messages)
    assert len(warnings_in(logs)) == 1
    predicted(reports, odom, moving, Pose2D(), 0.5)


def warnings_in(logs: Any) -> list[str]:
    texts = [r.getMessage() for r in list(logs.messages) if r.levelname == "WARNING"]
    return [text for text in texts if "the robot cannot have them" in text]
