"""Limits on the search of a path, which blocks the simulator."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from tests.quick_chassis import quick_config
from woosh_robot_agent.simulator.behaviour.navigation import Navigate
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.world.geometry import Point, Pose
from woosh_robot_agent.simulator.world.grid import Grid
from woosh_robot_agent.simulator.world.growing_grid import FREE, OCCUPIED
from woosh_robot_agent.simulator.world.maps import Map
from woosh_robot_agent.simulator.world.planner import Planner

RADIUS = 0.5


def serpentine(cells: int) -> Map:
    """Return a map with a single path that winds to and fro, with cells of 0.05 m."""
    floor = np.full((cells, cells), FREE, np.int8)
    for number, row in enumerate(range(40, cells, 40)):
        wall = floor[row : row + 2]
        (wall[:, 60:] if number % 2 else wall[:, :-60])[:] = OCCUPIED
    grid = Grid(floor, 0.05, (0.0, 0.0))
    return dataclasses.replace(
        Chassis(quick_config()).map, walls=(), grid=grid, marks={}, low=grid.low, high=grid.high
    )


def test_winding_path_is_found_with_few_line_checks(monkeypatch: pytest.MonkeyPatch) -> None:
    checks = 0
    check = Planner._free

    def counted(self: Planner, *arguments: object) -> bool:
        nonlocal checks
        checks += 1
        return check(self, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(Planner, "_free", counted)
    area = serpentine(1000)
    start: Point = (1.0, 1.0)
    path = Planner(area, RADIUS).plan(start, (49.0, 49.0))
    assert path
    assert len(path) < 100
    assert checks < 2000
    assert area.grid
    for corner in path:
        assert area.grid.line_room(start, corner) >= RADIUS - 0.05
        start = corner


def test_navigation_beyond_the_budget_fails_with_a_hint(chassis: Chassis) -> None:
    chassis.map = serpentine(1600)
    start, far = Pose(1.0, 1.0, 0.0), Pose(79.0, 79.0, math.pi)
    chassis.base.place(start)
    progress = Navigate(far, via=(far, start) * 3).tick(chassis, 0.05)
    assert progress.done
    assert "too long or too winding to plan: choose a nearer goal" in progress.failure
