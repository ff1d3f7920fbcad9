"""spin, drive_on_heading, backup, wait and assisted_teleop."""

from __future__ import annotations

import math
from contextlib import closing
from typing import Any

import pytest
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Point, Twist
from std_msgs.msg import Empty
from std_srvs.srv import Trigger

from tests.asynchronous import TIMEOUT
from tests.harness import Client, Logs, Robot, wait_until
from tests.node.cmd_vel import Sender
from tests.node.goals import (
    CALL_ACTION,
    START,
    Held,
    hurry,
    lift,
    move_base,
    slow_down,
    task,
    without_reports,
)
from tests.node.nav2.goals import (
    ABORTED,
    CANCELED,
    PREVENTIONS,
    SUCCEEDED,
    Nav2Client,
    error_code,
    go,
    stands,
    step,
)
from tests.node.test_parameters import change
from woosh_robot_agent.motion.velocity_driver import VelocityDriver
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Twist as ChassisTwist
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction
from woosh_robot_agent.ros.nav2.behaviors import AssistedTeleop
from woosh_robot_msgs.msg import PoseSpeed
from woosh_robot_msgs.srv import RobotState

nav2_actions = pytest.importorskip("nav2_msgs.action")


def last_step(robot: Robot) -> Any:
    commands = [each.message for each in robot.chassis.received if type(each.message) is CallAction]
    return commands[-1].step_control


def moved(robot: Robot) -> tuple[float, float]:
    """Return how far the robot is ahead of its initial pose, in metres, and turned, in radians."""
    x, y, theta = START
    here = robot.chassis.state.pose
    cos, sin = math.cos(theta), math.sin(theta)
    turned = math.remainder(here.theta - theta, math.tau)
    return cos * (here.x - x) + sin * (here.y - y), turned


def test_spin(robot: Robot) -> None:
    assert Nav2Client(robot, "spin", target_yaw=0.0).result()[0] == SUCCEEDED
    assert robot.chassis.counts["woosh.ros.CallAction"] == 0, "nothing to do"
    turned = 0.0
    for angle in (-0.7, 4.0):
        goal = Nav2Client(robot, "spin", target_yaw=angle)
        status, result = goal.result()
        assert (status, error_code(result)) == (SUCCEEDED, 0)
        turned += angle
        assert moved(robot)[1] == pytest.approx(math.remainder(turned, math.tau), abs=0.01)
        assert result.total_elapsed_time.nanosec or result.total_elapsed_time.sec
        angles = [each.angular_distance_traveled for each in goal.feedback.messages]
        assert angles[-1] == pytest.approx(angle, abs=abs(angle))
        assert last_step(robot).steps[0].speed == pytest.approx(0.8)


def test_straight_moves(robot: Robot) -> None:
    """Their speeds obey the limits of cmd_vel."""
    moves = [
        ("backup", 0.2, 0.1),
        ("backup", -0.2, -0.1),
        ("drive_on_heading", -0.3, -0.2),
        ("backup", 0.1, 5.0),
    ]
    back = 0.0
    for name, distance, speed in moves:
        goal = step(robot, name, distance, speed)
        status, result = goal.result()
        assert (status, error_code(result)) == (SUCCEEDED, 0)
        back += abs(distance)
        assert moved(robot)[0] == pytest.approx(-back, abs=0.02)
        assert goal.feedback.messages[0].distance_traveled == pytest.approx(0.0, abs=0.05)
        assert last_step(robot).steps[0].speed == pytest.approx(min(abs(speed), 1.0))
        assert last_step(robot).avoid == 0


def test_moves_that_are_not_possible(robot: Robot) -> None:
    for name, target, speed in (
        ("drive_on_heading", Point(x=0.3), -0.2),
        ("drive_on_heading", Point(x=0.3, y=0.1), 0.2),
        ("backup", Point(x=0.3, z=0.1), 0.2),
        ("backup", Point(x=math.nan), 0.2),
        ("backup", Point(x=0.3), math.nan),
        ("backup", Point(x=0.3), 0.0),
        ("backup", Point(x=1e39), 0.2),  # infinite in the robot's 32 bits
    ):
        Nav2Client(robot, name, target=target, speed=speed).wait_aborted(code="INVALID_INPUT")
    assert robot.chassis.counts["woosh.ros.CallAction"] == 0


@pytest.mark.skipif(
    "disable_collision_checks" not in nav2_actions.Spin.Goal.get_fields_and_field_types(),
    reason="this release has no such field",
)
def test_disabled_collision_checks(robot: Robot) -> None:
    goal = Nav2Client(
        robot, "backup", target=Point(x=0.1), speed=0.1, disable_collision_checks=True
    )
    assert goal.result()[0] == SUCCEEDED
    assert last_step(robot).avoid == 1


def test_the_time_allowance_ends_a_move(robot: Robot) -> None:
    slow_down(robot.chassis)
    step(robot, "drive_on_heading", 3.0, 0.1, allowance=1).wait_aborted(
        "time_allowance", code="TIMEOUT"
    )
    assert stands(robot.chassis)
    assert 0.0 < moved(robot)[0] < 1.0


def test_a_move_is_cancelled(robot: Robot) -> None:
    slow_down(robot.chassis)
    goal = Nav2Client(robot, "spin", target_yaw=50.0)
    goal.feedback.wait(lambda each: each.angular_distance_traveled > 0.3)
    goal.cancel()
    assert goal.result()[0] == CANCELED
    assert stands(robot.chassis)


def test_an_obstacle_aborts_a_move(robot: Robot) -> None:
    robot.chassis.inject("obstacle", ahead=1.0)
    step(robot, "drive_on_heading", 2.0, 0.5).wait_aborted("obstacle", code="UNKNOWN")


def test_wait(robot: Robot) -> None:
    goal = Nav2Client(robot, "wait", time=Duration(nanosec=300_000_000))
    status, result = goal.result()
    assert status == SUCCEEDED
    assert result.total_elapsed_time.nanosec >= 300_000_000
    left = [each.time_left.nanosec for each in goal.feedback.messages]
    assert left == sorted(left, reverse=True)


def test_waiting_and_driving_do_not_disturb_each_other(robot: Robot) -> None:
    slow_down(robot.chassis)
    drive = go(robot, 3.0)
    wait = Nav2Client(robot, "wait", time=Duration(sec=100))
    other = Nav2Client(robot, "wait", time=Duration(nanosec=1))
    assert wait.result()[0] == ABORTED
    assert other.result()[0] == SUCCEEDED
    hurry(robot.chassis)
    assert drive.result()[0] == SUCCEEDED
    wait = Nav2Client(robot, "wait", time=Duration(sec=100))
    wait.feedback.wait(lambda _: True)
    wait.cancel()
    assert wait.result()[0] == CANCELED


class TestAssistedTeleop:
    @pytest.fixture
    def velocities(self, robot: Robot) -> Any:
        """Publisher of velocities, known to the agent."""
        return robot.publisher(Twist, "cmd_vel_teleop")

    def drive(self, velocities: Any, robot: Robot, axis: str = "x") -> None:
        """Publish velocities until the robot drives."""
        velocity = Twist()
        setattr(velocity.linear, axis, 0.3)

        def drives() -> bool:
            velocities.publish(velocity)
            return not stands(robot.chassis)

        wait_until(drives, "the robot drives")

    @pytest.mark.parametrize("axis", ["x", "y"])
    def test_a_cancel_ends_it_only_when_a_robot_that_rolls_on_stands(
        self, robot: Robot, velocities: Any, axis: str
    ) -> None:
        """PoseSpeed has no sideways speed, so only the poses tell of that."""

        def roll_on(base: Any) -> None:
            base._rolls_for, base._stops_below = 0.3, 0.02

        slow_down(robot.chassis)
        robot.chassis.call(lambda sim: roll_on(sim.chassis.base))
        poses = robot.echo(PoseSpeed, "robot/PoseSpeed")
        goal = Nav2Client(robot, "assisted_teleop")
        self.drive(velocities, robot, axis)
        poses.wait_count(len(poses.messages) + 2)
        goal.feedback.wait(lambda each: each.current_teleop_duration.nanosec)
        goal.cancel()
        assert goal.result()[0] == CANCELED
        assert stands(robot.chassis)

    def test_without_a_goal_velocities_move_nothing(self, robot: Robot, velocities: Any) -> None:
        velocity = Twist()
        velocity.linear.x = 0.3
        for _ in range(10):
            velocities.publish(velocity)
        assert Nav2Client(robot, "wait").result()[0] == SUCCEEDED
        assert ChassisTwist.DESCRIPTOR.full_name not in robot.chassis.counts

    def test_the_time_allowance_or_preempt_teleop_ends_it(self, robot: Robot) -> None:
        goal = Nav2Client(robot, "assisted_teleop", time_allowance=Duration(nanosec=200_000_000))
        goal.wait_aborted(code="TIMEOUT")
        preempt = robot.publisher(Empty, "preempt_teleop")
        goal = Nav2Client(robot, "assisted_teleop")
        goal.feedback.wait(lambda _: True)
        preempt.publish(Empty())
        assert goal.result()[0] == SUCCEEDED

    def test_the_watchdog_of_the_velocities_works_again_after_an_error(
        self, own_robot: Robot, monkeypatch: pytest.MonkeyPatch, logs: Logs
    ) -> None:
        robot = own_robot
        send, failures = VelocityDriver._send_due, iter([ZeroDivisionError("once")])

        def fail_once(driver: VelocityDriver) -> None:
            if driver._waiting is None:
                for error in failures:
                    raise error
            send(driver)

        monkeypatch.setattr(VelocityDriver, "_send_due", fail_once)
        Nav2Client(robot, "assisted_teleop").feedback.wait(lambda _: True)
        velocities = robot.publisher(Twist, "cmd_vel_teleop")
        self.drive(velocities, robot)
        logs.wait_text("assisted_teleop failed; restarting it")
        wait_until(lambda: stands(robot.chassis), "the robot stands")
        self.drive(velocities, robot)
        wait_until(
            lambda: robot.chassis.received[-1].message == ChassisTwist(), "the zero of silence"
        )

    def test_it_ends_when_something_stops_the_robot(self, own_robot: Robot) -> None:
        robot = own_robot
        prevent, permit = PREVENTIONS["key switch"]
        velocities = robot.publisher(Twist, "cmd_vel_teleop")

        def driven() -> Nav2Client:
            """Begin with a zero: the stream that drove one goal does not drive the next one."""
            velocities.publish(Twist())
            assert velocities.wait_for_all_acked()
            # the agent handles the zero before this call; many velocities could replace it
            robot.call(RobotState, "robot/RobotState")
            goal = Nav2Client(robot, "assisted_teleop")
            self.drive(velocities, robot)
            return goal

        goal = driven()
        prevent(robot.chassis)
        goal.wait_aborted("manual", code="UNKNOWN")
        permit(robot.chassis)
        wait_until(lambda: stands(robot.chassis), "the robot stands")
        goal = driven()
        assert change(robot, observe_only=True) == (True, "")
        goal.wait_aborted("only observes", code="UNKNOWN")
        assert change(robot, observe_only=False) == (True, "")
        goal = driven()
        robot.chassis.inject("off")
        goal.wait_aborted("no link", code="UNKNOWN")

    def test_after_a_stop_the_same_stream_drives_no_new_goal(
        self, own_robot: Robot, logs: Logs
    ) -> None:
        robot = own_robot
        velocities = robot.publisher(Twist, "cmd_vel_teleop")
        velocity = Twist()
        velocity.linear.x = 0.3
        robot.node.create_timer(0.05, lambda: velocities.publish(velocity))
        goal = Nav2Client(robot, "assisted_teleop")
        wait_until(lambda: not stands(robot.chassis), "the robot drives")
        assert robot.call(Trigger, "stop").success
        goal.wait_aborted("service stop")
        sent = robot.chassis.counts[ChassisTwist.DESCRIPTOR.full_name]
        goal = Nav2Client(robot, "assisted_teleop")
        goal.feedback.wait(lambda each: each.current_teleop_duration.sec >= 1)
        assert robot.chassis.counts[ChassisTwist.DESCRIPTOR.full_name] == sent
        logs.wait_text("cmd_vel_teleop is ignored: the robot was stopped; send a zero")

    def test_the_end_of_the_agent_does_not_wait_until_the_robot_stands(
        self, own_robot: Robot, logs: Logs
    ) -> None:
        robot = own_robot
        velocities = robot.publisher(Twist, "cmd_vel_teleop")
        poses = robot.echo(PoseSpeed, "robot/PoseSpeed")
        goal = Nav2Client(robot, "assisted_teleop")
        self.drive(velocities, robot)
        poses.wait(lambda each: each.twist.linear > 0.1)
        robot.chassis.intercept(lambda out: [] if out.type == "woosh.robot.PoseSpeed" else [out])
        robot.agent.close()
        goal.wait_aborted("the agent is stopping")
        assert logs.with_text("", level="ERROR") == []

    def test_it_ends_when_something_else_drives_the_robot(
        self, robot: Robot, velocities: Any
    ) -> None:
        teleop = Nav2Client(robot, "assisted_teleop")
        self.drive(velocities, robot)
        drive = go(robot, 1.0)
        assert teleop.result()[0] == ABORTED
        assert drive.result()[0] == SUCCEEDED
        slow_down(robot.chassis)
        goal = Nav2Client(robot, "assisted_teleop")
        goal.feedback.wait(lambda _: True)
        task(robot)
        goal.wait_aborted("drives the robot")

    @pytest.mark.parametrize("prevention", ["emergency stop", "key switch"])
    def test_it_ends_though_the_robot_obeys_again_when_the_agent_hears_of_it(
        self, robot: Robot, velocities: Any, prevention: str
    ) -> None:
        prevent, permit = PREVENTIONS[prevention]
        goal = Nav2Client(robot, "assisted_teleop")
        self.drive(velocities, robot)
        stalled = robot.chassis.inject("half_open")
        prevent(robot.chassis)
        permit(robot.chassis)
        stalled.clear()
        goal.wait_aborted("emergency stop" if prevention == "emergency stop" else "manual")

    def test_a_goal_that_does_not_drive_does_not_end_it(self, robot: Robot) -> None:
        goal = Nav2Client(robot, "assisted_teleop")
        held = Held(robot.chassis, CALL_ACTION)
        lifting = lift(robot)
        robot.chassis.wait_received(CALL_ACTION)
        goal.feedback.wait_count(len(goal.feedback.messages) + 5)
        held.release()
        lifting.result()
        goal.feedback.wait_count(len(goal.feedback.messages) + 5)
        assert not goal.done

    def begin_an_unanswered_drive(self, robot: Robot) -> tuple[Nav2Client, Held]:
        """Start MoveBase during a goal; return the goal, and what holds the answer back."""
        assert change(robot, cmd_vel_timeout=5.0) == (True, "")
        goal = Nav2Client(robot, "assisted_teleop")
        self.drive(robot.publisher(Twist, "cmd_vel_teleop"), robot)
        robot.chassis.intercept(without_reports)
        held = Held(robot.chassis, CALL_ACTION)
        move_base(robot, 3.0)
        robot.chassis.wait_received(CALL_ACTION)
        return goal, held

    def test_its_end_does_not_pause_a_drive_that_has_just_begun(self, own_robot: Robot) -> None:
        """The chassis answers the start late, and reports it still later."""
        robot = own_robot
        goal, held = self.begin_an_unanswered_drive(robot)
        goal.feedback.wait_count(len(goal.feedback.messages) + 5)
        held.release()
        goal.wait_aborted("ros/MoveBase drives the robot")
        assert type(robot.chassis.received[-1].message) is CallAction

    def test_its_end_does_not_pause_a_drive_that_is_not_answered_yet(
        self, own_robot: Robot
    ) -> None:
        robot = own_robot
        robot.set_motion_timing(unanswered=TIMEOUT, driving=TIMEOUT)
        goal, held = self.begin_an_unanswered_drive(robot)
        goal.cancel()
        robot.call(RobotState, "robot/RobotState")  # answered after a zero, if one was sent
        held.release()
        assert goal.result()[0] == CANCELED
        sent = [type(each.message) for each in robot.chassis.received]
        assert ChassisTwist not in sent[sent.index(CallAction) :]

    def test_a_defect_does_not_leave_the_robot_driving(
        self, own_robot: Robot, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        robot = own_robot
        assert change(robot, cmd_vel_timeout=5.0) == (True, "")
        goal = Nav2Client(robot, "assisted_teleop")
        self.drive(robot.publisher(Twist, "cmd_vel_teleop"), robot)
        monkeypatch.setattr(AssistedTeleop, "_reason_to_end", None)
        assert goal.result()[0] == ABORTED
        assert not robot.chassis.last(ChassisTwist.DESCRIPTOR.full_name).linear

    def test_without_a_time_allowance_it_ends_with_its_client(
        self, own_robot: Robot, logs: Logs
    ) -> None:
        robot = own_robot
        with closing(Client(robot.agent.domain, robot.namespace, "gone")) as client:
            Nav2Client(client, "assisted_teleop").feedback.wait_count(2)
        logs.wait_text("assisted_teleop: the goal is aborted: its client has gone")
        Sender(robot).send(x=0.3)
        robot.chassis.wait_received(ChassisTwist.DESCRIPTOR.full_name)

    def test_cmd_vel_is_refused_meanwhile(self, robot: Robot, logs: Logs) -> None:
        Nav2Client(robot, "assisted_teleop").feedback.wait(lambda _: True)
        Sender(robot).send(x=0.3)
        logs.wait_text("cmd_vel is ignored: a goal is running")
        assert ChassisTwist.DESCRIPTOR.full_name not in robot.chassis.counts
