"""Requests that would take long: none of them holds up the others."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from tests.simulator.sim_wire import JsonClient
from woosh_robot_agent.simulator import SimulatorConfig
from woosh_robot_agent.simulator.behaviour.navigation import Navigate
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.world.geometry import Point, Pose
from woosh_robot_agent.simulator.world.grid import FREE, OCCUPIED, Grid
from woosh_robot_agent.simulator.world.maps import Map
from woosh_robot_agent.simulator.world.planner import Planner, SearchBudget, SearchBudgetError

RADIUS = 0.5


def serpentine(cells: int) -> Map:
    """A map of one way that goes to and fro, with cells of 0.05 m."""
    floor = np.full((cells, cells), FREE, np.int8)
    for number, row in enumerate(range(40, cells, 40)):
        wall = floor[row : row + 2]
        (wall[:, 60:] if number % 2 else wall[:, :-60])[:] = OCCUPIED
    grid = Grid(floor, 0.05, (0.0, 0.0))
    return dataclasses.replace(
        Chassis(SimulatorConfig()).map, walls=(), grid=grid, marks={}, low=grid.low, high=grid.high
    )


def test_a_winding_way_takes_few_looks(monkeypatch: pytest.MonkeyPatch) -> None:
    looks = 0
    look = Planner._free

    def counted(self: Planner, *arguments: object) -> bool:
        nonlocal looks
        looks += 1
        return look(self, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(Planner, "_free", counted)
    area = serpentine(1000)
    start: Point = (1.0, 1.0)
    path = Planner(area, RADIUS).plan(start, (49.0, 49.0))
    assert path
    assert len(path) < 100
    assert looks < 2000
    assert area.grid
    for corner in path:
        assert area.grid.line_room(start, corner) >= RADIUS - 0.05
        start = corner


def test_a_way_that_is_too_long_is_given_up() -> None:
    with pytest.raises(SearchBudgetError):
        Planner(serpentine(400), RADIUS).plan((1.0, 1.0), (19.0, 19.0), budget=SearchBudget(1000))


def test_legs_share_the_effort() -> None:
    planner, budget = Planner(serpentine(400), RADIUS), SearchBudget(8000)
    assert planner.plan((1.0, 1.0), (19.0, 19.0), budget=budget)
    with pytest.raises(SearchBudgetError):
        planner.plan((19.0, 19.0), (1.0, 1.0), budget=budget)


def test_a_navigation_that_is_too_long_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SearchBudget.__init__, "__defaults__", (10,))
    chassis = Chassis(SimulatorConfig())
    progress = Navigate(Pose(-9.5, -4.0, math.pi)).tick(chassis, 0.05)
    assert progress.done
    assert "too long or too winding to plan: choose a nearer goal" in progress.failure


def test_steps_are_limited(client: JsonClient) -> None:
    steps = [{"mode": 1, "value": 0.001}] * 1001
    control = {"stepControl": {"steps": steps, "action": 1}}
    text = client.refused("woosh.ros.CallAction", control)
    assert text == "StepControl has 1001 steps, more than 1000: split it into several requests"
