"""Obstacles that come and go: the laser sees them, the base stops before them."""

from __future__ import annotations

import math

import pytest

from tests.quick_chassis import quick_config
from woosh_robot_agent.link.protos import message_type
from woosh_robot_agent.simulator.chassis import TIME_STEP, Chassis
from woosh_robot_agent.simulator.protocol.dispatch import dispatch
from woosh_robot_agent.simulator.world.collision import Obstacles
from woosh_robot_agent.simulator.world.geometry import Pose


@pytest.fixture
def chassis() -> Chassis:
    chassis = Chassis(quick_config(seed=1))
    chassis.base.place(Pose(0.0, 0.0, 0.0))
    return chassis


def drive(chassis: Chassis, seconds: float, linear: float = 0.5) -> None:
    for _ in range(round(seconds / TIME_STEP)):
        dispatch(chassis, message_type("woosh.robot.Twist")(linear=linear))
        chassis.tick(TIME_STEP)


def distance_ahead(chassis: Chassis) -> float:
    return chassis.scan()[chassis.laser.rays // 2]


def test_laser_sees_obstacles_until_they_are_removed(chassis: Chassis) -> None:
    before = distance_ahead(chassis)
    chassis.obstacles.put("box", 2.0, 0.0, 0.5)
    assert distance_ahead(chassis) == pytest.approx(2.0 - 0.5 - chassis.laser.forward, abs=0.03)
    chassis.obstacles.put("box", 3.0, 0.0, 0.5)
    assert distance_ahead(chassis) == pytest.approx(3.0 - 0.5 - chassis.laser.forward, abs=0.03)
    assert chassis.obstacles.names == ("box",)
    chassis.obstacles.remove("box")
    assert distance_ahead(chassis) == before
    assert chassis.walls == chassis.map.walls


def test_base_stops_until_the_obstacle_is_removed(chassis: Chassis) -> None:
    chassis.obstacles.put("box", 2.0, 0.0, 0.5)
    drive(chassis, 5.0)
    assert chassis.base.blocked
    stopped = chassis.base.pose.x
    assert 0.5 < stopped < 1.3
    chassis.obstacles.clear()
    drive(chassis, 1.0)
    assert chassis.base.pose.x > stopped + 0.2


def test_equal_runs_with_obstacles_are_equal() -> None:
    """Obstacles placed and removed at fixed steps affect two runs equally."""
    runs = []
    for _ in range(2):
        chassis = Chassis(quick_config(seed=3))
        chassis.base.place(Pose(0.0, 0.0, 0.0))
        seen: list[object] = []
        for step in range(200):
            if step == 20:
                chassis.obstacles.put("b", 1.4, 0.3, 0.4)
                chassis.obstacles.put("a", 2.0, -0.8, 0.2)
            if step == 120:
                chassis.obstacles.remove("b")
            drive(chassis, TIME_STEP)
            seen.append((chassis.base.pose, chassis.base.blocked))
            if step % 40 == 0:
                seen.append(chassis.scan())
        runs.append(seen)
    assert runs[0] == runs[1]


def test_clearance_is_the_distance_to_the_nearest_obstacle(chassis: Chassis) -> None:
    obstacles = chassis.obstacles
    obstacles.put("a", 1.0, 0.0, 0.25)
    obstacles.put("far", 9.0, 9.0, 0.25)
    assert obstacles.clearance(0.0, 0.0) == pytest.approx(0.75, abs=0.01)
    obstacles.put("a", 1.0, 0.0, 3.0)
    assert obstacles.clearance(0.0, 0.0) == obstacles.clearance(1.0, 0.0) == 0.0


@pytest.mark.parametrize(
    ("x", "radius"), [(math.nan, 0.3), (math.inf, 0.3), (0.0, 0.0), (0.0, -1.0), (0.0, math.nan)]
)
def test_invalid_obstacles_are_refused(x: float, radius: float) -> None:
    obstacles = Obstacles()
    with pytest.raises(ValueError, match="obstacle a"):
        obstacles.put("a", x, 0.0, radius)
    assert obstacles.names == ()
    assert obstacles.clearance(0.0, 0.0) == math.inf
    with pytest.raises(KeyError):
        obstacles.remove("a")
