"""The model's motion, stepped by hand: no sockets, no clock."""

from __future__ import annotations

import math
import random
from itertools import pairwise

import pytest

from tests.quick_chassis import execute, quick_config
from woosh_robot_agent.simulator.body.base import ACCELERATION, STANDSTILL, Base, Velocity
from woosh_robot_agent.simulator.chassis import TIME_STEP, Chassis
from woosh_robot_agent.simulator.world.geometry import Pose, Wall, wrap
from woosh_robot_agent.simulator.world.laser import Laser

STEPS_PER_S = round(1 / TIME_STEP)


def run(chassis: Chassis, seconds: float) -> list[Velocity]:
    velocities = []
    for _ in range(round(seconds * STEPS_PER_S)):
        chassis.tick(TIME_STEP)
        velocities.append(chassis.base.velocity)
    return velocities


def open_floor(pose: Pose) -> float:
    return math.inf


def test_base_integrates_an_arc_exactly() -> None:
    base = Base(Pose(), odometer=0.0, max_speed=0.9, max_turn_rate=0.7)
    base.velocity = Velocity(0.5, 0.0, 0.5)  # a circle of 1 m radius
    steps = 100
    for _ in range(steps):
        base.drive(Velocity(0.5, 0.0, 0.5))
        base.tick(TIME_STEP, open_floor)
    angle = 0.5 * steps * TIME_STEP
    assert base.pose.point == pytest.approx((math.sin(angle), 1.0 - math.cos(angle)))
    assert base.pose.theta == pytest.approx(wrap(angle))
    assert base.odometer == pytest.approx(0.5 * steps * TIME_STEP)


def test_base_respects_speed_and_acceleration_limits() -> None:
    base = Base(Pose(), odometer=0.0, max_speed=0.9, max_turn_rate=0.7)
    before = STANDSTILL
    for _ in range(40):
        base.drive(Velocity(3.0, -4.0, -9.0))
        base.tick(TIME_STEP, open_floor)
        change = math.hypot(
            base.velocity.forward - before.forward, base.velocity.left - before.left
        )
        assert change <= ACCELERATION * TIME_STEP + 1e-9
        before = base.velocity
    assert base.velocity.speed == pytest.approx(0.9)
    assert base.velocity.left / base.velocity.forward == pytest.approx(-4 / 3)
    assert base.velocity.turn == pytest.approx(-0.7)


def test_twist_times_out_and_ramps_to_zero(chassis: Chassis) -> None:
    start, odometer, level = chassis.base.pose, chassis.base.odometer, chassis.battery.level
    for _ in range(10):
        assert execute(chassis, "woosh.robot.Twist", linear=0.5).ok
        run(chassis, 0.1)
    assert chassis.base.velocity == Velocity(0.5)
    after = run(chassis, 2.0)
    speeds = [velocity.forward for velocity in after]
    # The timeout is 0.5 s after the last command, and 0.1 s have passed.
    held = speeds.index(next(speed for speed in speeds if speed < 0.5))
    assert held == round(0.4 * STEPS_PER_S)
    ramp = speeds[held:]
    assert all(0.0 <= a - b <= ACCELERATION * TIME_STEP + 1e-9 for a, b in pairwise(ramp))
    assert len([speed for speed in ramp if speed > 0.0]) >= 5
    assert speeds[-1] == 0.0
    moved = start.distance(chassis.base.pose.point)
    assert 0.5 < moved < 1.0
    assert chassis.base.odometer - odometer == pytest.approx(moved)
    rested = Chassis(quick_config(seed=1))
    run(rested, 3.0)
    assert chassis.battery.level < rested.battery.level < level
    assert start.bearing(chassis.base.pose.point) == pytest.approx(0.0, abs=1e-9)


def test_no_range_with_noise_exceeds_the_maximum() -> None:
    laser = Laser(forward=0.0, angle_min=-0.05, angle_max=0.05, range_max=2.0)
    ranges = laser.scan(Pose(), [Wall(1.995, -1.0, 1.995, 1.0)], random.Random(1))
    assert max(ranges) == laser.range_max


def test_laser_noise_depends_only_on_the_seed() -> None:
    scans = []
    for _ in range(2):
        chassis = Chassis(quick_config(seed=7))
        run(chassis, 1.0)
        scans.append(chassis.scan())
    assert scans[0] == scans[1]
    assert Chassis(quick_config(seed=8)).scan() != Chassis(quick_config(seed=7)).scan()
