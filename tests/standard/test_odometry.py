"""Movements and jumps in the reports of a robot that reports five times a second."""

from __future__ import annotations

import itertools
import math

import pytest

from woosh_robot_agent.ros.standard.odometry import Odometry
from woosh_robot_agent.ros.standard.poses import Pose2D

PERIOD = 0.204


def near(one: Pose2D, other: Pose2D, tolerance: float = 1e-9) -> bool:
    off = one.seen_from(other)
    return off.distance <= tolerance and abs(off.theta) <= tolerance


def drive(odometry: Odometry, forward: float, turn: float, reports: int = 5) -> Pose2D:
    """Report a drive at constant speeds from the origin of the map; return its last pose."""
    pose = Pose2D()
    for number in range(reports):
        assert odometry.update(pose, forward, turn, 1, number * PERIOD)
        last, pose = pose, pose * Pose2D.from_arc(forward * PERIOD, 0.0, turn * PERIOD)
    return last


@pytest.mark.parametrize(("forward", "turn"), [(0.5, 0.0), (-0.5, 1.0), (1.2, -1.0), (0.5, 0.3)])
def test_a_drive_moves_odom_and_not_the_map(forward: float, turn: float) -> None:
    odometry = Odometry()
    end = drive(odometry, forward, turn)
    assert near(odometry.pose, end)
    assert near(odometry.map_to_odom, Pose2D())
    velocity = odometry.velocity
    assert (velocity.forward, velocity.left, velocity.turn) == (forward, 0.0, turn)


@pytest.mark.parametrize("jump", [Pose2D(1.0), Pose2D(0.0, 0.3), Pose2D(0.0, 0.0, 0.5)])
def test_a_jump_moves_the_map_and_not_odom(jump: Pose2D) -> None:
    odometry = Odometry()
    end = drive(odometry, 0.5, 0.5)
    next_pose = end * Pose2D.from_arc(0.5 * PERIOD, 0.0, 0.5 * PERIOD)
    odometry.update(jump * next_pose, 0.5, 0.5, 1, 5 * PERIOD)
    assert near(odometry.pose, next_pose)
    assert near(odometry.map_to_odom, jump)


@pytest.mark.parametrize(
    "jump", [Pose2D(0.3), Pose2D(-0.3), Pose2D(0.0, 0.3), Pose2D(0.0, 0.0, 0.5)]
)
@pytest.mark.parametrize("after", [(-0.25, 1.0), (-0.5, 0.5), (-0.25, 0.5)])
def test_a_jump_of_a_braking_robot_moves_the_map(after: tuple[float, float], jump: Pose2D) -> None:
    odometry = Odometry()
    end = drive(odometry, -0.5, 1.0)
    odometry.update(end * Pose2D.from_arc(-0.095, 0.0, 0.2) * jump, *after, 1, 5 * PERIOD)
    assert odometry.pose.seen_from(end).distance < 0.11
    assert not near(odometry.map_to_odom, Pose2D(), 0.25)


def test_after_a_lost_link_odom_continues_where_it_was_published_last() -> None:
    odometry = Odometry()
    drive(odometry, 0.5, 0.0)
    odometry.continue_from(Pose2D(7.0, 0.0, 0.0))
    odometry.update(Pose2D(9.0, 1.0, 0.5), 0.5, 0.0, 1, 100.0)
    assert near(odometry.pose, Pose2D(7.0))
    assert near(odometry.map_to_odom * odometry.pose, Pose2D(9.0, 1.0, 0.5))


@pytest.mark.parametrize("speed", [0.3, 0.8])
def test_a_sideways_drive_has_a_speed_and_is_no_jump(speed: float) -> None:
    """The reports have no sideways speed: it comes from the poses."""
    odometry, y, left = Odometry(), 0.0, 0.0
    speeds = [0.0, 0.2, 0.4, 0.6, 0.8]
    speeds = [min(each, speed) for each in speeds + [speed] * 5 + speeds[::-1]]
    for number, each in enumerate(speeds):
        y += (each + (speeds[number - 1] if number else 0.0)) / 2 * PERIOD
        odometry.update(Pose2D(0.0, y), 0.0, 0.0, 1, number * PERIOD)
        left = max(left, odometry.velocity.left)
    assert near(odometry.map_to_odom, Pose2D())
    assert near(odometry.pose, Pose2D(0.0, y))
    assert left == pytest.approx(speed)
    assert odometry.velocity.left < 0.03, "the robot stops, and must not be predicted to go on"


def test_a_sideways_drive_in_a_curve_has_its_own_speed() -> None:
    odometry, pose = Odometry(), Pose2D()
    for number in range(4):
        odometry.update(pose, 0.5, 1.0, 1, number * PERIOD)
        pose *= Pose2D.from_arc(0.5 * PERIOD, 0.3 * PERIOD, 1.0 * PERIOD)
    assert odometry.velocity.left == pytest.approx(0.3)


SPEEDS = list(itertools.product([0.5, 0.0], [1.0, 0.0]))
"""Forward speed and angular speed, in m/s and rad/s."""


@pytest.mark.parametrize("rates", [(1.0, 2.0), (5.0, 10.0)], ids=["gentle", "hard"])
@pytest.mark.parametrize(("start", "end"), list(itertools.permutations(SPEEDS, 2)))
@pytest.mark.parametrize("signs", [(1, 1), (-1, 1)], ids=str)
def test_a_change_of_the_speeds_between_two_reports_is_no_jump(
    signs: tuple[int, int],
    start: tuple[float, float],
    end: tuple[float, float],
    rates: tuple[float, float],
) -> None:
    """The robot accelerates and brakes at `rates`, from any moment between two reports on."""
    parts = 20
    step = PERIOD / parts
    for changed in range(parts, 2 * parts, 2):
        odometry, pose = Odometry(), Pose2D()
        forward, turn = start
        for number in range(6 * parts):
            if number % parts == 0:
                assert odometry.update(pose, forward * signs[0], turn * signs[1], 1, number * step)
                assert near(odometry.map_to_odom, Pose2D()), f"changed at {changed * step:.3f} s"
            last_forward, last_turn = forward, turn
            if number >= changed:
                forward = towards(end[0], forward, rates[0] * step)
                turn = towards(end[1], turn, rates[1] * step)
            pose *= Pose2D.from_arc(
                signs[0] * (forward + last_forward) / 2 * step,
                0.0,
                signs[1] * (turn + last_turn) / 2 * step,
            )
        assert (forward, turn) == end


def towards(end: float, value: float, step: float) -> float:
    """Return `value`, changed by at most `step` towards `end`."""
    return min(value + step, end) if end > value else max(value - step, end)


def test_with_a_jump_odom_moves_by_the_mean_speeds() -> None:
    odometry = Odometry()
    end = drive(odometry, 0.5, 0.4)
    odometry.update(Pose2D(3.0) * end, 0.3, 0.2, 1, 5 * PERIOD)
    driven = Pose2D.from_arc(0.4 * PERIOD, 0.0, 0.3 * PERIOD)
    assert near(odometry.pose, end * driven)


def test_a_correction_of_a_standing_robot_has_no_speed() -> None:
    odometry = Odometry()
    odometry.update(Pose2D(), 0.0, 0.0, 1, 0.0)
    odometry.update(Pose2D(0.0, 0.02), 0.0, 0.0, 1, 60.0)
    assert not odometry.velocity.moving


IMPOSSIBLE = [(1e6, 0.0), (-50.0, 0.0), (2.0, 0.0), (0.5, 1e6), (0.5, -4.0)]


@pytest.mark.parametrize(("forward", "turn"), IMPOSSIBLE)
def test_impossible_speeds_are_replaced_by_those_of_the_movement(
    forward: float, turn: float
) -> None:
    odometry = Odometry()
    end = drive(odometry, 0.5, 0.2)
    next_pose = end * Pose2D.from_arc(0.5 * PERIOD, 0.0, 0.2 * PERIOD)
    assert not odometry.update(next_pose, forward, turn, 1, 5 * PERIOD)
    assert odometry.velocity.forward == pytest.approx(0.5)
    assert odometry.velocity.turn == pytest.approx(0.2)
    assert near(odometry.pose, next_pose)
    assert near(odometry.map_to_odom, Pose2D())


@pytest.mark.parametrize(("forward", "turn"), IMPOSSIBLE)
def test_impossible_speeds_of_a_standing_robot_are_zero(forward: float, turn: float) -> None:
    odometry = Odometry()
    odometry.update(Pose2D(1.0), 0.0, 0.0, 1, 0.0)
    assert not odometry.update(Pose2D(1.0), forward * 2, turn, 1, 60.0)
    assert not odometry.velocity.moving
    assert odometry.pose == Pose2D()


def test_impossible_speeds_in_the_first_report_are_zero() -> None:
    odometry = Odometry()
    assert not odometry.update(Pose2D(1.0), 1e6, 0.0, 1, 0.0)
    assert not odometry.velocity.moving


def test_impossible_speeds_with_a_jump_are_zero() -> None:
    odometry = Odometry()
    end = drive(odometry, 0.5, 0.0)
    assert not odometry.update(Pose2D(5.0) * end, 1e6, math.pi, 1, 5 * PERIOD)
    assert not odometry.velocity.moving
    assert odometry.pose.seen_from(end).distance < 0.5 * PERIOD
