"""Maps that were made by driving: how they resemble the hall, and driving in them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from tests.simulator.map_files import room_picture, write_map
from tests.simulator.mapping import (
    BUILD_MAP_DATA,
    SWITCH_MAP,
    TWIST,
    UPDATE,
    at,
    drive,
    picture,
    save_map,
    start_mapping,
    turn_around,
    use_map,
)
from tests.simulator.recorded_chassis import SteppedChassis, ask, pushed
from woosh_robot_agent.simulator.world.geometry import Pose, Wall
from woosh_robot_agent.simulator.world.grid import Grid
from woosh_robot_agent.simulator.world.growing_grid import FREE, OCCUPIED, UNKNOWN, GrowingGrid
from woosh_robot_agent.simulator.world.maps import Map


def in_made_map() -> SteppedChassis:
    """Return a chassis that has made a map of a part of the hall, ready for tasks."""
    chassis = SteppedChassis(profile="instant")
    start_mapping(chassis)
    drive(chassis, (2.0, -7.0), (-2.5, -6.0))
    save_map(chassis)
    use_map(chassis)
    return chassis


def places(grid: Grid, value: int) -> list[tuple[float, float]]:
    """Return the centres of the cells with a value."""
    rows, columns = np.nonzero(grid.cells == value)
    return [
        (
            grid.low[0] + (float(column) + 0.5) * grid.resolution,
            grid.low[1] + (float(row) + 0.5) * grid.resolution,
        )
        for row, column in zip(rows, columns, strict=True)
    ]


def value_at(grid: Grid, x: float, y: float) -> int:
    column = math.floor((x - grid.low[0]) / grid.resolution)
    row = math.floor((y - grid.low[1]) / grid.resolution)
    return int(grid.cells[row, column])


def made_grid(area: Map) -> Grid:
    assert area.grid
    return area.grid


def test_map_made_by_driving_shows_what_the_robot_has_seen() -> None:
    grid, hall = made_grid(in_made_map().chassis.map), SteppedChassis().chassis.map

    # What the map shows is there.
    free, occupied = places(grid, FREE)[::23], places(grid, OCCUPIED)
    really_free = [hall.contains(*place) and hall.clearance(*place) > 0.02 for place in free]
    assert sum(really_free) >= 0.995 * len(free)
    assert all(hall.clearance(*place) <= 0.05 for place in occupied)

    # What is around the way of the robot is shown by the map.
    around = [
        (-3.5 + 0.31 * column, -9.5 + 0.31 * row) for column in range(25) for row in range(15)
    ]
    floor = [place for place in around if hall.clearance(*place) > 0.5]
    shown = [value_at(grid, *place) == FREE for place in floor]
    assert sum(shown) >= 0.98 * len(floor)
    wall = [(-4.0 + 0.2 * step, -10.0) for step in range(40)]
    near = (-0.05, 0.0, 0.05)
    shown = [
        any(value_at(grid, x + dx, y + dy) == OCCUPIED for dx in near for dy in near)
        for x, y in wall
    ]
    assert sum(shown) >= 0.97 * len(wall)


def test_robot_collides_with_walls_that_its_map_lacks() -> None:
    chassis = in_made_map()
    model = chassis.chassis
    grid = made_grid(model.map)
    emptied = Grid(np.full_like(grid.cells, FREE), grid.resolution, grid.low)
    model.change_map(grid=emptied)
    for _ in range(100):
        if model.base.blocked:
            break
        chassis.request(TWIST, linear=0.8)
        chassis.run(0.2)
    assert model.base.blocked
    assert model.gap(model.base.pose) >= 0.0
    assert model.scan()[model.laser.rays // 2] < 1.0


def test_walls_stay_where_they_are_when_a_made_map_is_left_or_uploaded() -> None:
    chassis = in_made_map()
    model = chassis.chassis
    walls, hall, end, marks = model.walls, model.ground_truth, model.map.end, dict(model.map.marks)
    cells = made_grid(model.map).cells
    files = ask(chassis, "woosh.map.Download", sceneName="new").body["fileDatas"]
    ask(chassis, "woosh.map.Upload", sceneName="new", fileDatas=files)
    assert model.ground_truth is hall
    assert model.map.end == end
    assert model.map.marks == marks
    assert (made_grid(model.map).cells == cells).all()
    for scene in ("wooshmap", "new"):
        ask(chassis, SWITCH_MAP, sceneName=scene)
        assert model.walls == walls
    ask(chassis, SWITCH_MAP, sceneName="scenex")
    assert model.walls != walls
    # On another robot the files are all there is.
    other = SteppedChassis(profile="instant")
    ask(other, "woosh.map.Upload", sceneName="new", fileDatas=files)
    ask(other, SWITCH_MAP, sceneName="new")
    assert other.chassis.ground_truth is other.chassis.map


def test_update_continues_the_map() -> None:
    chassis = SteppedChassis(profile="instant")
    model = chassis.chassis
    before = model.map
    model.obstacles.put("box", 2.0, -7.0, 0.3)
    start_mapping(chassis, UPDATE, "wooshmap", "wooshmap")
    turn_around(chassis)
    first = pushed(chassis, BUILD_MAP_DATA)[0].body
    assert at(first, picture(first), -10.0, -9.0) == 254  # pictures begin with the whole map
    save_map(chassis)
    after, grid = model.map, made_grid(model.map)
    assert (after.id, after.name, after.version) == (before.id, before.name, before.version + 1)
    assert after.marks == before.marks
    assert model.scene.predefined == SteppedChassis().chassis.scene.predefined
    assert value_at(grid, 2.3, -7.0) == OCCUPIED  # the side of the box that the robot sees
    assert value_at(grid, -10.0, -9.0) == FREE  # known, but out of sight
    assert value_at(grid, -12.0, -9.0) == OCCUPIED
    # The box has gone: another update forgets it.
    model.obstacles.clear()
    ask(chassis, "woosh.robot.InitRobot", isRecord=True)
    start_mapping(chassis, UPDATE, "wooshmap", "wooshmap")
    turn_around(chassis)
    save_map(chassis)
    assert value_at(made_grid(model.map), 2.3, -7.0) == FREE
    assert model.map.version == before.version + 2
    assert model.ground_truth is before


def test_updated_picture_keeps_its_cells_and_is_downloaded(tmp_path: Path) -> None:
    chassis = SteppedChassis(profile="instant", scenes=(write_map(tmp_path, room_picture()),))
    before = made_grid(chassis.chassis.map)
    chassis.chassis.obstacles.put("box", 3.0, -1.0, 0.3)
    start_mapping(chassis, UPDATE, "room", "room")
    turn_around(chassis)
    save_map(chassis)
    after = made_grid(chassis.chassis.map)
    assert after.resolution == before.resolution == 0.1
    differing = [
        place
        for place in places(before, OCCUPIED) + places(before, FREE)
        if value_at(after, *place) != value_at(before, *place)
    ]
    beside = [place for place in differing if math.dist(place, (3.0, -1.0)) > 0.4]
    assert len(beside) <= 0.005 * before.cells.size, beside
    assert len(differing) > len(beside), "the box is shown"
    files = ask(chassis, "woosh.map.Download", sceneName="room").body["fileDatas"]
    other = SteppedChassis(profile="instant")
    ask(other, "woosh.map.Upload", sceneName="room", fileDatas=files)
    ask(other, SWITCH_MAP, sceneName="room")
    assert (made_grid(other.chassis.map).cells == after.cells).all()


def test_distant_wall_keeps_the_cells_that_no_ray_hits() -> None:
    """Rays along a wall hit only some of its cells. The others must not become free."""
    grid, wall = GrowingGrid(), Wall(-10.0, 1.0, 30.0, 1.0)
    increment = 0.005
    angles = [
        math.pi / 2 - increment * ray for ray in range(round((math.pi / 2 - 0.04) / increment))
    ]
    near = [wall.y1 / math.sin(angle) for angle in angles]
    first = angles[0]
    for x in (0.0, 5.0, 10.0, *[0.0] * 100):
        grid.add_scan(Pose(x, 0.0, 0.0), first, -increment, near)
    made = Grid(*grid.raster())
    found = [value_at(made, 0.05 * column, 1.0) for column in range(2, 300)]
    assert set(found) == {OCCUPIED, UNKNOWN}
    assert found.count(OCCUPIED) > 0.8 * len(found)
