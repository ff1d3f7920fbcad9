"""Scenes from files: custom, invalid and shipped ones."""

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
from tests.simulator.map_files import room_picture, write_map
from tests.simulator.sim_wire import JsonClient
from woosh_robot_agent.data_files import DataFileError
from woosh_robot_agent.pb.map.map_pack_pb2 import SceneData
from woosh_robot_agent.simulator.__main__ import main
from woosh_robot_agent.simulator.chassis import TIME_STEP, Chassis
from woosh_robot_agent.simulator.profile import load_profile
from woosh_robot_agent.simulator.protocol.handlers import dispatch
from woosh_robot_agent.simulator.scene_check import check_scene
from woosh_robot_agent.simulator.scenes import files as scenes
from woosh_robot_agent.simulator.scenes import robot_files
from woosh_robot_agent.simulator.scenes.files import load_scene
from woosh_robot_agent.simulator.world.geometry import Pose
from woosh_robot_agent.simulator.world.maps import MarkKind, Obstacles
from woosh_robot_agent.simulator.world.picture import draw
from woosh_robot_agent.simulator.world.planner import Planner

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


def test_maps_without_an_id_get_one_that_is_not_0(tmp_path: Path) -> None:
    text = "maps:\n"
    for number, key in enumerate(("", "id: 1, ", "", "id: 0, ")):
        text += f"  - {{name: m{number}, {key}walls: [[0, 0, 9, 0, 9, 9]]}}\n"
    (tmp_path / "scene.yaml").write_text(text)
    # Logs of real robots have maps with the id 0, too.
    assert [area.id for area in load_scene(tmp_path).maps] == [2, 1, 3, 0]


def test_custom_scene_is_loaded_and_the_robot_starts_in_the_first_one(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    other = write_scene(tmp_path / "other", SCENE.replace("lab", "wooshmap"))
    chassis = Chassis(quick_config(seed=1, scenes=(write_scene(tmp_path), other)))
    assert list(chassis.scenes) == ["wooshmap", "scenex", "lab"]
    assert [each.name for each in chassis.scenes["wooshmap"].maps] == ["ground", "upstairs"]
    assert (chassis.scene.name, chassis.map.name) == ("lab", "upstairs")
    assert chassis.base.pose == Pose(1.0, 0.0, 0.5)
    ground, upstairs = chassis.scene.maps
    assert (ground.id, ground.floor, ground.version) == (1, "1F", 1)
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
    answer = execute(chassis, "woosh.robot.ExecPreTask", task_set_id=12)
    assert "mark 17" not in answer.msg
    (repeat,) = chassis.scene.predefined.repeat_tasks
    assert repeat.times == 2
    tasks = [(task.base.mark_no, task.base.type) for task in repeat.task_set.tasks]
    assert tasks == [("A1", 4), ("17", 1)]
    (call,) = chassis.scene.calls.call_tasks
    assert call.call_info.events[0].caller.key_id == 2


INVALID_SCENES = [
    ("maps:", "mapps:", "scene.yaml: unknown key 'mapps'; use one of maps, name, start, tasks"),
    ("name: ground\n", "name: upstairs\n", "scene.yaml: maps[1]: name upstairs is used twice"),
    ("name: ground\n", "name: ground\n    id: 9\n", "maps[1]: id 9 is used twice"),
    ("id: 9", "id: -1", "maps[1].id: must be a whole number from 0 to 4294967295, not -1"),
    ("image: room.yaml", "image: attic.yaml", "attic.yaml"),
    ("[3.0, -1.0, 3.0, 1.0]", "[3.0, -1.0, 3.0]", "maps[1].walls[0]: must be [x1, y1, x2, y2]"),
    ("[3.0, -1.0, 3.0, 1.0]", "[3.0, -1.0, 9.0e+9, 1.0]", "is not within 0 to 500 m"),
    ("walls: [[0, 0, 8, 0, 8, 6, 0, 6, 0, 0]]", "floor: x", "maps[0]: a map needs an image or"),
    ("[4.0, 3.0, 1.5]", "[4.0, 3.0]", "marks[0].pose: must be [x, y, theta], not [4.0, 3.0]"),
    ('"17", pose', "A1, pose", "marks[1]: number A1 is used twice"),
    ("map: upstairs, pose", "map: attic, pose", "start.map: 'attic' is not one of ground"),
    ("mark: A1}]}", "mark: Z9}]}", "calls[0].steps[0].mark: no map of the scene has a mark Z9"),
    (SCENE, "maps: []", "scene.yaml: maps: has 0 entries, which is less than 1"),
]


def test_invalid_scenes_are_refused_with_place_and_reason(tmp_path: Path) -> None:
    for old, new, reason in INVALID_SCENES:
        assert old in SCENE
        with pytest.raises(DataFileError) as error:
            load_scene(write_scene(tmp_path, SCENE.replace(old, new)))
        assert reason in str(error.value)
        assert len(str(error.value)) < 600


def test_scenes_that_do_not_go_together_are_refused(tmp_path: Path) -> None:
    lab = write_scene(tmp_path)
    with pytest.raises(DataFileError, match="another scene is called lab, too; rename one"):
        Chassis(quick_config(scenes=(lab, lab)))
    bad = tmp_path / "bad"
    bad.mkdir()
    write_scene(bad, SCENE.replace("number: A1", "number: 1"))
    with pytest.raises(DataFileError) as found:
        Chassis(quick_config(scenes=(lab, bad)))
    assert str(found.value).startswith(f"{bad}: scene.yaml: maps[")
    write_scene(bad, SCENE.replace("[1.0, 0.0, 0.5]", "[2.9, 0.0, 0.5]"))  # inside a wall
    with pytest.raises(
        DataFileError, match=r"scene lab: the robot cannot start at .* on map upstairs"
    ):
        Chassis(quick_config(scenes=(bad,)))


def test_total_pixels_of_a_scene_are_limited(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    maps = "".join(f"  - {{name: m{number}, image: room.yaml}}\n" for number in range(3))
    scene = write_scene(tmp_path, f"maps:\n{maps}")
    monkeypatch.setattr(robot_files, "_MAX_PIXELS", 2 * 40 * 60)
    with pytest.raises(DataFileError, match=r"maps\[2\]: the pictures of the scene have"):
        load_scene(scene)


def test_program_reports_invalid_scenes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ports = ["--port", "0", "--tcp-port", "0"]
    assert main([*ports, "--scene", str(tmp_path / "none")]) == 1
    assert main([*ports, "--scene", str(tmp_path)]) == 1
    unreadable = str(tmp_path / ("x" * 300))  # as without permission, which root always has
    assert main([*ports, "--scene", unreadable]) == 1
    assert main(["--check", unreadable]) == 1
    out, err = capsys.readouterr()
    assert out == f"{unreadable}: File name too long\n"
    first, second, third = err.splitlines()
    assert third == f"error: {unreadable}: File name too long"
    assert first == f"error: {tmp_path / 'none'}: No such file or directory"
    assert "not a scene: give a folder with scene.json or scene.yaml" in second


def test_map_that_is_named_alone_is_that_of_the_only_scene_with_it(client: JsonClient) -> None:
    client.ask("woosh.robot.SwitchMap", {"mapName": "scenex2"})
    scene = client.ask("woosh.robot.Scene")
    assert (scene["sceneName"], scene["mapName"]) == ("scenex", "scenex2")
    for name in ("woosh.map.SceneData", "woosh.map.SceneDataEasy"):
        assert client.ask(name)["name"] == "scenex"
        other = client.ask(name, {"name": "wooshmap"})
        assert (other["name"], len(other["maps"])) == ("wooshmap", 1)
    client.ask("woosh.map.Rename", {"oldMapName": "scenex", "newMapName": "hall"})
    client.ask(
        "woosh.map.Rename",
        {"oldSceneName": "wooshmap", "oldMapName": "wooshmap", "newMapName": "hall"},
    )
    client.ask("woosh.robot.SwitchMap", {"mapName": "hall"})  # that of the current scene
    assert client.ask("woosh.robot.Scene")["sceneName"] == "scenex"
    files = client.ask("woosh.map.Download", {"sceneName": "scenex"})["fileDatas"]
    client.ask("woosh.map.Upload", {"sceneName": "third", "fileDatas": files})
    client.ask("woosh.robot.SwitchMap", {"sceneName": "wooshmap"})
    reason = client.refusal("woosh.robot.SwitchMap", {"mapName": "scenex2"})
    assert reason == "scenes scenex, third have a map scenex2: name the scene too"


def test_scene_data_contains_the_pictures_of_maps(tmp_path: Path) -> None:
    chassis = Chassis(quick_config(scenes=(write_scene(tmp_path),)))
    answered = dispatch(chassis, SceneData()).body
    assert isinstance(answered, SceneData)
    ground, upstairs = answered.maps
    assert (ground.id, upstairs.id) == (1, 9)
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
