"""Maps from pictures, as nav2's map_server reads them."""

from __future__ import annotations

import io
import math
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.quick_chassis import execute, quick_config
from tests.simulator.map_files import cells, room_picture, write_map
from woosh_robot_agent.data_files import DataFileError
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.scenes.files import load_scene
from woosh_robot_agent.simulator.world.geometry import Pose
from woosh_robot_agent.simulator.world.planner import Planner


def test_picture_formats_give_equal_grids(tmp_path: Path) -> None:
    room = room_picture()
    deep = Image.fromarray(np.asarray(room).astype(np.uint16) * 257)
    expected = cells(write_map(tmp_path, room, ".png"))
    for picture in (room.convert("1"), room.convert("P"), room.convert("RGB"), deep):
        assert cells(write_map(tmp_path, picture, ".png")) == expected
    for picture in (room, deep):
        assert cells(write_map(tmp_path, picture, ".pgm")) == expected
    assert (len(expected), len(expected[0])) == (40, 60)
    assert expected[39 - 7][10] == 100  # the block, in the seventh row from above
    assert expected[7][10] == 0
    plain = b"P2\n# by hand\n3 2\n100\n0 100 80\n100 0 100\n"
    assert cells(write_map(tmp_path, plain, ".pgm")) == [[0, 100, 0], [100, 0, -1]]


def test_modes_and_negate_work_as_in_map_server(tmp_path: Path) -> None:
    """The expected cells are those of nav2's map_server."""
    greys = Image.fromarray(np.array([[0, 60, 100, 205, 206, 254]], np.uint8))
    assert cells(write_map(tmp_path, greys)) == [[100, 100, -1, -1, 0, 0]]
    assert cells(write_map(tmp_path, greys, negate="1")) == [[0, -1, -1, 100, 100, 100]]
    assert cells(write_map(tmp_path, greys, negate="true")) == [[0, -1, -1, 100, 100, 100]]
    assert cells(write_map(tmp_path, greys, mode="scale")) == [[100, 100, 91, 0, 0, 0]]
    assert cells(write_map(tmp_path, greys, mode="raw")) == [[0, 60, 100, -1, -1, -1]]
    clear = greys.convert("RGBA")
    clear.putpixel((0, 0), (0, 0, 0, 0))
    # Trinary counts opacity as a fourth colour: an opaque black is 0.75 occupied.
    assert cells(write_map(tmp_path, clear)) == [[100, -1, -1, 0, 0, 0]]
    assert cells(write_map(tmp_path, clear, mode="scale")) == [[-1, 100, 91, 0, 0, 0]]


def test_nav2_map_alone_is_a_scene(tmp_path: Path) -> None:
    file = write_map(tmp_path, room_picture())
    for path in (file, tmp_path):
        scene = load_scene(path)
        (area,) = scene.maps
        assert (scene.name, area.name) == ("room" if path is file else tmp_path.name, "room")
        assert area.id == 1  # the id 0 stands for no map
        assert (area.low, area.high) == ((-1.0, -2.0), pytest.approx((5.0, 2.0)))
    chassis = Chassis(quick_config(seed=1, scenes=(file,)))
    # Without a start pose, the robot starts on free floor.
    assert chassis.gap(chassis.base.pose) > 0.0
    chassis.base.place(Pose(1.0, 0.0, 0.0))
    ahead = chassis.scan()[chassis.laser.rays // 2]
    assert ahead == pytest.approx(5.0 - 0.1 - 1.0 - chassis.laser.forward, abs=0.02)
    assert chassis.map.clearance(1.0, 0.0) == pytest.approx(math.hypot(0.5, 1.0), abs=0.06)
    assert chassis.map.clearance(4.0, 0.0) == pytest.approx(0.9, abs=0.06)


def test_unknown_floor_is_transparent_but_not_drivable(tmp_path: Path) -> None:
    greys = np.array(room_picture())
    greys[:, 30:40] = 205
    chassis = Chassis(quick_config(scenes=(write_map(tmp_path, Image.fromarray(greys)),)))
    chassis.base.place(Pose(0.5, -1.0, 0.0))
    assert chassis.scan()[chassis.laser.rays // 2] == pytest.approx(4.15, abs=0.03)
    planner = Planner(chassis.map, 0.3)
    assert planner.plan((0.5, -1.0), (1.5, -1.0)) == [(1.5, -1.0)]
    assert planner.plan((0.5, -1.0), (4.0, -1.0)) is None
    assert planner.plan((2.5, -1.0), (0.5, -1.0)) is None
    answer = execute(chassis, "woosh.robot.InitRobot", pose={"x": 2.5, "y": 0.0, "theta": 0.0})
    assert (answer.ok, "outside map" in answer.msg) == (False, True)


def test_laser_sees_nothing_on_an_empty_grid(tmp_path: Path) -> None:
    file = write_map(tmp_path, Image.fromarray(np.full((80, 80), 254, np.uint8)))
    chassis = Chassis(quick_config(scenes=(file,)))
    assert set(chassis.scan()) == {math.inf}
    assert chassis.map.clearance(1.0, 1.0) == math.inf
    assert Planner(chassis.map, 0.5).plan((0.0, 0.0), (4.0, 3.0)) == [(4.0, 3.0)]
    chassis.base.place(Pose(-50.0, 0.0, 0.0))
    assert set(chassis.scan()) == {math.inf}


INVALID_MAPS = [
    ("resolution: 0.1", "resolution: 0", "resolution: must be a number from 0.001 to 10"),
    ("0.0]", "0.5]", "origin: a rotated map is not supported"),
    ("negate: 0", "negate: 2", "negate: 2 is not one of 0, 1"),
    (
        "free_thresh: 0.196",
        "free_thresh: 0.9",
        "free_thresh (0.9) must be at least 0 and less than",
    ),
    ("room.png", "none.png", "none.png: No such file or directory"),
    ("room.png", "room.yaml", "room.yaml: not readable as a PNG or PGM picture"),
]


def test_invalid_maps_are_refused_with_place_and_reason(tmp_path: Path) -> None:
    file = write_map(tmp_path, room_picture())
    text = file.read_text()
    for old, new, reason in INVALID_MAPS:
        assert old in text
        file.write_text(text.replace(old, new))
        with pytest.raises(DataFileError) as error:
            load_scene(file)
        assert reason in str(error.value)


def test_invalid_pictures_are_refused_with_a_reason(tmp_path: Path) -> None:
    buffer = io.BytesIO()
    room_picture().save(buffer, "PNG")
    good = buffer.getvalue()
    jpeg = io.BytesIO()
    room_picture().save(jpeg, "JPEG")
    for data, reason in (
        (b"P5 9000 9000 255\n", "9000 x 9000 pixels are not within"),
        (b"P5 40000 40000 255\n", "exceeds limit"),
        (good[: len(good) // 2], "not readable as a PNG or PGM"),
        (good[:20], "not readable as a PNG or PGM"),
        (b"", "not readable as a PNG or PGM"),
        (b"P2 3 1 255 1 x 3", "not readable as a PNG or PGM"),
        (jpeg.getvalue(), "not readable as a PNG or PGM"),
    ):
        file = write_map(tmp_path, data)
        with pytest.raises(DataFileError, match=r"room\.png: ") as error:
            load_scene(file)
        assert reason in str(error.value)
