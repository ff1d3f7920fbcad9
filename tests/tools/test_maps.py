"""The program `maps`: maps and marks of a robot, saved in folders and brought to a robot."""

from __future__ import annotations

import contextlib
import io
import json
import math
import os
import pty
import re
import shlex
import shutil
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from PIL import Image

from tests.fact_files import FOLDER
from tests.quick_chassis import edit_bodies, quick_config
from tests.simulator.sim_wire import JsonClient
from tests.simulator.test_sim_map_library import scene_data, scenes, send_files
from tests.simulator.test_sim_uploads import NAV2, floor_png
from tests.tools.connections import Connection, serving
from tests.tools.programs import TIMEOUT, address, end, start
from woosh_robot_agent.pb.map.map_pack_pb2 import DownloadResponse, SceneData
from woosh_robot_agent.pb.map.mark_pb2 import MarkInfo, Storage
from woosh_robot_agent.robot.maps import cells_of
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.simulator.scenes.files import load_scene
from woosh_robot_agent.tools.maps.program import main
from woosh_robot_agent.tools.maps.scene_folder import (
    marks_as_yaml,
    read_marks,
    read_scene,
    to_file_name,
    write_scene,
)
from woosh_robot_agent.tools.options import ToolError

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def second() -> Iterator[SimulatorThread]:
    """Another robot."""
    with SimulatorThread(quick_config(port=0, tcp_port=0)) as running:
        yield running


@pytest.fixture
def run(chassis: SimulatorThread, capsys: Any, tmp_path: Path, monkeypatch: Any) -> Run:
    """Function that runs the program, by default with `chassis`, in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def run_program(*arguments: str, robot: SimulatorThread = chassis) -> tuple[int, str, str]:
        status = main([*address(robot), *arguments])
        out, err = capsys.readouterr()
        return status, out, err

    return run_program


@pytest.fixture
def wire(chassis: SimulatorThread) -> Iterator[JsonClient]:
    client = JsonClient(chassis.port)
    yield client
    client.close()


def upload_lab(wire: JsonClient) -> None:
    assert send_files(wire, "lab", {"floor.yaml": NAV2, "floor.png": floor_png()})["ok"]


def edit(file: Path, change: Callable[[list[dict[str, Any]]], object]) -> None:
    content = yaml.safe_load(file.read_text())
    change(content["marks"])
    file.write_text(yaml.safe_dump(content))


def tree(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def copy(source: socket.socket, target: socket.socket, limit: float = math.inf) -> None:
    """Copy bytes until the end of a connection, or until the limit is reached."""
    with contextlib.suppress(OSError):
        while limit > 0 and (data := source.recv(65536)):
            limit -= len(data)
            target.sendall(data)


def test_list_shows_all_scenes_and_the_current_map(run, chassis, capsys):
    status, out, err = run("list")
    assert (status, err) == (0, "")
    lines = [line.split() for line in out.splitlines()]
    assert lines[0] == ["SCENE", "MAP", "ID", "FLOOR", "VERSION", "MARKS"]
    assert lines[1] == ["wooshmap", "wooshmap", "3", "1F", "147", "11", "(current)"]
    assert [line[:2] for line in lines[2:]] == [["scenex", "scenex"], ["scenex", "scenex2"]]
    assert main(["list", *address(chassis), "--json"]) == 0  # in any order
    rows = json.loads(capsys.readouterr().out)
    assert [row["map"] for row in rows if row["current"]] == ["wooshmap"]
    assert rows[1]["marks"] == 11


def test_requests_have_the_given_robot_id(run, chassis):
    run("list", "--robot-id", "7")
    assert chassis.last("woosh.robot.Scene").robot_id == 7


def test_download_saves_all_scenes(run: Run, wire: JsonClient, tmp_path: Path) -> None:
    status, out, err = run("download", "--output", "backup/today")
    assert (status, err) == (0, "")
    assert out.startswith("downloaded scene wooshmap to backup/today/wooshmap: maps 1, marks 11")
    folder = tmp_path / "backup" / "today"
    assert {path.name for path in folder.iterdir()} == {"wooshmap", "scenex"}
    saved = set(tree(folder / "scenex"))
    assert {"nav2/scenex.yaml", "nav2/scenex2.png", "marks/scenex.yaml"} <= saved
    assert {"scene.json", "scenex/map.png", "scenex2/mark_info.data"} <= saved
    marks = yaml.safe_load((folder / "wooshmap" / "marks" / "wooshmap.yaml").read_text())["marks"]
    assert marks[0] == {
        "number": "A1",
        "id": 1,
        "type": "rack",
        "pose": [-2.0, 6.0, 1.5707964],
        "description": "rack by the north wall",
    }


def test_saved_map_is_that_of_the_topic_map(run, wire, tmp_path):
    upload_lab(wire)
    for scene in ("wooshmap", "lab"):
        run("download", scene)
        (area,) = wire.ask("woosh.map.SceneData", {"name": scene})["maps"]
        file = tmp_path / scene / "nav2" / f"{area['name']}.yaml"
        description = yaml.safe_load(file.read_text())
        assert description["resolution"] == pytest.approx(area["resolution"], rel=1e-7)
        origin = [area["origin"][key] for key in ("x", "y", "theta")]
        assert description["origin"] == pytest.approx(origin, rel=1e-7)
        width, height, cells = cells_of((file.parent / description["image"]).read_bytes())
        read = load_scene(file).maps[0].grid  # by the rules of map_server
        assert np.array_equal(np.array(cells, np.int8).reshape(height, width), read.cells)


def test_coloured_picture_is_saved_in_the_shades_of_the_topic_map(run, chassis, tmp_path):
    colours = np.zeros((3, 4, 3), np.uint8)
    colours[0], colours[1], colours[2] = (255, 255, 0), (0, 255, 0), (0, 0, 255)
    buffer = io.BytesIO()
    Image.fromarray(colours).save(buffer, "PNG")
    png = buffer.getvalue()
    edit_bodies(chassis, SceneData, lambda data: setattr(data.maps[0], "map_png", png))
    assert run("download", "wooshmap")[0] == 0
    grid = load_scene(tmp_path / "wooshmap" / "nav2" / "wooshmap.yaml").maps[0].grid
    _, _, cells = cells_of(png)
    assert grid.cells.ravel().tolist() == list(cells)


def test_scene_comes_to_a_second_robot(run: Run, wire: JsonClient, second: SimulatorThread) -> None:
    upload_lab(wire)
    assert run("download", "lab")[0] == 0
    status, out, err = run("upload", "lab", robot=second)
    assert (status, err) == (0, "")
    assert out == "uploaded scene lab: files 6\n"
    there = JsonClient(second.port)
    assert scene_data(there, "lab") == scene_data(wire, "lab")
    assert run("upload", "lab", "--scene", "lab 2", robot=second)[0] == 0
    assert scene_data(there, "lab 2") == scene_data(wire, "lab")
    there.close()


def test_folder_of_a_real_robot_passes_through_two_robots_unchanged(run, second, tmp_path):
    real = Path(shutil.copytree(FOLDER / "real_scene", tmp_path / "real"))
    (real / "deep" / "er").mkdir(parents=True)
    (real / "deep" / "er" / "x.bin").write_bytes(b"x")
    files = tree(real)
    (real / "deep" / ".hidden").write_bytes(b"hidden")
    files["deep/%2Ehidden"] = b"hidden"
    (real / ".git").write_bytes(b"not the robot's")
    assert run("upload", str(real), "--scene", "office")[0] == 0
    assert run("download", "office", "--output", "one")[0] == 0
    assert run("upload", "one/office", robot=second)[0] == 0
    assert run("download", "office", "--output", "two", robot=second)[0] == 0
    for output in ("one", "two"):
        saved = tree(tmp_path / output / "office")
        assert {name: saved[name] for name in files} == files
        others = {name.split("/")[0] for name in set(saved) - set(files)}
        assert others == {"nav2", "marks"}
    # The saved folder is a scene for the simulator, too.
    scene = load_scene(tmp_path / "two" / "office")
    assert (scene.name, len(scene.maps[0].marks)) == ("office", 4)
    names = {name.replace("%2E", ".") for name in files}
    assert set(scene.files) == names - {"action_groups.json"}


def test_keep_out_areas_are_saved_as_a_mask_for_nav2(run: Run, tmp_path: Path) -> None:
    real = FOLDER / "real_scene"
    run("upload", str(real), "--scene", "office")
    run("download", "office", "wooshmap")
    folder = tmp_path / "office" / "nav2"
    mask, area = (
        load_scene(folder / f"Wego_Robotics_503{end}.yaml").maps[0].grid for end in ("_keepout", "")
    )
    expected = load_scene(real).maps[0].grid
    assert (mask.low, mask.resolution) == (area.low, area.resolution)
    assert np.array_equal(mask.cells == 100, expected.keep_out)
    assert set(np.unique(mask.cells)) == {0, 100}
    assert not list((tmp_path / "wooshmap" / "nav2").glob("*_keepout*"))


def test_robots_map_with_the_name_of_a_folder_of_ours(run, wire, tmp_path):
    rename = {"oldSceneName": "scenex", "oldMapName": "scenex2", "newMapName": "marks"}
    wire.ask("woosh.map.Rename", rename)
    run("download", "scenex")
    assert (tmp_path / "scenex" / "%6Darks" / "map.png").is_file()
    edit(
        tmp_path / "scenex" / "marks" / "marks.yaml",
        lambda marks: marks.append({"number": "N1", "pose": [1, 2, 0]}),
    )
    assert run("upload", "scenex", "--scene", "copy")[0] == 0
    assert scenes(wire)["copy"] == ["scenex", "marks"]
    data = wire.ask("woosh.map.SceneData", {"name": "copy"})["maps"][1]
    assert [each["identity"]["no"] for each in data["markInfo"]["storages"]] == ["N1"]


def test_edited_marks_come_to_the_robot(run: Run, wire: JsonClient, tmp_path: Path) -> None:
    before = wire.ask("woosh.map.mark.storage.Find", {"no": "P1"})
    run("download", "wooshmap")

    def change(marks: list[dict[str, Any]]) -> None:
        found = {mark["number"]: mark for mark in marks}
        found["A1"]["pose"] = [1.0, 2.0, 0.5]
        marks.remove(found["A2"])
        marks.append({"number": "N1", "type": "charger", "pose": [3, 4, 0]})

    edit(tmp_path / "wooshmap" / "marks" / "wooshmap.yaml", change)
    status, _, err = run("upload", "wooshmap", "--force")
    assert (status, err) == (0, "")
    find = "woosh.map.mark.storage.Find"
    moved = wire.ask(find, {"no": "A1"})
    assert moved["pose"]["dock"] == {"x": 1.0, "y": 2.0, "theta": 0.5}
    assert moved["pose"]["real"] == moved["pose"]["dock"]
    assert "unknown mark A2" in wire.refusal(find, {"no": "A2"})
    new = wire.ask(find, {"no": "N1"})
    assert "charger" in new
    assert new["identity"]["id"] not in (0, moved["identity"]["id"])
    assert wire.ask(find, {"no": "P1"}) == before
    wire.ask("woosh.robot.ExecTask", {"taskId": "1", "type": 1, "markNo": "A1"})


def test_marks_in_an_unknown_format_are_not_for_editing(tmp_path):
    data = SceneData(name="hall")
    data.maps.add(name="hall").mark_info.storages.add().identity.no = "A"
    for files in ({"hall/mark_info.data": b"\xff"}, {"hall/map.png": b""}, {"hall.png": b""}):
        warnings = write_scene(tmp_path / "hall", data, files, force=True)
        assert any("marks of map hall are not saved for editing" in each for each in warnings)
        assert read_scene(tmp_path / "hall").files == files


def test_edited_marks_are_those_of_a_map(run: Run, tmp_path: Path) -> None:
    assert run("download", "wooshmap")[0] == 0
    folder = tmp_path / "wooshmap"
    marks = folder / "marks" / "wooshmap.yaml"
    shutil.copy(marks, folder / "marks" / "old.yaml")
    status, _, err = run("upload", "wooshmap", "--force")
    assert status == 1
    assert "remove wooshmap/marks/old.yaml: there is no such map" in err
    (folder / "marks" / "old.yaml").unlink()
    edit(marks, lambda marks: marks.clear())
    files = read_scene(folder).files
    assert not MarkInfo.FromString(files["wooshmap/mark_info.data"]).storages
    # they also come to a map without a file of marks
    (folder / "wooshmap" / "mark_info.data").unlink()
    edit(marks, lambda marks: marks.append({"number": "N1", "pose": [3, 4, 0]}))
    files = read_scene(folder).files
    (mark,) = MarkInfo.FromString(files["wooshmap/mark_info.data"]).storages
    assert mark.identity.no == "N1"


def test_nothing_is_overwritten_without_force_and_no_other_folder_with_it(
    run: Run, tmp_path: Path
) -> None:
    assert run("download", "scenex")[0] == 0
    before = tree(tmp_path)
    status, out, err = run("download")
    assert (status, out) == (1, "")
    assert err.startswith("error: scenex exists already: use --force to replace it, or --output")
    assert tree(tmp_path) == before
    status, _, err = run("upload", "scenex")
    assert status == 1
    assert "the robot has a scene scenex already: use --force" in err
    history = tmp_path / "scenex" / ".git" / "HEAD"
    history.parent.mkdir()
    history.write_text("mine")
    (tmp_path / "scenex" / "map.old").touch()
    assert run("download", "--force")[0] == 0
    assert history.read_text() == "mine"
    assert not (tmp_path / "scenex" / "map.old").exists()
    assert run("upload", "scenex", "--force")[0] == 0
    shutil.rmtree(tmp_path / "scenex")
    (tmp_path / "scenex").mkdir()
    (tmp_path / "scenex" / "thesis.txt").write_text("mine")
    status, _, err = run("download", "scenex", "--force")
    assert status == 1
    assert "scenex is not a saved scene and is not replaced" in err
    assert tree(tmp_path / "scenex") == {"thesis.txt": b"mine"}


def test_names_from_the_robot_are_never_paths(run, chassis, tmp_path):
    names = ["../../evil", "/etc/evil", "a/b.png", "..", ".", ".bashrc", "a\\b", "a\nb", "50%"]

    def add(response: DownloadResponse) -> None:
        for name in names:
            response.file_datas.add(name=name, data=name.encode())

    edit_bodies(chassis, DownloadResponse, add)
    edit_bodies(chassis, SceneData, lambda data: setattr(data.maps[0], "name", "../../evil"))
    output = tmp_path / "a" / "b"
    assert run("download", "wooshmap", "--output", str(output))[0] == 0
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
    assert [path.name for path in output.iterdir()] == ["wooshmap"]
    folder = output / "wooshmap"
    assert (folder / "nav2" / "%2E.%2F..%2Fevil.png").is_file()
    saved = {content.decode(errors="replace"): path for path, content in tree(folder).items()}
    assert [saved[name].count("/") for name in names] == [int(name == "a/b.png") for name in names]
    # They go back under their own names, which this robot refuses if they are paths.
    chassis.clear_faults()
    run("upload", str(folder), "--force")
    sent = {file.name for file in chassis.last("woosh.map.Upload").file_datas}
    assert set(names) <= sent


def test_different_names_have_different_file_names() -> None:
    names = ["a", "A", "a/b", "a%2Fb", "%", ".a", "%2Ea", "..", "ä", "a b", "文件"]
    assert len({to_file_name(name) for name in names}) == len(names)
    for bad in ("", "x" * 300):
        with pytest.raises(ToolError, match="cannot be a file name"):
            to_file_name(bad)


def test_rename_and_delete(run: Run, wire: JsonClient) -> None:
    assert run("rename", "scenex", "works") == (0, "renamed scene scenex to works\n", "")
    status, out, _ = run("rename", "works", "--map", "scenex2", "upstairs")
    assert (status, out) == (0, "renamed map scenex2 of scene works to upstairs\n")
    assert scenes(wire)["works"] == ["scenex", "upstairs"]
    assert run("delete", "works", "--map", "upstairs")[0] == 0
    assert scenes(wire)["works"] == ["scenex"]
    assert run("delete", "works") == (0, "deleted scene works\n", "")
    assert set(scenes(wire)) == {"wooshmap"}


def test_failures_are_told_with_exit_status_1(run: Run, wire: JsonClient) -> None:
    assert run("download", "--output", "backup")[0] == 0
    for scene in ("lab", "hall"):
        assert send_files(wire, scene, {"x.yaml": NAV2, "floor.png": floor_png()})["ok"]
    for arguments, reason in (
        ("download x", "several scenes have map x: name one of them: lab, hall\n"),
        ("download moon", "the robot has no scene and no map moon: its scenes are wooshmap,"),
        ("delete wooshmap", "scene wooshmap cannot be deleted: the robot is using it"),
        ("delete wooshmap --map wooshmap", "map wooshmap of scene wooshmap cannot"),
        ("delete moon", "the robot has no scene moon: its scenes are wooshmap, scenex"),
        ("delete scenex --map attic", "scene scenex has no map attic: its maps are"),
        ("rename moon sun", "the robot has no scene moon"),
        ("rename scenex wooshmap", "cannot be renamed: wooshmap exists already"),
        ("rename scenex --map scenex scenex2", "scenex2 exists already"),
        (f"rename scenex {'x' * 300}", "the robot refused woosh.map.Rename: new_scene_name"),
        ("upload nothing", "nothing is not a saved scene"),
        ("upload backup", "give a folder in it: backup/scenex, backup/wooshmap\n"),
    ):
        status, out, err = run(*arguments.split())
        assert (status, out) == (1, "")
        assert err.startswith("error: ")
        assert reason in err


_MISTAKES: list[tuple[Callable[[Any], object], str]] = [
    (lambda marks: marks.append(marks[0]), "number A1 or id 1 is used twice"),
    (lambda marks: marks[0].pop("pose"), "marks[0]: pose is missing"),
    (lambda marks: marks[0].update(pose=[1, 2]), "must be [x, y, theta]"),
    (lambda marks: marks[0].update(type="shelf"), "'shelf' is not one of base, rack"),
    (lambda marks: marks[0].update(colour="red"), "unknown key 'colour'"),
    (lambda marks: marks[0].update(number=7), "put numbers into quotes"),
    (lambda marks: marks[0].update(number=["A1"]), "marks[0].number: must be a text"),
    (lambda marks: marks[0].update(details={"nav": {"arr": "x"}}), "does not fit"),
    (lambda marks: marks[0].update(details={"charger": {}}), "have the data of a charger"),
    (
        lambda marks: (marks[0].update(id=2**32 - 1), marks[1].pop("id")),
        "the id 4294967295 leaves none for the new mark A2",
    ),
]
"""Changes of a file of marks, and what is said about them."""


def test_mistakes_in_edited_marks_are_told_and_change_nothing(run, wire, tmp_path):
    run("download", "wooshmap")
    before = wire.ask("woosh.map.SceneData")
    file = tmp_path / "wooshmap" / "marks" / "wooshmap.yaml"
    saved = file.read_text()
    for change, reason in _MISTAKES:
        file.write_text(saved)
        edit(file, change)
        status, _, err = run("upload", "wooshmap", "--force")
        assert status == 1
        assert "wooshmap/marks/wooshmap.yaml: marks" in err
        assert reason in err
    assert wire.ask("woosh.map.SceneData") == before


def test_marks_that_share_a_number_or_an_id_on_the_robot_may_be_kept(tmp_path):
    info = MarkInfo()
    for number, id_, x in (("A", 1, 1.0), ("A", 2, 2.0), ("B", 2, 3.0), ("C", 4, 4.0)):
        storage = info.storages.add()
        storage.identity.no, storage.identity.id, storage.pose.dock.x = number, id_, x
    file = tmp_path / "m.yaml"
    file.write_bytes(marks_as_yaml(info, "m"))
    assert read_marks(file, info) is info
    edit(file, lambda marks: marks[3].update(description="edited"))
    info.storages[3].identity.desc = "edited"
    info.storages[3].pose.real.CopyFrom(info.storages[3].pose.dock)
    assert read_marks(file, info) == info
    for index in range(3):
        file.write_bytes(marks_as_yaml(info, "m"))
        edit(file, lambda marks, at=index: marks[at].update(description="edited"))
        with pytest.raises(ToolError, match="is used twice"):
            read_marks(file, info)


@pytest.mark.parametrize(
    ("fault", "options", "reason"),
    [
        ("refuse", {"text": "no room"}, "the robot refused woosh.map.Download: no room\n"),
        ("truncated", {"where": "wire"}, "woosh.map.Download: "),
    ],
)
def test_a_download_that_fails_leaves_nothing(run, chassis, tmp_path, fault, options, reason):
    run("download", "scenex")
    before = tree(tmp_path)
    chassis.inject(fault, type="woosh.map.Download", **options)
    status, out, err = run("download", "--force")
    assert (status, out) == (1, "")
    assert err.startswith(f"error: {reason}")
    assert tree(tmp_path) == before
    assert [path.name for path in tmp_path.iterdir()] == ["scenex"]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda area: area.ClearField("map_png"), "the robot sent no image"),
        (lambda area: setattr(area, "map_png", b"x"), "its image cannot be decoded: "),
        (lambda area: area.ClearField("resolution"), "its resolution is invalid: 0"),
    ],
)
def test_a_map_without_a_usable_picture_does_not_prevent_the_backup(
    run, chassis, wire, tmp_path, change, reason
):
    edit_bodies(chassis, SceneData, lambda data: change(data.maps[0]))
    status, out, err = run("download", "scenex")
    assert status == 0
    assert out.startswith("downloaded scene scenex")
    assert err.startswith(f"warning: map scenex is not saved for nav2: {reason}")
    saved = {path.name for path in (tmp_path / "scenex" / "nav2").iterdir()}
    assert saved == {"scenex2.yaml", "scenex2.png"}
    assert run("upload", "scenex", "--scene", "copy")[0] == 0
    assert scenes(wire)["copy"] == ["scenex", "scenex2"]


def test_a_full_disk_leaves_no_half_scene(run, chassis, tmp_path):
    run("download", "wooshmap")
    before = tree(tmp_path)
    program = shlex.join([sys.executable, "-m", "woosh_robot_agent.tools", "maps"])
    arguments = shlex.join([*address(chassis), "download", "--force"])
    limited = ["bash", "-c", f"ulimit -f 1; exec {program} {arguments}"]  # KiB of a file
    done = subprocess.run(limited, capture_output=True, text=True, timeout=TIMEOUT, check=False)
    assert (done.returncode, done.stdout) == (1, "")
    assert re.match("error: scene (wooshmap|scenex) cannot be saved: ", done.stderr)
    assert tree(tmp_path) == before
    assert [path.name for path in tmp_path.iterdir()] == ["wooshmap"]


def test_an_upload_that_does_not_end_leaves_the_robots_map(run, wire, tmp_path, chassis):
    upload_lab(wire)
    run("download", "lab")
    (tmp_path / "lab" / "big.bin").write_bytes(bytes(6 << 20))
    before = wire.ask("woosh.map.SceneData", {"name": "lab"})
    stalled, cut = threading.Event(), threading.Event()

    def stall(connection: Connection) -> None:
        """Transport a part of the upload to the robot."""
        with socket.create_connection(("127.0.0.1", chassis.port)) as robot:
            back = threading.Thread(target=copy, args=(robot, connection.request), daemon=True)
            back.start()
            copy(connection.request, robot, 1 << 20)
            stalled.set()
            cut.wait(TIMEOUT)

    upload = ["upload", "lab", "--force"]
    with serving(stall) as port:
        with start("maps", "--ip", f"127.0.0.1:{port}", *upload) as process:
            assert stalled.wait(TIMEOUT)
            assert end(process) == (130, "", "interrupted\n")
        cut.set()
        assert main(["--ip", f"127.0.0.1:{port}", *upload]) == 1  # its connection is lost
    assert wire.ask("woosh.map.SceneData", {"name": "lab"}) == before
    assert chassis.counts["woosh.map.Upload"] == 1  # that of upload_lab


def test_a_bar_shows_the_progress_on_a_terminal(wire, chassis, tmp_path):
    upload_lab(wire)
    terminal, stderr = pty.openpty()
    download = ["download", "lab", "--output", str(tmp_path)]
    with start("maps", *address(chassis), *download, stderr=stderr) as process:
        status, out, _ = end(process, None)
    os.close(stderr)
    assert status == 0
    shown = b""
    with contextlib.suppress(OSError):  # at the end of the terminal
        while data := os.read(terminal, 65536):
            shown += data
    os.close(terminal)
    assert b"downloading lab" in shown
    assert b"bytes" in shown or b"kB" in shown
    assert out.startswith("downloaded scene lab")


def test_a_map_of_5_mib_goes_both_ways(run, chassis, wire, tmp_path):
    big = np.random.default_rng(1).bytes(5 << 20)
    files = {"floor.yaml": NAV2, "floor.png": floor_png(), "big.bin": big}
    assert send_files(wire, "lab", files)["ok"]
    assert run("download", "lab")[0] == 0
    assert (tmp_path / "lab" / "big.bin").read_bytes() == big
    over_tcp = ["--ip", f"127.0.0.1:{chassis.tcp_port}", "--transport", "tcp"]
    assert main([*over_tcp, "upload", "lab", "--scene", "copy"]) == 0
    assert scenes(wire)["copy"] == ["floor"]


def test_marks_that_nobody_edited_are_the_same_message(tmp_path):
    storage = Storage(custom=b"\x00")
    storage.identity.no, storage.identity.id = "A", 3
    storage.pose.real.x = 1.25
    storage.pose.adjust.pose.x = 0.1
    storage.rack.numbers.append("R")
    info = MarkInfo(version=7, floor_name="2F", storages=[storage, storage])
    info.storages[1].identity.no, info.storages[1].identity.id = "B", 4
    info.beacons.add(id=5).point.x = 0.1
    info.storages[1].MergeFromString(b"\xba\x3e\x01x")  # a field of a newer firmware
    file = tmp_path / "m.yaml"
    file.write_bytes(marks_as_yaml(info, "m"))
    assert read_marks(file, info) is info
    kept = yaml.safe_load(file.read_text())
    del kept["others"]  # which keeps them
    (tmp_path / "kept.yaml").write_text(yaml.safe_dump(kept))
    assert read_marks(tmp_path / "kept.yaml", info) is info
    file.write_text(file.read_text().replace("number: A", "number: A9"))
    edited = read_marks(file, info)
    assert edited.storages[0].identity.no == "A9"
    edited.storages[0].identity.no = "A"
    assert edited == info
