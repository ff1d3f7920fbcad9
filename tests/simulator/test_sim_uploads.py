"""Maps and scenes that a client uploads with SwitchMap."""

from __future__ import annotations

import base64
import io
from typing import Any

import numpy as np
import pytest
from PIL import Image

from tests.simulator.sim_wire import Json, JsonClient
from woosh_robot_agent.pb.util.common_pb2 import FileData
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.simulator.protocol import scene_files
from woosh_robot_agent.simulator.refusals import RefusedError

NAV2 = b"""
image: floor.png
resolution: 0.1
origin: [-10.0, -10.0, 0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""
SCENE = b"""
maps:
  - name: hall
    walls: [[0, -9, 9, -9, 9, 9, 0, 9, 0, -9]]
    marks: [{number: X1, type: rack, pose: [4.0, 0.0, 0.0]}]
  - {name: yard, version: 7, image: floor.yaml}
tasks:
  predefined: [{id: 77, name: fetch, steps: [{mark: X1}]}]
"""


SCENE_OF_ONE_HALL = b"maps: [{name: hall, walls: [[0, -9, 9, -9, 9, 9, 0, 9, 0, -9]]}]"


def floor_png(wall_x: float = 8.0) -> bytes:
    """A floor of 20 by 20 m around the origin, with one wall across it."""
    greys = np.full((200, 200), 254, np.uint8)
    greys[:, round((wall_x + 10.0) / 0.1)] = 0
    buffer = io.BytesIO()
    Image.fromarray(greys).save(buffer, "PNG")
    return buffer.getvalue()


def switch_request(scene: str, map_name: str = "", **files: bytes) -> Json:
    """Return the body of a SwitchMap request; see `dotted`."""
    return {"sceneName": scene, "mapName": map_name, "fileDatas": file_datas(dotted(files))}


def dotted(files: dict[str, bytes]) -> dict[str, bytes]:
    """Return files with a dot in place of `_` in their names, which may be keyword arguments."""
    return {name.replace("_", "."): data for name, data in files.items()}


def file_datas(files: dict[str, bytes]) -> list[Json]:
    return [{"name": name, "data": base64.b64encode(data).decode()} for name, data in files.items()]


def switch_map(client: JsonClient, request: Json) -> Json:
    client.ask("woosh.robot.SwitchMap", request)
    return client.ask("woosh.robot.Scene")


def distance_ahead(client: JsonClient) -> float:
    """Move the robot to (4, -6) and return the laser's distance along x, in metres."""
    client.ask("woosh.robot.InitRobot", {"pose": {"x": 4.0, "y": -6.0, "theta": 0.0}})
    ranges = client.ask("woosh.robot.ScannerData")["ranges"]
    return float(ranges[len(ranges) // 2])


def maps(client: JsonClient) -> dict[str, Any]:
    return {each["name"]: each for each in client.ask("woosh.map.SceneDataEasy")["maps"]}


def library(simulator: SimulatorThread) -> Any:
    """Return the files and maps of all scenes, and the current scene and map."""
    return simulator.call(
        lambda s: (
            {name: (dict(each.files), list(each.maps)) for name, each in s.chassis.scenes.items()},
            s.chassis.scene,
            s.chassis.map,
        )
    )


def test_uploaded_scene_brings_maps_marks_and_tasks(client: JsonClient) -> None:
    files = {"scene_yaml": SCENE, "floor_yaml": NAV2, "floor_png": floor_png(), "notes_txt": b"hi"}
    scene = switch_map(client, switch_request("lab", **files))
    assert (scene["mapName"], scene["mapId"], scene["version"]) == ("hall", 1, "1")
    assert distance_ahead(client) == pytest.approx(9.0 - 4.0 - 0.25, abs=0.02)
    assert set(maps(client)) == {"hall", "yard"}
    assert maps(client)["hall"]["storages"]["racks"][0]["identity"]["no"] == "X1"
    (task,) = client.ask("woosh.task.RepeatTasks")["repeatTasks"]
    assert task["taskSet"]["base"]["id"] == 77
    assert switch_map(client, {"mapName": "yard"})["version"] == "7"
    assert distance_ahead(client) == pytest.approx(8.0 - 4.0 - 0.25, abs=0.02)
    # A table of actions is that of its tasks.
    table = b'{"task_type": [{"type": 1, "no": 0, "order": [{"action": 1}]}]}'
    actions = {"sceneName": "lab", "fileDatas": file_datas({"action_groups.json": table})}
    switch_map(client, {**actions, "mapName": "yard"})
    assert client.ask("woosh.map.SceneData")["actionGroup"] == table.decode()
    client.ask("woosh.robot.SwitchMap", {"mapName": "hall"})
    distance_ahead(client)
    refusal = client.refusal("woosh.robot.ExecTask", {"type": 4, "markNo": "X1"})
    assert refusal.startswith("scene lab has no actions for tasks of type 4")
    # An upload increments the versions of the maps that it changes.
    new = {"notes_txt": b"ho", "yard/map_png": floor_png(7.0)}
    scene = switch_map(client, switch_request("lab", "yard", **new))
    assert (scene["mapName"], scene["version"]) == ("yard", "8")
    assert maps(client)["hall"]["version"] == "1"


def test_robot_inside_an_uploaded_wall_loses_localisation(client: JsonClient) -> None:
    distance_ahead(client)
    switch_map(client, switch_request("lab", floor_yaml=NAV2, floor_png=floor_png(4.2)))
    assert client.ask("woosh.robot.DeviceState")["software"] & 1 == 0
    assert "locali" in client.refusal("woosh.robot.ExecTask", {"type": 1, "markNo": "A2"})


INVALID_UPLOADS: list[tuple[dict[str, bytes], str]] = [
    ({"floor_yaml": NAV2}, "floor.png: the file is missing: upload it too"),
    (
        {"floor_yaml": NAV2, "floor_png": b"\x89PNG junk"},
        "floor.png: not readable as a PNG or PGM picture: save it",
    ),
    ({"scene_yaml": SCENE}, "floor.yaml: the file is missing"),
    (
        {"floor_yaml": NAV2.replace(b"floor.png", b"/etc/hostname")},
        "hostname: the file is missing",
    ),
    (
        {"floor_yaml": NAV2, "floor_yml": NAV2, "floor_png": floor_png()},
        "another file has the map name floor too",
    ),
    *(
        ({name: b""}, "must be a plain file name")
        for name in ("../floor_png", "/floor_png", "a\\b_png", "C:b_png", "", "..", "a\n_png")
    ),
    ({"a" * 300: b""}, "at most 255 characters"),
    ({"notes_txt": b"hi", "unused_png": b""}, "unused.png: not readable as a PNG or PGM picture"),
    (
        {f"{number}_png": b"" for number in range(1001)},
        "more than the limit of a scene: 1000 files",
    ),
]


def test_invalid_uploads_are_refused_and_change_nothing(client: JsonClient) -> None:
    before = library(client.simulator)
    for number, (files, reason) in enumerate(INVALID_UPLOADS):
        scene = ("new", "wooshmap")[number % 2]
        text = client.refusal("woosh.robot.SwitchMap", switch_request(scene, **files))
        assert reason in text
        assert len(text) < 1000
        assert library(client.simulator) == before, reason
    files = {"scene.yaml": SCENE_OF_ONE_HALL, "hall/path_info.data": b"\xff"}
    request = {"sceneName": "new", "mapName": "hall", "fileDatas": file_datas(files)}
    reason = "not a serialised woosh.map.path.PathInfo"
    assert reason in client.refusal("woosh.robot.SwitchMap", request)
    twice = [{"name": "a.bin", "data": ""}, {"name": "a.bin", "data": "AA=="}]
    request = {"sceneName": "new", "fileDatas": twice}
    assert client.refusal("woosh.robot.SwitchMap", request) == "file a.bin is uploaded twice"


def test_name_that_comes_with_files_leads_nowhere(client: JsonClient) -> None:
    before = library(client.simulator)
    request = switch_request("../s", floor_yaml=NAV2, floor_png=floor_png())
    assert "../" in client.refusal("woosh.robot.SwitchMap", request)
    assert library(client.simulator) == before


def test_total_size_of_uploads_is_limited() -> None:
    big = [FileData(name="big.bin", data=bytes(20 * 1024 * 1024))]
    files = scene_files.merge_files({}, big)
    assert list(scene_files.merge_files(files, big)) == ["big.bin"]
    with pytest.raises(RefusedError, match="2 files of 41943040 bytes are more"):
        scene_files.merge_files(files, [FileData(name="more.bin", data=big[0].data)])
