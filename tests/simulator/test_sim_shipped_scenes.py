"""The scenes that the package ships."""

from __future__ import annotations

import io
import math
import random
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.quick_chassis import execute, quick_config
from woosh_robot_agent.simulator.chassis import TIME_STEP, Chassis
from woosh_robot_agent.simulator.profile import load_profile
from woosh_robot_agent.simulator.scene_check import check_scene
from woosh_robot_agent.simulator.scenes import files as scenes
from woosh_robot_agent.simulator.scenes.files import load_scene
from woosh_robot_agent.simulator.world.geometry import Pose
from woosh_robot_agent.simulator.world.maps import Obstacles
from woosh_robot_agent.simulator.world.picture import draw
from woosh_robot_agent.simulator.world.planner import Planner

SHIPPED = Path(scenes.__file__).parents[1] / "data"


@pytest.mark.parametrize("name", ["wooshmap", "scenex"])
def test_robot_can_use_everything_in_the_shipped_scenes(name: str) -> None:
    assert check_scene(SHIPPED / name, load_profile("tr200")) == []


def test_shipped_picture_matches_the_walls() -> None:
    """The PNG equals the drawn scene, and its YAML file gives the right origin."""
    area = load_scene(SHIPPED / "wooshmap").maps[0]
    drawn = draw(area)
    with (
        Image.open(SHIPPED / "wooshmap" / "wooshmap.png") as shipped,
        Image.open(io.BytesIO(drawn.png)) as made,
    ):
        assert np.array_equal(np.asarray(shipped), np.asarray(made))
    grid = load_scene(SHIPPED / "wooshmap" / "wooshmap.yaml").maps[0].grid
    assert grid
    assert grid.low == pytest.approx(drawn.low)
    rng = random.Random(2)
    for _ in range(300):
        x, y = rng.uniform(-11.9, 11.9), rng.uniform(-9.9, 9.9)
        assert grid.clearance(x, y) == pytest.approx(area.clearance(x, y), abs=0.08)
    assert grid.known(0.0, 0.0)
    assert not grid.known(12.3, 0.0)


def test_base_stops_alike_before_a_picture_and_before_walls() -> None:
    walls = Chassis(quick_config(seed=1))
    cells = Chassis(quick_config(seed=1, scenes=(SHIPPED / "wooshmap" / "wooshmap.yaml",)))
    for heading in (1.0, -2.0):
        stops = []
        for chassis in (walls, cells):
            chassis.base.place(Pose(2.0, 3.0, heading))
            while not chassis.base.blocked:
                execute(chassis, "woosh.robot.Twist", linear=0.8)
                chassis.tick(TIME_STEP)
            stops.append(chassis.base.pose)
            chassis.base.halt()
        assert stops[0].distance(stops[1].point) < 0.2


@pytest.mark.parametrize("name", ["wooshmap", "wooshmap/wooshmap.yaml"])
def test_paths_go_round_obstacles(name: str) -> None:
    area = load_scene(SHIPPED / name).maps[0]
    planner = Planner(area, 0.5)
    obstacles = Obstacles()
    start, goal = (0.0, 0.0), (6.0, 0.0)

    assert planner.plan(start, goal, obstacles.walls) == [goal]
    obstacles.put("a", 3.0, 0.2, 0.5)
    path = planner.plan(start, goal, obstacles.walls)
    assert path
    assert path[-1] == goal
    for a, b in pairwise([start, *path]):
        for share in range(101):
            x, y = (a[i] + (b[i] - a[i]) * share / 100 for i in (0, 1))
            assert min(wall.distance(x, y) for wall in obstacles.walls) >= 0.48
    # Obstacles are not remembered between searches.
    assert planner.plan(start, goal) == [goal]

    # An obstacle on the goal leaves no path.
    obstacles.put("a", 6.0, 0.3, 0.5)
    assert planner.plan(start, goal, obstacles.walls) is None
    # A ring of obstacles around the start leaves no path.
    for step in range(12):
        angle = step * math.tau / 12
        obstacles.put(f"ring {step}", 2.0 * math.cos(angle), 2.0 * math.sin(angle), 0.4)
    assert planner.plan(start, (8.0, 0.0), obstacles.walls) is None
