"""Maps and scenes that a client uploads with SwitchMap."""

from __future__ import annotations

import base64
import io
import random
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


def test_laser_sees_the_uploaded_map(client: JsonClient) -> None:
    scene = switch_map(client, switch_request("lab", floor_yaml=NAV2, floor_png=floor_png()))
    assert (scene["sceneName"], scene["mapName"], scene["version"]) == ("lab", "floor", "1")
    assert distance_ahead(client) == pytest.approx(8.0 - 4.0 - 0.25, abs=0.02)
    assert list(maps(client)) == ["floor"]
    # Uploading a new picture keeps the other files.
    scene = switch_map(client, switch_request("lab", **{"floor/map_png": floor_png(7.0)}))
    assert (scene["mapName"], scene["version"]) == ("floor", "2")
    assert distance_ahead(client) == pytest.approx(7.0 - 4.0 - 0.25, abs=0.02)
    # Without files, the request only switches the scene.
    client.ask("woosh.robot.SwitchMap", {"sceneName": "wooshmap"})
    assert distance_ahead(client) == pytest.approx(12.0 - 4.0 - 0.25, abs=0.02)
    assert switch_map(client, {"sceneName": "lab"})["version"] == "2"
    assert distance_ahead(client) == pytest.approx(7.0 - 4.0 - 0.25, abs=0.02)


def test_navigation_plans_on_the_uploaded_map(client: JsonClient) -> None:
    switch_map(client, switch_request("lab", floor_yaml=NAV2, floor_png=floor_png()))
    distance_ahead(client)
    client.subscribe("woosh.ros.Feedbacks")

    def end_of_drive(x: float, y: float) -> Json:
        pose = {"x": x, "y": y}
        move = {"action": 1, "poses": [pose], "targetPose": pose}
        client.ask("woosh.ros.CallAction", {"moveBase": move})
        ends = (1, -1, 5)
        body = client.next_push("woosh.ros.Feedbacks", lambda b: b["fbs"][0]["state"] in ends)
        end: Json = body["fbs"][0]
        return end

    assert "no free path" in end_of_drive(9.2, 0.0)["msg"]  # beyond the wall
    assert end_of_drive(0.0, 3.0)["state"] == 1


def test_uploaded_map_is_added_to_a_shipped_scene(client: JsonClient) -> None:
    before = maps(client)["wooshmap"]
    scene = switch_map(client, switch_request("wooshmap", floor_yaml=NAV2, floor_png=floor_png()))
    assert (scene["mapName"], scene["mapId"], scene["version"]) == ("floor", 4, "1")
    after = maps(client)
    assert list(after) == ["wooshmap", "floor"]
    assert after["wooshmap"] == before
    assert distance_ahead(client) == pytest.approx(8.0 - 4.0 - 0.25, abs=0.02)


def test_new_picture_of_a_map_keeps_its_marks(client: JsonClient) -> None:
    before = maps(client)["wooshmap"]
    picture = NAV2.replace(b"floor.png", b"wooshmap.png")
    request = switch_request("wooshmap", wooshmap_yaml=picture, wooshmap_png=floor_png())
    assert switch_map(client, request)["version"] == str(int(before["version"]) + 1)
    after = maps(client)["wooshmap"]
    assert (after["id"], after["storages"]) == (before["id"], before["storages"])
    assert distance_ahead(client) == pytest.approx(8.0 - 4.0 - 0.25, abs=0.02)
    client.ask("woosh.robot.ExecTask", {"taskId": "5", "type": 1, "markNo": "A2"})


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
    # An upload increments the versions of the maps that it changes.
    new = {"notes_txt": b"ho", "yard/map_png": floor_png(7.0)}
    scene = switch_map(client, switch_request("lab", "yard", **new))
    assert (scene["mapName"], scene["version"]) == ("yard", "8")
    assert maps(client)["hall"]["version"] == "1"


def test_uploaded_scene_brings_the_actions_of_its_tasks(client: JsonClient) -> None:
    table = b'{"task_type": [{"type": 1, "no": 0, "order": [{"action": 1}]}]}'
    files = {"scene.yaml": SCENE, **dotted({"floor_yaml": NAV2, "floor_png": floor_png()})}
    datas = file_datas({**files, "action_groups.json": table})
    switch_map(client, {"sceneName": "lab", "fileDatas": datas})
    assert client.ask("woosh.map.SceneData")["actionGroup"] == table.decode()
    distance_ahead(client)
    refusal = client.refusal("woosh.robot.ExecTask", {"type": 4, "markNo": "X1"})
    assert refusal.startswith("scene lab has no actions for tasks of type 4")


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
    ({"floor_yaml": b"image: [", "floor_png": floor_png()}, "floor.yaml: not readable as YAML"),
    ({"floor_yaml": b"image: floor.png"}, "floor.yaml: resolution is missing"),
    ({"scene_yaml": b"maps: 3"}, "scene.yaml: maps: must be a list"),
    ({"scene_yaml": SCENE}, "floor.yaml: the file is missing"),
    (
        {"floor_yaml": NAV2.replace(b"floor.png", b"/etc/hostname")},
        "hostname: the file is missing",
    ),
    (
        {"floor_yaml": NAV2.replace(b"floor.png", b"../floor.png")},
        "./floor.png: the file is missing",
    ),
    ({"floor_yaml": b"x: " + b"[" * 60000}, "floor.yaml: nested more than"),
    (
        {"floor_yaml": NAV2, "floor_yml": NAV2, "floor_png": floor_png()},
        "another file has the map name floor too",
    ),
    ({"../floor_png": b""}, "'../floor.png': the name must be a plain file name"),
    ({"/floor_png": b""}, "must be a plain file name"),
    ({"a\\b_png": b""}, "must be a plain file name"),
    ({"C:b_png": b""}, "must be a plain file name"),
    ({"": b""}, "must be a plain file name"),
    ({"..": b""}, "must be a plain file name"),
    ({"a\n_png": b""}, "must be a plain file name"),
    ({"a" * 300: b""}, "at most 255 characters"),
    (
        {f"{number}_png": b"" for number in range(1001)},
        "more than the limit of a scene: 1000 files",
    ),
]


UNREADABLE_FILES = {
    "mark_info.data": "not a serialised woosh.map.mark.MarkInfo",
    "nav_area.data": "not a serialised woosh.map.field.FieldInfo",
    "path_info.data": "not a serialised woosh.map.path.PathInfo",
}


@pytest.mark.parametrize("name", UNREADABLE_FILES)
@pytest.mark.parametrize("described", [True, False], ids=["described", "not described"])
def test_unreadable_files_of_a_map_are_refused(
    client: JsonClient, name: str, described: bool
) -> None:
    hall = b"maps: [{name: hall, walls: [[0, -9, 9, -9, 9, 9, 0, 9, 0, -9]]}]"
    files = {f"hall/{name}": b"\xff", **({"scene.yaml": hall} if described else {})}
    request = {"sceneName": "lab", "mapName": "hall", "fileDatas": file_datas(files)}
    assert UNREADABLE_FILES[name] in client.refusal("woosh.robot.SwitchMap", request)
    client.ask("woosh.map.SceneData")


@pytest.mark.parametrize("scene", ["new", "wooshmap"])
def test_invalid_uploads_are_refused_and_change_nothing(client: JsonClient, scene: str) -> None:
    before = library(client.simulator)
    for files, reason in INVALID_UPLOADS:
        text = client.refusal("woosh.robot.SwitchMap", switch_request(scene, **files))
        assert reason in text
        assert len(text) < 1000
        assert library(client.simulator) == before, reason


def test_total_size_of_uploads_is_limited() -> None:
    big = [FileData(name="big.bin", data=bytes(20 * 1024 * 1024))]
    files = scene_files.merge_files({}, big)
    assert list(scene_files.merge_files(files, big)) == ["big.bin"]
    with pytest.raises(RefusedError, match="2 files of 41943040 bytes are more"):
        scene_files.merge_files(files, [FileData(name="more.bin", data=big[0].data)])


def test_invalid_second_upload_keeps_the_first(client: JsonClient) -> None:
    switch_map(client, switch_request("lab", floor_yaml=NAV2, floor_png=floor_png()))
    text = client.refusal(
        "woosh.robot.SwitchMap", switch_request("lab", **{"floor/map_png": b"junk"})
    )
    assert text.startswith("scene lab is not changed: floor/map.png: ")
    assert client.ask("woosh.robot.Scene")["version"] == "1"
    assert distance_ahead(client) == pytest.approx(8.0 - 4.0 - 0.25, abs=0.02)
    missing = switch_request("lab", "attic", **{"floor/map_png": floor_png(7.0)})
    assert "unknown map attic of scene lab, which has floor" in client.refusal(
        "woosh.robot.SwitchMap", missing
    )
    assert distance_ahead(client) == pytest.approx(8.0 - 4.0 - 0.25, abs=0.02)


def test_duplicate_file_name_is_refused(client: JsonClient) -> None:
    files = [{"name": "a.bin", "data": ""}, {"name": "a.bin", "data": "AA=="}]
    request = {"sceneName": "new", "fileDatas": files}
    assert client.refusal("woosh.robot.SwitchMap", request) == "file a.bin is uploaded twice"


def test_damaged_uploads_cause_no_internal_error(client: JsonClient) -> None:
    """Each damaged upload is accepted, or refused with a reason."""
    rng = random.Random(9)
    whole = {"scene_yaml": SCENE, "floor_yaml": NAV2, "floor_png": floor_png()}
    for _ in range(60):
        files = dict(whole)
        name = rng.choice(list(files))
        data = bytearray(files[name])
        for _ in range(rng.randint(1, 4)):
            place = rng.randrange(len(data))
            kind = rng.random()
            if kind < 0.5:
                data[place] = rng.randrange(256)
            elif kind < 0.8:
                del data[place : place + rng.randint(1, 30)]
            else:
                data[place:place] = rng.randbytes(rng.randint(1, 10))
        files[name] = bytes(data)
        answer = client.request("woosh.robot.SwitchMap", switch_request("lab", **files))
        assert answer["ok"] or "internal error" not in answer["msg"], (name, bytes(data))
