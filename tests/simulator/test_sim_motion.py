"""Motion of the base and its collisions, stepped by hand: no sockets, no clock."""

from __future__ import annotations

import math
import random
from itertools import pairwise

import pytest

from tests.quick_chassis import execute, quick_config
from woosh_robot_agent.pb.util import robot_pb2 as util_robot_pb2
from woosh_robot_agent.simulator.body.base import ACCELERATION, STANDSTILL, Base, Velocity
from woosh_robot_agent.simulator.chassis import TIME_STEP, Chassis
from woosh_robot_agent.simulator.profile import load_profile
from woosh_robot_agent.simulator.world.geometry import Pose, Wall, hull, wrap
from woosh_robot_agent.simulator.world.laser import Laser
from woosh_robot_agent.simulator.world.maps import Obstacles

STEPS_PER_S = round(1 / TIME_STEP)
ORIGINAL = load_profile("instant").model.outline


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


def drive(chassis: Chassis, seconds: float, **twist: float) -> None:
    for _ in range(round(seconds / TIME_STEP)):
        execute(chassis, "woosh.robot.Twist", **twist)
        chassis.tick(TIME_STEP)


def corners(pose: Pose) -> list[Pose]:
    return [pose.moved(x, y, 0.0) for x, y in ORIGINAL]


def inside(pose: Pose, x: float, y: float, margin: float = 0.0) -> bool:
    """Return True if a point is inside the outline, widened by `margin` on all sides."""
    return all(
        nx * p + ny * q < distance + margin
        for p, q in [pose.local(x, y)]
        for nx, ny, distance in hull(ORIGINAL).sides
    )


def test_gap_to_zero_length_and_very_long_walls() -> None:
    shape = hull(ORIGINAL)
    assert shape.gap(Pose(), [Wall(0.0, 0.0, 0.0, 0.0)]) == pytest.approx(-0.265)
    assert shape.gap(Pose(), [Wall(0.0, -9.0, 0.0, 9.0)]) == pytest.approx(-0.265)
    assert shape.gap(Pose(), [Wall(0.39, -9.0, 0.39, 9.0)]) == pytest.approx(-0.01)
    assert shape.gap(Pose(), [Wall(0.41, -9.0, 0.41, 9.0)]) == pytest.approx(0.01)
    assert shape.gap(Pose(), []) == math.inf
    assert hull((*ORIGINAL, ORIGINAL[0])).sides == shape.sides  # the last corner may be the first


@pytest.mark.parametrize("theta", [0.4, math.pi / 2, 3.0])
def test_no_corner_passes_a_wall(chassis: Chassis, theta: float) -> None:
    chassis.localise(Pose(10.5, 5.0, theta))
    aside = -math.sin(theta)
    drive(chassis, 6.0, linear=math.cos(theta), linear_y=aside)
    assert chassis.base.blocked
    furthest = max(corner.x for corner in corners(chassis.base.pose))
    assert 12.0 - 0.06 < furthest <= 12.0


def test_turning_stops_at_a_wall(chassis: Chassis) -> None:
    chassis.localise(Pose(11.7, 5.0, math.pi / 2))  # along the wall, 3.5 cm from it
    drive(chassis, 2.0, angular=1.0)
    assert chassis.base.blocked
    assert 0.0 < chassis.base.pose.theta - math.pi / 2 < 0.3
    assert chassis.base.velocity.turn == 0.0
    drive(chassis, 1.0, linear_y=0.5)  # to the left, away from the wall
    assert chassis.base.pose.x < 11.5


def test_robot_can_turn_while_a_wall_blocks_the_way_ahead(chassis: Chassis) -> None:
    chassis.localise(Pose(11.0, 5.0, 0.0))
    drive(chassis, 2.0, linear=1.0)
    before = chassis.base.pose
    drive(chassis, 0.3, linear=0.2, angular=0.1)
    assert chassis.base.blocked
    assert chassis.base.pose.point == before.point
    assert chassis.base.pose.theta > before.theta


def test_obstacle_between_two_outline_corners_is_detected(chassis: Chassis) -> None:
    chassis.localise(Pose(0.0, -1.0, -math.pi / 2 + math.pi / 4))
    chassis.obstacles.put("post", 1.0, -2.0, 0.02)
    drive(chassis, 4.0, linear=0.5)
    assert chassis.base.blocked
    assert not inside(chassis.base.pose, 1.0, -2.0)
    assert inside(chassis.base.pose, 1.0, -2.0, margin=0.06)


def test_robot_can_leave_an_obstacle_placed_on_it(chassis: Chassis) -> None:
    chassis.localise(Pose(0.0, 0.0, 0.0))
    chassis.obstacles.put("box", 0.5, 0.0, 0.3)
    drive(chassis, 1.0, linear=0.5)
    assert chassis.base.pose.x == 0.0
    drive(chassis, 2.0, linear=-0.5)
    assert chassis.base.pose.x < -0.5


def test_expanded_outline_stops_further_from_a_wall(chassis: Chassis) -> None:
    chassis.localise(Pose(10.0, 5.0, 0.0))
    execute(chassis, "woosh.robot.SwitchFootPrint", type=util_robot_pb2.kExpand)
    drive(chassis, 4.0, linear=1.0)
    assert 12.0 - 0.55 - 0.06 < chassis.base.pose.x <= 12.0 - 0.55


def test_no_wall_is_left_out_of_the_gap(chassis: Chassis) -> None:
    """Every wall of the present map and of the present obstacles counts."""
    rng = random.Random(3)
    shape = hull(ORIGINAL)
    pose = Pose(9.0, 3.2, 0.0)
    for step in range(1000):
        if step % 100 == 50:
            chassis.obstacles.put("a", pose.x + rng.uniform(-1, 1), pose.y, rng.uniform(0.05, 0.5))
        if step % 100 == 99:
            chassis.obstacles.clear()
        if step % 500 == 499:
            scene = chassis.scenes["scenex" if chassis.scene.name == "wooshmap" else "wooshmap"]
            chassis.scene, chassis.map = scene, scene.maps[0]
        gap = chassis.gap(pose)
        near = [wall for wall in chassis.walls if wall.distance(*pose.point) <= shape.radius]
        exact = min((shape._wall_gap(pose, wall) for wall in near), default=math.inf)
        assert gap == exact
        move = rng.uniform(-0.2, 0.2), rng.uniform(-0.1, 0.1), rng.uniform(-0.5, 0.5)
        pose = pose.moved(*move)
        pose = Pose(min(12.3, max(-12.3, pose.x)), min(10.3, max(-10.3, pose.y)), pose.theta)


def test_invalid_obstacles_are_refused() -> None:
    obstacles = Obstacles()
    for x, radius in ((math.nan, 0.3), (math.inf, 0.3), (0.0, 0.0), (0.0, -1.0), (0.0, math.nan)):
        with pytest.raises(ValueError, match="obstacle a"):
            obstacles.put("a", x, 0.0, radius)
    assert obstacles.names == ()
    assert obstacles.walls == ()
    with pytest.raises(KeyError):
        obstacles.remove("a")


def test_steps_stop_before_they_touch_an_obstacle_on_the_wider_side(chassis: Chassis) -> None:
    chassis.footprints[chassis.footprint] = ((0.4, 0.2), (0.4, -0.6), (-0.4, -0.6), (-0.4, 0.2))
    chassis.base.place(Pose())
    chassis.obstacles.put("box", 3.0, -0.6, radius=0.2)
    steps = {"action": 1, "steps": [{"mode": 1, "value": 4.0}]}
    assert execute(chassis, "woosh.ros.CallAction", step_control=steps).ok
    for _ in range(round(10.0 / TIME_STEP)):
        chassis.tick(TIME_STEP)
    assert chassis.pose.x > 1.5
    assert chassis.gap(chassis.pose) > 0.01
