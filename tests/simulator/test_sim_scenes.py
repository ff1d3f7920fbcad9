"""Scenes from files: shipped, custom and invalid ones."""

from __future__ import annotations

import io
import math
import random
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.quick_chassis import quick_config
from tests.simulator.sim_wire import JsonClient
from woosh_robot_agent.pb.map.map_pack_pb2 import SceneData
from woosh_robot_agent.protos import message_type
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.simulator.__main__ import main
from woosh_robot_agent.simulator.chassis import TIME_STEP, Chassis
from woosh_robot_agent.simulator.protocol.dispatch import dispatch
from woosh_robot_agent.simulator.scenes import files as scene_files
from woosh_robot_agent.simulator.scenes import library as scenes
from woosh_robot_agent.simulator.scenes.files import load_scene
from woosh_robot_agent.simulator.world.geometry import Pose, Wall
from woosh_robot_agent.simulator.world.maps import MarkKind
from woosh_robot_agent.simulator.world.obstacles import Obstacles
from woosh_robot_agent.simulator.world.picture import draw
from woosh_robot_agent.simulator.world.planner import Planner
from woosh_robot_agent.simulator.yaml_fields import DataFileError

SHIPPED = Path(scenes.__file__).parents[1] / "data"

NAV2 = """
image: {image}
mode: {mode}
resolution: 0.1
origin: [-1.0, -2.0, 0.0]
negate: {negate}
occupied_thresh: 0.65
free_thresh: 0.196
"""


def room_picture(width: int = 60, height: int = 40) -> Image.Image:
    """A white room with black walls around it and a black block in the upper left corner."""
    greys = np.full((height, width), 254, np.uint8)
    greys[0, :] = greys[-1, :] = greys[:, 0] = greys[:, -1] = 0
    greys[5:10, 5:15] = 0
    return Image.fromarray(greys)


def write_map(
    folder: Path,
    image: Image.Image | bytes,
    suffix: str = ".png",
    mode: str = "trinary",
    negate: str = "0",
) -> Path:
    if isinstance(image, Image.Image):
        image.save(folder / f"room{suffix}")
    else:
        (folder / f"room{suffix}").write_bytes(image)
    file = folder / "room.yaml"
    file.write_text(NAV2.format(image=f"room{suffix}", mode=mode, negate=negate))
    return file


def cells(file: Path) -> list[list[int]]:
    grid = load_scene(file).maps[0].grid
    assert grid
    found: list[list[int]] = grid.cells.tolist()
    return found


# Shipped scenes


def test_default_scene_is_wooshmap() -> None:
    chassis = Chassis(quick_config(seed=1))
    assert list(chassis.scenes) == ["wooshmap", "scenex"]
    (area,) = chassis.scene.maps
    assert (area.id, area.name, area.floor, area.version) == (0, "wooshmap", "1F", 147)
    assert (area.low, area.high) == ((-12.0, -10.0), (12.0, 10.0))
    assert len(area.walls) == 19
    assert Wall(12.0, 1.0, 12.0, 10.0) in area.walls
    assert area.marks["A10"].pose == Pose(9.5, 7.0, math.pi / 2)
    assert area.marks["A10"].kind is MarkKind.PALLET_PLATFORM
    assert chassis.base.pose == Pose(4.23276472, -6.6727581, -0.255771846)


def test_every_mark_of_the_shipped_scenes_is_reachable() -> None:
    for scene in scenes.known_scenes()[0].values():
        for area in scene.maps:
            planner = Planner(area, 0.5)
            for mark in area.marks.values():
                assert planner.plan((2.0, 0.0), mark.pose.point), (area.name, mark)


def test_two_chassis_do_not_share_scenes() -> None:
    one, two = Chassis(quick_config()), Chassis(quick_config())
    one.scene.files["a"] = b""
    one.scene.maps.clear()
    assert two.scene.files == {}
    assert two.scene.maps


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


def test_laser_and_base_behave_alike_on_picture_and_walls() -> None:
    walls = Chassis(quick_config(seed=1))
    cells = Chassis(quick_config(seed=1, scenes=(SHIPPED / "wooshmap" / "wooshmap.yaml",)))
    rng = random.Random(3)
    for _ in range(20):
        pose = Pose(rng.uniform(-11, 11), rng.uniform(-9, 9), rng.uniform(-3, 3))
        walls.base.place(pose)
        cells.base.place(pose)
        pairs = list(zip(walls.scan(), cells.scan(), strict=True))
        # Rays that graze a wall, or pass it narrowly, may differ by more than a cell.
        alike = sum(a == b or abs(a - b) < 0.15 for a, b in pairs)
        assert alike > 0.9 * len(pairs)
    for heading in (0.0, 1.0, 2.0, 3.0, -2.0):
        stops = []
        for chassis in (walls, cells):
            chassis.base.place(Pose(2.0, 3.0, heading))
            for _ in range(800):
                dispatch(chassis, message_type("woosh.robot.Twist")(linear=0.5))
                chassis.tick(TIME_STEP)
            assert chassis.base.blocked
            stops.append(chassis.base.pose)
            chassis.base.halt()
        assert stops[0].distance(stops[1].point) < 0.2


def test_planned_paths_are_alike_on_picture_and_walls() -> None:
    walls = load_scene(SHIPPED / "wooshmap").maps[0]
    cells = load_scene(SHIPPED / "wooshmap" / "wooshmap.yaml").maps[0]
    goals = [mark.pose.point for mark in walls.marks.values()]
    start = (-9.5, -7.5)
    for goal in goals[:3] + goals[4:]:
        by_walls, by_cells = (Planner(area, 0.53).plan(start, goal) for area in (walls, cells))
        assert by_walls
        assert by_cells
        lengths = [
            sum(math.dist(a, b) for a, b in pairwise([start, *path]))
            for path in (by_walls, by_cells)
        ]
        assert lengths[0] == pytest.approx(lengths[1], rel=0.05)
        for a, b in pairwise([start, *by_cells]):
            for share in range(51):
                x, y = (a[i] + (b[i] - a[i]) * share / 50 for i in (0, 1))
                assert walls.clearance(x, y) >= 0.43
    planner = Planner(cells, 0.53)
    assert planner.plan(start, (-4.9, -6.0)) is None  # too near to the partition
    assert planner.plan(start, (12.3, 0.0)) is None  # unknown floor
    assert planner.plan((12.3, 0.0), start) is None
    assert planner.plan(start, (99.0, 0.0)) is None


@pytest.mark.parametrize("name", ["wooshmap", "wooshmap/wooshmap.yaml"])
def test_paths_go_round_obstacles(name: str) -> None:
    area = load_scene(SHIPPED / name).maps[0]
    planner = Planner(area, 0.5)
    obstacles = Obstacles()
    start, goal = (0.0, 0.0), (6.0, 0.0)
    behind = planner.plan(start, (-9.5, -7.5))
    assert planner.plan(start, goal, obstacles.walls) == [goal]
    obstacles.put("a", 3.0, 0.2, 0.5)
    path = planner.plan(start, goal, obstacles.walls)
    assert path
    assert path[-1] == goal
    for a, b in pairwise([start, *path]):
        for share in range(101):
            x, y = (a[i] + (b[i] - a[i]) * share / 100 for i in (0, 1))
            assert obstacles.clearance(x, y) >= 0.48
    # Obstacles are not remembered between searches.
    assert planner.plan(start, goal) == [goal]
    obstacles.put("b", -4.5, -1.8, 0.6)  # where the path round the partition turns
    assert planner.plan(start, (-9.5, -7.5), obstacles.walls) != behind
    assert planner.plan(start, (-9.5, -7.5)) == behind
    # An obstacle on the goal leaves no path.
    obstacles.put("a", 6.0, 0.3, 0.5)
    assert planner.plan(start, goal, obstacles.walls) is None
    # A ring of obstacles around the start leaves no path.
    for step in range(12):
        angle = step * math.tau / 12
        obstacles.put(f"ring {step}", 2.0 * math.cos(angle), 2.0 * math.sin(angle), 0.4)
    assert planner.plan(start, (8.0, 0.0), obstacles.walls) is None


# Pictures


@pytest.mark.parametrize(
    ("suffix", "convert"),
    [
        (".png", lambda image: image),
        (".png", lambda image: image.convert("1")),
        (".png", lambda image: image.convert("P")),
        (".png", lambda image: image.convert("RGB")),
        (".png", lambda image: Image.fromarray(np.asarray(image).astype(np.uint16) * 257)),
        (".pgm", lambda image: image),
        (".pgm", lambda image: Image.fromarray(np.asarray(image).astype(np.uint16) * 257)),
    ],
    ids=["png", "png1", "palette", "rgb", "png16", "pgm", "pgm16"],
)
def test_picture_formats_give_equal_grids(
    tmp_path: Path, suffix: str, convert: Callable[[Image.Image], Image.Image]
) -> None:
    expected = cells(write_map(tmp_path, room_picture(), ".png"))
    assert cells(write_map(tmp_path, convert(room_picture()), suffix)) == expected
    assert (len(expected), len(expected[0])) == (40, 60)
    assert expected[39 - 7][10] == 100  # the block, in the seventh row from above
    assert expected[7][10] == 0


def test_plain_pgm_is_read(tmp_path: Path) -> None:
    data = b"P2\n# by hand\n3 2\n100\n0 100 80\n100 0 100\n"
    assert cells(write_map(tmp_path, data, ".pgm")) == [[0, 100, 0], [100, 0, -1]]


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
        assert (area.low, area.high) == ((-1.0, -2.0), pytest.approx((5.0, 2.0)))
    chassis = Chassis(quick_config(seed=1, scenes=(file,)))
    # Without a start pose, the robot starts on free floor.
    assert chassis.gap(chassis.base.pose) > 0.0
    chassis.base.place(Pose(1.0, 0.0, 0.0))
    ahead = chassis.scan()[chassis.laser.rays // 2]
    assert ahead == pytest.approx(5.0 - 0.1 - 1.0 - chassis.laser.forward, abs=0.02)
    assert chassis.clearance(1.0, 0.0) == pytest.approx(math.hypot(0.5, 1.0), abs=0.06)
    assert chassis.clearance(4.0, 0.0) == pytest.approx(0.9, abs=0.06)


def test_unknown_floor_is_transparent_but_not_drivable(tmp_path: Path) -> None:
    greys = np.array(room_picture())
    greys[:, 30:40] = 205
    chassis = Chassis(quick_config(scenes=(write_map(tmp_path, Image.fromarray(greys)),)))
    chassis.base.place(Pose(0.5, -1.0, 0.0))
    assert chassis.scan()[chassis.laser.rays // 2] == pytest.approx(4.15, abs=0.03)
    planner = Planner(chassis.map, 0.3)
    assert planner.plan((0.5, -1.0), (1.5, -1.0)) == [(1.5, -1.0)]
    assert planner.plan((0.5, -1.0), (4.0, -1.0)) is None
    answer = dispatch(
        chassis, message_type("woosh.robot.InitRobot")(pose={"x": 2.5, "y": 0.0, "theta": 0.0})
    )
    assert (answer.ok, "outside map" in answer.msg) == (False, True)


def test_laser_sees_nothing_on_an_empty_grid(tmp_path: Path) -> None:
    file = write_map(tmp_path, Image.fromarray(np.full((80, 80), 254, np.uint8)))
    chassis = Chassis(quick_config(scenes=(file,)))
    assert set(chassis.scan()) == {math.inf}
    assert chassis.clearance(1.0, 1.0) == math.inf
    assert Planner(chassis.map, 0.5).plan((0.0, 0.0), (4.0, 3.0)) == [(4.0, 3.0)]
    chassis.base.place(Pose(-50.0, 0.0, 0.0))
    assert set(chassis.scan()) == {math.inf}


def test_ray_casting_matches_brute_force(tmp_path: Path) -> None:
    """Compare with small steps along each ray."""
    rng = np.random.default_rng(6)
    greys = np.where(rng.random((50, 70)) < 0.03, 0, 254).astype(np.uint8)
    grid = load_scene(write_map(tmp_path, Image.fromarray(greys))).maps[0].grid
    assert grid
    for origin in ((2.0, 0.0), (-1.5, 0.33), (5.99, 2.99)):
        found = grid.cast(origin, -3.0, 0.07, 90, 6.0)
        for ray, distance in enumerate(found):
            angle = -3.0 + 0.07 * ray
            walked = math.inf
            for step in range(6000):
                x = origin[0] + 0.001 * step * math.cos(angle)
                y = origin[1] + 0.001 * step * math.sin(angle)
                column, row = math.floor((x + 1.0) / 0.1), math.floor((y + 2.0) / 0.1)
                if 0 <= column < 70 and 0 <= row < 50 and grid.cells[row, column] == 100:
                    walked = 0.001 * step
                    break
            # The steps may miss a corner that the ray only grazes.
            assert distance == pytest.approx(walked, abs=0.002) or distance < walked


# scene.yaml

SCENE = """
name: lab
start: {map: upstairs, pose: [1.0, 0.0, 0.5]}
maps:
  - name: ground
    walls: [[0, 0, 8, 0, 8, 6, 0, 6, 0, 0]]
    marks:
      - {number: A1, type: rack, pose: [4.0, 3.0, 1.5], description: by the door}
      - {number: "17", pose: [2.0, 2.0, 0.0]}
  - name: upstairs
    id: 9
    floor: 2F
    version: 5
    image: room.yaml
    walls:
      - [3.0, -1.0, 3.0, 1.0]
tasks:
  predefined:
    - {id: 12, name: round, times: 2, steps: [{mark: A1, type: carry}, {mark: "17"}]}
  calls:
    - {id: 13, name: fetch, button: {mac: "00:12", key: 2}, steps: [{mark: A1}]}
"""


def write_scene(folder: Path, text: str = SCENE) -> Path:
    write_map(folder, room_picture())
    (folder / "scene.yaml").write_text(text)
    return folder


def test_custom_scene_is_loaded(tmp_path: Path) -> None:
    chassis = Chassis(quick_config(seed=1, scenes=(write_scene(tmp_path),)))
    assert list(chassis.scenes) == ["wooshmap", "scenex", "lab"]
    assert (chassis.scene.name, chassis.map.name) == ("lab", "upstairs")
    assert chassis.base.pose == Pose(1.0, 0.0, 0.5)
    ground, upstairs = chassis.scene.maps
    assert (ground.id, ground.floor, ground.version) == (0, "1F", 1)
    assert (ground.low, ground.high) == ((0.0, 0.0), (8.0, 6.0))
    assert ground.marks["A1"].kind is MarkKind.RACK
    assert ground.marks["17"].id == 2
    assert (upstairs.id, upstairs.floor, upstairs.version) == (9, "2F", 5)
    # The laser sees both the wall given as a line and the picture behind it.
    chassis.base.place(Pose(1.0, 0.0, 0.0))
    ranges = chassis.scan()
    middle = chassis.laser.rays // 2
    assert ranges[middle] == pytest.approx(2.0 - chassis.laser.forward, abs=0.02)
    assert ranges[middle + 140] > 1.5 / math.cos(0.7)
    answer = dispatch(chassis, message_type("woosh.robot.ExecPreTask")(task_set_id=12))
    assert "mark 17" not in answer.msg
    (repeat,) = chassis.scene.predefined.repeat_tasks
    assert (repeat.times, [task.base.mark_no for task in repeat.task_set.tasks]) == (
        2,
        ["A1", "17"],
    )
    assert [task.base.type for task in repeat.task_set.tasks] == [4, 1]
    (call,) = chassis.scene.calls.call_tasks
    assert call.call_info.events[0].caller.key_id == 2


def test_robot_starts_in_the_first_scene(tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    (tmp_path / "two").mkdir()
    one = write_map(tmp_path / "one", room_picture())
    two = write_scene(tmp_path / "two", SCENE.replace("lab", "wooshmap"))
    chassis = Chassis(quick_config(scenes=(one, two)))
    assert list(chassis.scenes) == ["wooshmap", "scenex", "room"]
    assert chassis.scene.name == "room"
    assert [each.name for each in chassis.scenes["wooshmap"].maps] == ["ground", "upstairs"]


INVALID_SCENES = [
    ("maps:", "mapps:", "scene.yaml: unknown key 'mapps'; use one of name, start, maps, tasks"),
    ("name: ground\n", "floor: x\n", "scene.yaml: maps[0]: name is missing"),
    ("name: ground\n", "name: upstairs\n", "scene.yaml: maps[1]: name upstairs is used twice"),
    ("id: 9", "id: 0", "maps[1]: id 0 is used twice"),
    ("id: 9", "id: -1", "maps[1].id: must be a whole number from 0 to 4294967295, not -1"),
    ("version: 5", "version: true", "maps[1].version: must be a whole number"),
    ("image: room.yaml", "image: attic.yaml", "attic.yaml"),
    ("image: room.yaml", "image: room.png", "room.png: not readable as YAML"),
    ("[3.0, -1.0, 3.0, 1.0]", "[3.0, -1.0, 3.0]", "maps[1].walls[0]: must be [x1, y1, x2, y2]"),
    ("[3.0, -1.0, 3.0, 1.0]", "[3.0, -1.0, .nan, 1.0]", "maps[1].walls[0][2]: must be a number"),
    ("[3.0, -1.0, 3.0, 1.0]", "[3.0, -1.0, 9.0e+9, 1.0]", "is not within 0 to 500 m"),
    (
        "walls: [[0, 0, 8, 0, 8, 6, 0, 6, 0, 0]]",
        "floor: x",
        "maps[0]: a map needs an image or walls",
    ),
    ("type: rack", "type: shelf", "maps[0].marks[0].type: 'shelf' is not one of base, rack,"),
    ("[4.0, 3.0, 1.5]", "[4.0, 3.0]", "marks[0].pose: must be [x, y, theta], not [4.0, 3.0]"),
    (
        '"17", pose',
        "17, pose",
        "marks[1].number: must be a text, not 17; put numbers into quotes",
    ),
    ('"17", pose', "A1, pose", "marks[1]: number A1 is used twice"),
    (
        "map: upstairs, pose",
        "map: attic, pose",
        "start.map: 'attic' is not one of ground",
    ),
    ("mark: A1}]}", "mark: Z9}]}", "calls[0].steps[0].mark: no map of the scene has a mark Z9"),
    ("type: carry", "type: fly", "steps[0].type: 'fly' is not one of pick, parking, charge, carry"),
    ("name: lab", "name: [", "scene.yaml: not readable as YAML"),
    ("name: lab", "name: lab\n<<: {a: 1}", "merge keys (<<) are not supported"),
    ("name: lab", "name: 2025-13-45", "scene.yaml"),
    ("name: lab", "name: " + "[" * 50000, "scene.yaml: nested more than 20 levels"),
    ("name: lab", "name: lab #" + "x" * 300000, "more than 262144"),
    (SCENE, "[]", "scene.yaml: must be a mapping of keys to values"),
    (SCENE, "maps: []", "scene.yaml: maps: a scene needs at least one map"),
]


@pytest.mark.parametrize(("old", "new", "reason"), INVALID_SCENES)
def test_invalid_scenes_are_refused_with_place_and_reason(
    tmp_path: Path, old: str, new: str, reason: str
) -> None:
    assert old in SCENE
    with pytest.raises(DataFileError) as error:
        load_scene(write_scene(tmp_path, SCENE.replace(old, new)))
    assert reason in str(error.value)
    assert len(str(error.value)) < 600


INVALID_MAPS = [
    ("resolution: 0.1", "", "room.yaml: resolution is missing"),
    ("resolution: 0.1", "resolution: 0", "resolution: must be within"),
    ("0.0]", "0.5]", "origin: a rotated map is not supported"),
    ("negate: 0", "negate: 2", "negate: must be 0 or 1"),
    ("trinary", "color", "mode: 'color' is not one of trinary, scale, raw"),
    (
        "free_thresh: 0.196",
        "free_thresh: 0.9",
        "free_thresh: must be at least 0 and less than",
    ),
    ("room.png", "none.png", "none.png: No such file or directory"),
    ("room.png", "room.yaml", "room.yaml: not readable as a PNG or PGM picture"),
]


@pytest.mark.parametrize(("old", "new", "reason"), INVALID_MAPS)
def test_invalid_maps_are_refused_with_place_and_reason(
    tmp_path: Path, old: str, new: str, reason: str
) -> None:
    file = write_map(tmp_path, room_picture())
    text = file.read_text()
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


def test_total_pixels_of_a_scene_are_limited(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scene_files, "_MAX_PIXELS", 2 * 60 * 40)
    maps = "".join(f"  - {{name: m{number}, image: room.yaml}}\n" for number in range(3))
    with pytest.raises(DataFileError, match=r"maps\[2\]: the pictures of the scene have"):
        load_scene(write_scene(tmp_path, f"maps:\n{maps}"))


def test_start_inside_a_wall_is_refused(tmp_path: Path) -> None:
    scene = write_scene(tmp_path, SCENE.replace("[1.0, 0.0, 0.5]", "[2.9, 0.0, 0.5]"))
    with pytest.raises(
        DataFileError, match=r"scene lab: the robot cannot start at .* on map upstairs"
    ):
        Chassis(quick_config(scenes=(scene,)))


def test_program_reports_invalid_scenes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ports = ["--port", "0", "--tcp-port", "0"]
    assert main([*ports, "--scene", str(tmp_path / "none")]) == 1
    assert main([*ports, "--scene", str(tmp_path)]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    first, second = err.splitlines()
    assert first.startswith(f"error: {tmp_path}")
    assert "not a scene: give a scene.yaml" in second


# Scene data sent to clients


def test_scene_data_contains_the_pictures_of_maps(tmp_path: Path) -> None:
    config = quick_config(port=0, tcp_port=0, seed=1, scenes=(write_scene(tmp_path),))
    with SimulatorThread(config) as simulator:
        client = JsonClient(simulator.port)
        easy = client.ask("woosh.map.SceneDataEasy")
        data = client.ask("woosh.map.SceneData")
        client.close()
        answered = simulator.call(lambda s: dispatch(s.chassis, SceneData()).body)
    assert [each["name"] for each in easy["maps"]] == ["ground", "upstairs"]
    assert [each["id"] for each in data["maps"]] == [0, 9]
    assert isinstance(answered, SceneData)
    ground, upstairs = answered.maps
    assert (ground.mark_info.version, ground.mark_info.floor_name) == (1, "1F")
    rack, base = ground.mark_info.storages
    assert (rack.identity.no, rack.WhichOneof("category")) == ("A1", "rack")
    assert (base.identity.no, base.WhichOneof("category")) == ("17", None)
    assert answered.task_info.repeat_tasks[0].task_set.base.id == 12
    assert upstairs.resolution == pytest.approx(0.1)
    assert (upstairs.origin.x, upstairs.origin.y) == (-1.0, -2.0)
    with Image.open(io.BytesIO(upstairs.map_png)) as image:
        greys = np.asarray(image)
    expected = np.array(room_picture())
    expected[10:30, 40] = 0  # the wall at x = 3 from y = -1 to 1
    assert np.count_nonzero(greys != expected) <= 2
    with Image.open(io.BytesIO(ground.map_png)) as image:
        greys = np.asarray(image)[::-1]
    x, y = (
        (value - low) / ground.resolution
        for value, low in ((8.0, ground.origin.x), (3.0, ground.origin.y))
    )
    assert greys[int(y), int(x)] == 0
    assert greys[int(y), int(x) - 10] == 254
    assert greys[int(y), int(x) + 5] == 205


def test_every_kind_of_mark_has_its_category() -> None:
    body = dispatch(Chassis(quick_config()), SceneData()).body
    assert isinstance(body, SceneData)
    (area,) = body.maps
    kinds = {each.identity.no: each.WhichOneof("category") for each in area.mark_info.storages}
    assert kinds["C1"] == "charger"
    assert kinds["A10"] == "pallet_platform"
    assert kinds["7613B5D"] is None
    assert len({kind for kind in kinds.values() if kind}) == 8
