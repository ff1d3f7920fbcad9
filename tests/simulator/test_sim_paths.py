"""Paths: planned without driving them, and navigation along many poses that clients give."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from tests.quick_chassis import execute
from tests.simulator.recorded_chassis import Frame, SteppedChassis, ask
from tests.simulator.sim_wire import Json, JsonClient
from woosh_robot_agent.simulator.behaviour import navigation
from woosh_robot_agent.simulator.behaviour.navigation import Navigate
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.world.geometry import Pose
from woosh_robot_agent.simulator.world.grid import Grid
from woosh_robot_agent.simulator.world.growing_grid import FREE, OCCUPIED
from woosh_robot_agent.simulator.world.maps import Map
from woosh_robot_agent.simulator.world.planner import SearchBudget

PLAN = "woosh.robot.PlanNavPath"
NAV_PATH, CALL = "woosh.robot.NavPath", "woosh.ros.CallAction"
SUCCESS, EXECUTING, PAUSE = 1, 2, 3
WEST = {"x": -9.5, "y": -7.5, "theta": 3.0}
"""Behind a partition, as seen from the start."""


def poses(body: Json) -> list[Json]:
    found: list[Json] = body["path"]["poses"]
    return found


def test_path_leads_around_the_walls_and_nothing_moves(client: JsonClient) -> None:
    before = client.simulator.state
    answer = client.request(PLAN, {"start": {"x": 4.0, "y": -6.0, "theta": 1.0}, "end": WEST})
    assert (answer["type"], answer["ok"]) == (NAV_PATH, True)
    path = poses(answer["body"])
    assert path[0] == pytest.approx({"x": 4.0, "y": -6.0, "theta": 1.0})
    assert path[-1] == pytest.approx(WEST)

    assert any(pose["y"] > -2.5 for pose in path)  # the end of the partition
    now = client.simulator.state
    assert (now.pose, now.odometer) == (before.pose, before.odometer)
    assert now.info.state == before.info.state
    assert poses(client.ask(NAV_PATH)) == []


def test_navigation_takes_the_planned_path(client: JsonClient) -> None:
    client.subscribe(NAV_PATH)
    planned = poses(client.ask(PLAN, {"end": WEST}))
    client.ask("woosh.robot.ExecTask", {"taskId": 5, "type": 1, "pose": WEST})
    driven = client.next_push(NAV_PATH, lambda body: bool(poses(body)))
    assert poses(driven) == planned
    (segment,) = client.ask("woosh.robot.PlanPath")["planPath"]
    assert poses(segment) == planned
    client.ask("woosh.robot.ActionOrder", {"order": 4})
    assert poses(client.next_push(NAV_PATH)) == []


def test_path_can_be_planned_during_a_task_and_in_any_mode(client: JsonClient) -> None:
    client.ask("woosh.robot.ExecTask", {"taskId": 5, "type": 1, "pose": WEST})
    client.ask("woosh.robot.SwitchWorkMode", {"mode": 1})
    assert poses(client.ask(PLAN, {"end": {"x": 0.0, "y": 0.0}}))


REFUSED: list[tuple[Json, str]] = [
    ({}, "PlanNavPath has no end"),
    ({"end": {"x": 99.0}}, "pose (99.00, 0.00, 0.00) is outside map wooshmap"),
    ({"end": {"x": -5.0, "y": -6.0}}, "pose (-5.00, -6.00, 0.00) is inside a wall"),
    ({"end": {"x": 0.0, "y": -4.0}}, "no free path to (0.00, -4.00, 0.00): choose a goal"),
    ({"start": {"y": 99.0}, "end": {}}, "pose (0.00, 99.00, 0.00) is outside map"),
    ({"end": WEST, "tolerance": -0.5}, "tolerance -0.5 is negative"),
    ({"end": WEST, "tolerance": 0.5}, "the path has a detour of 4.03 m, more than"),
    ({"end": {"x": "NaN"}}, "end.x is not a finite number"),
]


def test_path_that_cannot_be_planned_is_refused(client: JsonClient) -> None:
    for body, reason in REFUSED:
        assert client.refusal(PLAN, body).startswith(reason)


def test_detour_within_the_tolerance_is_planned(chassis: Chassis) -> None:
    assert execute(chassis, PLAN, end=WEST, tolerance=10.0).ok
    ahead = {"x": 5.0, "y": -6.0}
    assert execute(chassis, PLAN, start={"x": 4.0, "y": -6.0}, end=ahead, tolerance=0.01).ok


def test_start_must_be_given_while_the_robot_does_not_know_its_pose(chassis: Chassis) -> None:
    chassis.lose_localisation()
    assert execute(chassis, PLAN, end=WEST).msg.startswith("robot has lost its localisation")
    assert execute(chassis, PLAN, start={"x": 4.0, "y": -6.0}, end=WEST).ok
    chassis.readiness.initialised = False
    assert execute(chassis, PLAN, end=WEST).msg.startswith("robot is not initialised")


def serpentine(area: Map, cells: int) -> Map:
    """Return the map with a single path that winds to and fro, with cells of 0.05 m."""
    floor = np.full((cells, cells), FREE, np.int8)
    for number, row in enumerate(range(40, cells, 40)):
        wall = floor[row : row + 2]
        (wall[:, 60:] if number % 2 else wall[:, :-60])[:] = OCCUPIED
    grid = Grid(floor, 0.05, (0.0, 0.0))
    return dataclasses.replace(area, walls=(), grid=grid, marks={}, low=grid.low, high=grid.high)


def test_navigation_beyond_the_budget_fails_with_a_hint(
    chassis: Chassis, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(navigation, "SearchBudget", lambda: SearchBudget(5000))
    chassis.map = serpentine(chassis.map, 300)
    start, far = Pose(1.0, 1.0, 0.0), Pose(14.0, 14.0, math.pi)
    chassis.base.place(start)
    assert not Navigate(far).tick(chassis, 0.05).done
    # All legs together exceed it.
    progress = Navigate(far, via=(far, start) * 3).tick(chassis, 0.05)
    assert progress.done
    assert "too long or too winding to plan: choose a nearer goal" in progress.failure


def points(path: Callable[[float], tuple[float, float, float]]) -> list[Json]:
    """Return poses along a path, which is a function of the length from its start, in metres."""
    places = [path(0.03 * number) for number in range(120)]
    return [{"x": x, "y": y, "theta": theta} for x, y, theta in places]


PATHS = {
    "line": points(lambda s: (-2.0 + s, -2.0, 0.0)),
    "line without headings": points(lambda s: (4.0, -6.0 + s, 0.0)),
    "arc": points(lambda s: (4 + 1.5 * math.sin(s / 1.5), -4 - 1.5 * math.cos(s / 1.5), s / 1.5)),
    "waves": points(lambda s: (-3.0 + s, -2.0 + 0.3 * math.sin(2.0 * s), 0.0)),
}


@pytest.mark.parametrize("name", ["line without headings", "arc", "waves"])
def test_points_of_a_path_are_passed_without_stopping(name: str) -> None:
    poses = PATHS[name]
    chassis = SteppedChassis(profile="instant")
    first, last = poses[0], poses[-1]
    chassis.chassis.base.place(Pose(first["x"], first["y"], 0.0))
    places = [(each["x"], each["y"]) for each in poses]
    length = sum(math.dist(here, there) for here, there in pairwise(places))
    before, start = len(chassis.frames), chassis.chassis.elapsed
    ask(chassis, CALL, moveBase={"action": 1, "executionMode": 1, "poses": poses})
    off = 0.0
    while not (found := feedback_end(chassis.frames[before:])):
        chassis.run(0.05)
        here = chassis.chassis.pose.point
        off = max(off, min(math.dist(here, each) for each in places))
    assert found == SUCCESS
    # At 0.8 m/s, and with turns on the spot at both ends.
    assert chassis.chassis.elapsed - start < length / 0.8 + 6.0
    assert off < 0.05
    assert chassis.chassis.pose.distance(places[-1]) < 0.005
    assert math.remainder(chassis.chassis.pose.theta - last["theta"], math.tau) == pytest.approx(
        0.0, abs=0.005
    )


def feedback_end(frames: list[Frame]) -> int:
    """Return the state with which an action ended, 0 if it has not ended."""
    states = [
        each["state"] for frame in frames if "fbs" in frame.body for each in frame.body["fbs"]
    ]
    return next((state for state in states if state not in (EXECUTING, PAUSE)), 0)


def test_robot_on_a_path_of_points_stops_before_an_obstacle() -> None:
    chassis = SteppedChassis(profile="instant")
    chassis.chassis.base.place(Pose(-2.0, -2.0, 0.0))
    ask(chassis, CALL, moveBase={"action": 1, "executionMode": 1, "poses": PATHS["line"]})
    chassis.run(2.0)
    x = chassis.chassis.pose.x + 1.5
    chassis.chassis.obstacles.put("box", x, -2.0, 0.3)
    chassis.run(4.0)
    assert not chassis.chassis.base.moving
    assert chassis.chassis.impeded
    assert 0.7 < chassis.chassis.pose.distance((x, -2.0)) < 1.3
    chassis.chassis.obstacles.clear()
    chassis.run(20.0)
    assert chassis.chassis.pose.distance((1.57, -2.0)) < 0.005


def test_robot_turns_to_the_headings_of_distant_poses_one_by_one() -> None:
    chassis = SteppedChassis(profile="instant")
    chassis.chassis.base.place(Pose(2.0, -6.0, 0.0))
    poses = [{"x": 4, "y": -6, "theta": 2.0}, {"x": 5, "y": -6, "theta": 0}]
    ask(chassis, CALL, moveBase={"action": 1, "executionMode": 1, "poses": poses})
    headings = set()
    for _ in range(400):
        chassis.run(0.05)
        if chassis.chassis.pose.distance((4.0, -6.0)) < 0.01:
            headings.add(round(chassis.chassis.pose.theta, 2))
    assert 2.0 in headings
