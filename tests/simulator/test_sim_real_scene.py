"""The folder of a scene from a real TR-200: loaded, driven in, and passed on byte for byte."""

from __future__ import annotations

import base64
import io
import json
import math
import random
import shutil
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf.json_format import ParseDict
from PIL import Image

from tests.fact_files import FOLDER
from tests.simulator.mapping import UPDATE, save_map, start_mapping
from tests.simulator.real_tasks import ended, triple
from tests.simulator.recorded_chassis import Frame, SteppedChassis, answer_to, ask, wait_frame
from woosh_robot_agent.pb.map.map_pack_pb2 import SceneData
from woosh_robot_agent.pb.map.mark_pb2 import MarkInfo
from woosh_robot_agent.simulator.__main__ import main
from woosh_robot_agent.simulator.scenes.files import load_scene
from woosh_robot_agent.simulator.world.geometry import Pose
from woosh_robot_agent.simulator.world.laser import Laser

SCENE = FOLDER / "real_scene"
MAP = "Wego_Robotics_503"
CHARGER = "75B59C1A"
END = Pose(-0.08284062433618766, -0.4481934137334172, -1.7769225315003054)
STEP, WAIT = 2, 6
EXEC_TASK, TASK_PROC = "woosh.robot.ExecTask", "woosh.robot.TaskProc"
DOWNLOAD, UPLOAD, SWITCH_MAP = "woosh.map.Download", "woosh.map.Upload", "woosh.robot.SwitchMap"


@pytest.fixture
def chassis() -> SteppedChassis:
    return SteppedChassis(scenes=(SCENE,))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A copy of the folder, to be changed."""
    return Path(shutil.copytree(SCENE, tmp_path / "office"))


def files_in(folder: Path) -> dict[str, bytes]:
    return {
        each.relative_to(folder).as_posix(): each.read_bytes()
        for each in folder.rglob("*")
        if each.is_file()
    }


def download(chassis: SteppedChassis, scene: str = "") -> dict[str, bytes]:
    body = ask(chassis, DOWNLOAD, sceneName=scene).body
    return {each["name"]: base64.b64decode(each["data"]) for each in body["fileDatas"]}


def upload(chassis: SteppedChassis, scene: str, files: dict[str, bytes], method: int = 1) -> None:
    datas = [
        {"name": name, "data": base64.b64encode(data).decode()} for name, data in files.items()
    ]
    ask(chassis, UPLOAD, sceneName=scene, fileDatas=datas, method=method)


def task_reports(chassis: SteppedChassis, **task: Any) -> list[tuple[str, str, str]]:
    """Run a task to its end, and return its reports."""
    before = len(chassis.frames)

    def of_task(frame: Frame) -> bool:
        return frame.type == TASK_PROC and bool(frame.body.get("state", 0))

    ask(chassis, EXEC_TASK, **task)
    wait_frame(chassis, lambda frame: of_task(frame) and ended(frame.body), before)
    return [triple(each.body) for each in chassis.frames[before:] if of_task(each)]


def actions(reports: list[tuple[str, str, str]]) -> list[str]:
    """Return the actions of a task in their order."""
    return [action for _, action, state in reports if state == "kRosExecuting"]


def action_reports(frames: list[Frame], kind: int) -> list[Frame]:
    """Return the reports about actions of a type."""
    reports = [frame for frame in frames if frame.type == TASK_PROC]
    return [frame for frame in reports if frame.body.get("action", {}).get("type") == kind]


def test_robot_stands_in_the_scene_of_the_files_where_it_was_last(chassis: SteppedChassis) -> None:
    scene = ask(chassis, "woosh.robot.Scene").body
    assert (scene["sceneName"], scene["mapName"], scene["version"]) == ("real_scene", MAP, "18")
    assert scene["mapId"] == 0
    pose = ask(chassis, "woosh.robot.PoseSpeed").body["pose"]
    assert (pose["x"], pose["y"], pose["theta"]) == pytest.approx((END.x, END.y, END.theta))
    assert ask(chassis, "woosh.robot.OperationState").body["robot"] == 1
    data = ParseDict(ask(chassis, "woosh.map.SceneData").body, SceneData())
    (area,) = data.maps
    folder = SCENE / MAP
    assert area.map_png == (folder / "map.png").read_bytes()
    assert area.keepout_png == (folder / "keepout.png").read_bytes()
    assert area.traffic_keepout_png == (folder / "traffic_keepout.png").read_bytes()
    assert area.mark_info == MarkInfo.FromString((folder / "mark_info.data").read_bytes())
    assert data.action_group == (SCENE / "action_groups.json").read_text()
    assert area.resolution == pytest.approx(0.03)
    assert (area.origin.x, area.origin.y) == pytest.approx((-6.275816345, -7.338738556))
    assert (area.end.x, area.end.y, area.end.theta) == pytest.approx((END.x, END.y, END.theta))
    assert not area.HasField("field_info")  # the file is empty


@pytest.mark.parametrize("number", [0, 1])
def test_charge_task_without_a_mark_leads_to_the_charger(
    chassis: SteppedChassis, number: int
) -> None:
    before = len(chassis.frames)
    reports = task_reports(chassis, type=3, taskTypeNo=number)
    if number == 0:  # its steps are as long as the table says
        times = [frame.time for frame in action_reports(chassis.frames[before:], STEP)]
        assert times[1] - times[0] == pytest.approx(0.03 / 0.015, abs=0.1)
        assert times[3] - times[2] == pytest.approx(0.02 / 0.015, abs=0.1)
    steps = ["kStepCtrl"] * (2 if number == 0 else 4)
    assert actions(reports) == ["kNav", "kSecondposEnter", *steps, "kCharge"]
    assert reports[-1] == ("kCompleted", "kCharge", "kRosSuccess")
    chassis.run(0.1)
    assert ask(chassis, "woosh.robot.RobotState").body["state"] == 8  # charging
    assert ask(chassis, TASK_PROC).body["dest"] == CHARGER
    charger = chassis.chassis.map.marks[CHARGER].pose
    assert chassis.chassis.pose.distance(charger.point) < 0.1
    # It leaves the dock before it drives on.
    assert actions(task_reports(chassis, type=2, markNo="758312C2")) == ["kSecondposQuit", "kNav"]


def test_charge_task_without_a_charger_is_refused(folder: Path) -> None:
    info = MarkInfo.FromString((folder / MAP / "mark_info.data").read_bytes())
    del info.storages[-1]
    (folder / MAP / "mark_info.data").write_bytes(info.SerializeToString())
    chassis = SteppedChassis(profile="instant", scenes=(folder,))
    before = chassis.chassis.pose
    assert answer_to(chassis, EXEC_TASK, type=3, pose={"x": 0, "y": 0, "theta": 0}).ok is False
    chassis.run(5.0)
    assert chassis.chassis.pose == before


def test_task_follows_the_table_of_its_scene(folder: Path) -> None:
    drive = {"action": 1}
    turn = {"action": 2, "stepctrl_type": 1, "stepctrl_value": 1.0, "stepctrl_speed": 0.5}
    order = [drive, turn, {"action": 6, "wait_id": 7, "wait_time": 3}, drive]
    table = {"task_type": [{"type": 1, "no": 4, "name": "turn", "order": order}]}
    (folder / "action_groups.json").write_text(json.dumps(table))
    chassis = SteppedChassis(scenes=(folder,))
    before = len(chassis.frames)
    reports = task_reports(chassis, type=1, taskTypeNo=4, markNo="758033B0")
    assert reports[-1][0] == "kCompleted"
    assert actions(reports) == ["kNav", "kStepCtrl", "kWait", "kNav"]
    turns = action_reports(chassis.frames[before:], STEP)
    assert turns[1].time - turns[0].time > 1.0 / 0.5
    waits = action_reports(chassis.frames[before:], WAIT)
    assert {frame.body["action"]["waitId"] for frame in waits} == {7}
    assert waits[1].time - waits[0].time == pytest.approx(3.0, abs=0.1)
    # After the turn it has driven to its mark again.
    mark = chassis.chassis.map.marks["758033B0"].pose
    assert chassis.chassis.pose.theta == pytest.approx(mark.theta, abs=0.01)
    assert chassis.chassis.pose.distance(mark.point) < 0.01
    # A task of another number has no actions.
    assert answer_to(chassis, EXEC_TASK, type=1, markNo="758033B0").ok is False


def test_a_task_without_a_single_action_is_completed(folder: Path) -> None:
    nothing = [{"action": 6, "wait_id": 1}]  # a wait of 0 s, which this profile leaves out
    table = {"task_type": [{"type": 1, "no": 0, "name": "nothing", "order": nothing}]}
    (folder / "action_groups.json").write_text(json.dumps(table))
    chassis = SteppedChassis(profile="instant", scenes=(folder,))
    assert task_reports(chassis, type=1, markNo="758033B0")[-1][0] == "kCompleted"


def test_scenes_without_a_table_have_that_of_the_real_robot() -> None:
    real = load_scene(SCENE).action_groups
    assert SteppedChassis().chassis.scene.action_groups.groups == real.groups


def test_files_come_back_as_they_are(chassis: SteppedChassis) -> None:
    files = files_in(SCENE)
    assert len(files) == 14
    assert download(chassis) == files
    other = SteppedChassis()
    upload(other, "office", files)
    assert download(other, "office") == files
    # The second robot can drive there.
    ask(other, SWITCH_MAP, sceneName="office")
    ask(other, "woosh.robot.InitRobot", pose={"x": END.x, "y": END.y, "theta": END.theta})
    other.run(0.1)
    assert task_reports(other, type=1, markNo="758033B0")[-1][0] == "kCompleted"
    # Its own files change nothing.
    version = ask(other, "woosh.robot.Scene").body["version"]
    upload(other, "office", files)
    assert download(other, "office") == files
    assert ask(other, "woosh.robot.Scene").body["version"] == version


def test_files_anywhere_in_the_folder_are_carried(folder: Path) -> None:
    (folder / MAP / "sub").mkdir()
    (folder / MAP / "sub" / "deep.bin").write_bytes(b"deep")
    (folder / MAP / ".hidden").write_bytes(b"hidden")
    (folder / "other").mkdir()
    (folder / "other" / "state.bin").write_bytes(b"other")
    files = files_in(folder)
    for name in ("nav2", "marks", ".git"):  # not the robot's
        (folder / name).mkdir()
        (folder / name / "x.yaml").write_bytes(b"x")
    assert download(SteppedChassis(scenes=(folder,))) == files
    # The tool `maps` quotes names that a file cannot have.
    (folder / MAP).rename(folder / "first%3A2")
    index = (folder / "scene.json").read_text().replace(MAP, "first:2")
    (folder / "scene.json").write_text(index)
    renamed = download(SteppedChassis(scenes=(folder,)))
    assert set(renamed) == {name.replace(MAP, "first:2") for name in files}


def test_backup_that_is_restored_is_what_the_robot_has(chassis: SteppedChassis) -> None:
    backup = download(chassis)
    version = ask(chassis, "woosh.robot.Scene").body["version"]
    ask(chassis, "woosh.map.mark.storage.Delete", no="758033B0")
    changed = ask(chassis, "woosh.robot.Scene").body["version"]
    upload(chassis, "", backup)
    assert download(chassis) == backup
    assert ask(chassis, "woosh.robot.Scene").body["version"] == version != changed
    # A change under the same version is one that others must notice.
    edited = MarkInfo.FromString(backup[f"{MAP}/mark_info.data"])
    del edited.storages[0]
    upload(chassis, "", {**backup, f"{MAP}/mark_info.data": edited.SerializeToString()})
    assert ask(chassis, "woosh.robot.Scene").body["version"] == changed


def test_only_the_file_that_a_change_concerns_is_written_anew(chassis: SteppedChassis) -> None:
    files = files_in(SCENE)
    ask(chassis, "woosh.map.mark.storage.Delete", no="758033B0")
    changed = download(chassis)
    assert {name for name in files if changed[name] != files[name]} == {f"{MAP}/mark_info.data"}
    info = MarkInfo.FromString(changed[f"{MAP}/mark_info.data"])
    assert [each.identity.no for each in info.storages] == ["758312C2", "758672A8", CHARGER]
    assert (info.version, info.sdkv, info.floor_name) == (19, "1.1.34", "5")
    ask(chassis, "woosh.map.Rename", oldMapName=MAP, newMapName="office")
    renamed = download(chassis)
    assert set(renamed) == {name.replace(MAP, "office") for name in files}
    assert renamed["office/map.png"] == files[f"{MAP}/map.png"]
    assert json.loads(renamed["scene.json"])["maps"][0]["name"] == "office"


def paint_keepout(folder: Path, boxes: list[tuple[float, float, float, float]]) -> None:
    """Make areas of the map, given by two corners in metres, areas to keep out of."""
    picture = folder / MAP / "keepout.png"
    with Image.open(picture) as image:
        pixels = np.array(image.convert("L"))
    height = pixels.shape[0]
    for x1, y1, x2, y2 in boxes:
        columns = [round((x + 6.2758163) / 0.03) for x in (x1, x2)]
        rows = [height - round((y + 7.3387386) / 0.03) for y in (y2, y1)]
        pixels[rows[0] : rows[1], columns[0] : columns[1]] = 0
    Image.fromarray(pixels).save(picture)


def test_paths_keep_out_of_the_keep_out_areas(folder: Path) -> None:
    direct = SteppedChassis(profile="instant", scenes=(folder,))
    plan = {"start": {"x": 0.4, "y": 1.2}, "end": {"x": 0.4, "y": 0.2}}
    straight = ask(direct, "woosh.robot.PlanNavPath", **plan).body["path"]["poses"]
    assert len(straight) == 2
    paint_keepout(folder, [(0.8, 0.6, 1.2, 0.9)])
    chassis = SteppedChassis(profile="instant", scenes=(folder,))
    detour = ask(chassis, "woosh.robot.PlanNavPath", **plan).body["path"]["poses"]
    assert len(detour) > 2
    grid = chassis.chassis.map.grid
    assert grid is not None
    for here, there in pairwise(detour):
        for share in np.linspace(0.0, 1.0, 50):
            x, y = (here[key] + share * (there[key] - here[key]) for key in ("x", "y"))
            assert not grid.kept_out(x, y)
    # The laser does not see them, and velocities are not limited by them.
    assert direct.chassis.scan() == chassis.chassis.scan()
    goal = {"x": 1.0, "y": 0.7, "theta": 0.0}
    reports = task_reports(chassis, type=1, pose=goal)
    assert reports[-1][0] == "kFailed"
    last = [frame for frame in chassis.frames if frame.type == TASK_PROC][-1]
    assert "is in a keep-out area" in last.body["msg"]


def test_updated_map_keeps_its_keep_out_areas_and_has_its_new_end(
    folder: Path, quick: SteppedChassis
) -> None:
    paint_keepout(folder, [(0.5, 1.0, 1.2, 1.4)])
    chassis = SteppedChassis(profile="instant", scenes=(folder,))
    start_mapping(chassis, UPDATE, "office", MAP)
    chassis.request("woosh.robot.Twist", angular=0.5)
    chassis.run(2.0)
    save_map(chassis)
    pose = chassis.chassis.pose
    assert abs(pose.theta - END.theta) > 0.1
    (area,) = ParseDict(ask(chassis, "woosh.map.SceneData").body, SceneData()).maps
    assert area.end.theta == pytest.approx(pose.theta, abs=0.01)
    (entry,) = json.loads(download(chassis)["scene.json"])["maps"]
    assert entry["end_pose"]["theta"] == pytest.approx(pose.theta, abs=0.01)
    grid = chassis.chassis.map.grid
    assert grid is not None
    assert grid.kept_out(0.8, 1.2)
    assert not grid.kept_out(0.8, 0.8)
    upload(quick, "office", download(chassis, "office"))
    moved = quick.chassis.scenes["office"].maps[0].grid
    assert moved is not None
    assert moved.kept_out(0.8, 1.2)
    assert not moved.kept_out(0.8, 0.8)


def carmen(name: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the ranges of a real scan, NaN for those without an echo."""
    words = (SCENE / MAP / f"{name}.carmen").read_text().split()
    ranges = np.array([float(word) for word in words[2 : 2 + int(words[1])]])
    return np.where(ranges < 0.0, math.nan, ranges)


def test_check_finds_nothing_in_the_real_scene(capsys: Any) -> None:
    assert main(["--check", str(SCENE)]) == 0
    assert capsys.readouterr().out == f"{SCENE}: nothing is wrong\n"


def drop(name: str) -> Callable[[Path], None]:
    return lambda folder: (folder / name).unlink()


def write(name: str, data: bytes) -> Callable[[Path], Any]:
    return lambda folder: (folder / name).write_bytes(data)


def with_marks(*places: tuple[float, float]) -> Callable[[Path], Any]:
    info = MarkInfo()
    for number, (x, y) in enumerate(places, start=1):
        mark = info.storages.add()
        mark.identity.no, mark.identity.id = f"m{number}", number
        mark.pose.dock.x, mark.pose.dock.y = x, y
    return write(f"{MAP}/mark_info.data", info.SerializeToString())


SMALL_PICTURE = io.BytesIO()
Image.new("L", (10, 10), 216).save(SMALL_PICTURE, "PNG")


@pytest.mark.parametrize(
    ("changes", "findings"),
    [
        ([write("scene.json", b"[]")], ["scene.json: must be a mapping of keys to values"]),
        ([write("scene.json", b"{")], ["scene.json: not readable as JSON: "]),
        (
            [write("scene.json", b'{"maps": [{"id": 0, "name": "../x"}]}')],
            ["scene.json: maps[0].name: '../x' must be a name that is not a path"],
        ),
        (
            [
                drop(f"{MAP}/map.png"),
                write("action_groups.json", b'{"task_type": [{"type": 1, "no": 0, "order": []}]}'),
                write("task_info.data", b"\xff"),
                write(f"{MAP}/mark_info.data", b"\xff"),
                write(f"{MAP}/nav_area.data", b"\xff"),
            ],
            [
                "action_groups.json: task_type[0].order: has 0 entries, which is less than 1",
                "task_info.data: not a serialised woosh.task.TaskInfo",
                f"{MAP}/map.png: the file of map {MAP} is missing",
                f"{MAP}/mark_info.data: not a serialised woosh.map.mark.MarkInfo",
                f"{MAP}/nav_area.data: not a serialised woosh.map.field.FieldInfo",
            ],
        ),
        (
            [write(f"{MAP}/keepout.png", SMALL_PICTURE.getvalue())],
            [f"{MAP}/keepout.png: 10 x 10 pixels, but the map has 610 x 487: save it in the"],
        ),
        (
            [lambda folder: shutil.copytree(folder / MAP, folder / "attic")],
            ["attic: scene.json does not name this map"],
        ),
        (
            [with_marks((50.0, 0.0), (-1.0, 0.8), (0.8, 1.2), (5.0, 0.0), (0.3, 2.0))]
            + [lambda folder: paint_keepout(folder, [(0.7, 1.1, 0.9, 1.3), (2.5, -2, 2.8, 3)])],
            [
                f"map {MAP}: mark m1 at (50.00, 0.00, 0.00) is not on known floor",
                f"map {MAP}: mark m2 at (-1.00, 0.80, 0.00) is so close to a wall",
                f"map {MAP}: mark m3 at (0.80, 1.20, 0.00) is in a keep-out area",
                f"map {MAP}: mark m4 at (5.00, 0.00, 0.00) cannot be reached from the start",
            ],
        ),
        (
            [write("action_groups.json", b'{"task_type": []}')],
            [
                f"action_groups.json: it has no actions for tasks of type {kind}"
                for kind in range(1, 5)
            ],
        ),
    ],
)
def test_check_tells_each_finding(
    folder: Path, capsys: Any, changes: list[Callable[[Path], Any]], findings: list[str]
) -> None:
    for change in changes:
        change(folder)
    assert main(["--check", str(folder)]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(findings), lines
    for line, finding in zip(lines, findings, strict=True):
        assert line.startswith(finding)


def test_scans_of_a_running_robot_start_at_its_laser() -> None:
    """So they are the real scan, which starts at a robot's centre, 0.25 m behind the pose."""
    laser, real = Laser(noise=0.0), carmen("x-0.09y-0.41t-1.76")
    grid = load_scene(SCENE).maps[0].grid
    angles = np.linspace(laser.angle_min, laser.angle_max, laser.rays)
    expected = np.interp(angles, np.linspace(-math.pi, math.pi, len(real)), real)
    shares = []
    for pose in (END.moved(-laser.forward, 0.0, 0.0), END):
        errors = abs(np.array(laser.scan(pose, (), random.Random(1), grid)) - expected)
        shares.append((errors[np.isfinite(errors)] < 0.1).mean())
    assert shares[0] > 0.85
    assert shares[1] < 0.5
