"""The map library: lists, files, renaming and deletion of scenes and maps."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterator
from typing import Any

import pytest

from tests.simulator.sim_wire import Json, JsonClient, connected
from tests.simulator.test_sim_uploads import (
    NAV2,
    SCENE,
    distance_ahead,
    dotted,
    file_datas,
    floor_png,
    library,
)
from woosh_robot_agent.simulator.refusals import REFUSALS

FULL = 1
EASY = "woosh.map.SceneDataEasy"
Files = dict[str, bytes]


@pytest.fixture
def second() -> Iterator[JsonClient]:
    """A client of another robot."""
    with connected(speed=50, seed=2) as client:
        yield client


def upload(scene: str, method: int = 0, **files: bytes) -> Json:
    """Return the body of an Upload request; see `dotted`."""
    return {"sceneName": scene, "fileDatas": file_datas(dotted(files)), "method": method}


def upload_lab(client: JsonClient) -> None:
    """Upload a scene with two maps, of which `yard` has a picture."""
    files = {"scene_yaml": SCENE, "floor_yaml": NAV2, "floor_png": floor_png()}
    assert client.ask("woosh.map.Upload", upload("lab", **files)) == {}


def download(client: JsonClient, scene: str = "") -> Files:
    answer = client.request("woosh.map.Download", {"sceneName": scene})
    assert (answer["ok"], answer["type"]) == (True, "woosh.map.DownloadResponse"), answer
    return {each["name"]: base64.b64decode(each["data"]) for each in answer["body"]["fileDatas"]}


def send_files(client: JsonClient, scene: str, files: Files) -> Json:
    body = {"sceneName": scene, "fileDatas": file_datas(files), "method": FULL}
    return client.request("woosh.map.Upload", body)


def scenes(client: JsonClient) -> dict[str, list[str]]:
    return {
        each["name"]: each["maps"] for each in client.ask("woosh.map.SceneList").get("scenes", [])
    }


def scene_data(client: JsonClient, scene: str) -> Any:
    """Return SceneData without name and versions, which differ between robots."""
    data = client.ask("woosh.map.SceneData", {"name": scene})
    for each in data["maps"]:
        del each["markInfo"]["version"]
    return {**data, "name": ""}


def version(client: JsonClient, scene: str, area: str) -> int:
    data = client.ask(EASY, {"name": scene})
    return int(next(each["version"] for each in data["maps"] if each["name"] == area))


def test_a_downloaded_scene_is_the_same_on_another_robot(
    client: JsonClient, second: JsonClient
) -> None:
    upload_lab(client)
    for scene in ("wooshmap", "scenex", "lab"):
        files = download(client, scene)
        assert {"scene.json", "action_groups.json", "task_info.data"} <= set(files)
        for area in scenes(client)[scene]:
            names = {f"{area}/{name}" for name in ("map.yaml", "map.png", "mark_info.data")}
            assert names <= set(files)
        assert send_files(second, "copy", files)["ok"]
        assert scene_data(second, "copy") == scene_data(client, scene)
        assert download(second, "copy") == files
        # Nothing changes for a robot that gets its own files.
        assert send_files(client, scene, files)["ok"]
        assert download(client, scene) == files


def test_an_incremental_upload_keeps_the_other_files_and_a_full_one_does_not(
    client: JsonClient,
) -> None:
    upload_lab(client)
    big = bytes(range(256)) * 4096 * 3  # more than a usual WebSocket frame holds
    new = {"notes_txt": b"hello", "yard/map_png": floor_png(7.0), "yard/state_pbstream": big}
    client.ask("woosh.map.Upload", upload("lab", **new))
    assert scenes(client)["lab"] == ["hall", "yard"]
    files = download(client, "lab")
    assert (files["notes.txt"], files["yard/state.pbstream"]) == (b"hello", big)
    assert not {"scene.yaml", "floor.yaml", "floor.png"} & set(files)  # the robot has its own form
    assert (version(client, "lab", "hall"), version(client, "lab", "yard")) == (1, 8)
    client.ask("woosh.robot.SwitchMap", {"sceneName": "lab", "mapName": "yard"})
    assert distance_ahead(client) == pytest.approx(7.0 - 4.0 - 0.25, abs=0.02)
    client.ask("woosh.robot.SwitchMap", {"sceneName": "wooshmap"})
    client.ask("woosh.map.Upload", upload("lab", FULL, floor_yaml=NAV2, floor_png=floor_png()))
    assert scenes(client)["lab"] == ["floor"]
    assert "notes.txt" not in download(client, "lab")


def test_an_upload_to_the_current_scene_takes_effect_and_is_pushed(client: JsonClient) -> None:
    client.subscribe("woosh.robot.Scene")
    before, (marked,) = client.ask("woosh.robot.Scene"), client.ask(EASY)["maps"]
    picture = NAV2.replace(b"floor.png", b"wooshmap.png")
    new = upload("wooshmap", wooshmap_yaml=picture, wooshmap_png=floor_png())
    client.ask("woosh.map.Upload", new)
    pushed = client.next_push("woosh.robot.Scene")
    assert pushed == {**before, "version": str(int(before["version"]) + 1)}
    (area,) = client.ask(EASY)["maps"]
    assert (area["id"], area["storages"]) == (marked["id"], marked["storages"])
    assert distance_ahead(client) == pytest.approx(8.0 - 4.0 - 0.25, abs=0.02)


def test_files_are_compared_by_their_md5_sums_and_fetched_one_by_one(client: JsonClient) -> None:
    upload_lab(client)
    answer = client.request("woosh.map.SceneMd5", {})
    assert answer["type"] == "woosh.map.SceneMd5Response"
    found = {each["sceneName"]: each for each in answer["body"]["scenes"]}
    assert set(found) == {"wooshmap", "scenex", "lab"}
    files = download(client, "lab")
    assert [(each["mapName"], each["version"]) for each in found["lab"]["maps"]] == [
        ("hall", 1),
        ("yard", 7),
    ]
    sums = {
        each["name"]: each["md5"]
        for part in (found["lab"]["scenesMd5s"], *(m["mapMd5s"] for m in found["lab"]["maps"]))
        for each in part
    }
    assert sums == {name: hashlib.md5(data).hexdigest() for name, data in files.items()}
    one = client.ask("woosh.map.SceneMd5", {"sceneName": "lab"})
    assert one == {"scenes": [found["lab"]]}

    wanted = {
        "sceneName": "lab",
        "scenesMd5s": [{"name": "task_info.data", "md5": "0"}],
        "maps": [{"mapName": "yard", "mapMd5s": [{"name": "yard/map.png", "md5": "0"}]}],
    }
    answer = client.request("woosh.map.SceneSync", {"scenes": [wanted]})
    assert answer["type"] == "woosh.map.SceneSyncResponse"
    synced = {each["name"]: base64.b64decode(each["data"]) for each in answer["body"]["fileDatas"]}
    assert synced == {name: files[name] for name in ("task_info.data", "yard/map.png")}
    wanted["scenesMd5s"] = [{"name": "other.data", "md5": "0"}]
    assert "scene lab has no file other.data" in client.refusal(
        "woosh.map.SceneSync", {"scenes": [wanted]}
    )


def test_scene_and_map_can_be_renamed(client: JsonClient) -> None:
    upload_lab(client)
    before = scene_data(client, "lab")
    client.ask("woosh.map.Rename", {"oldSceneName": "lab", "newSceneName": "works"})
    assert set(scenes(client)) == {"wooshmap", "scenex", "works"}
    assert scene_data(client, "works") == before
    rename = {"oldSceneName": "works", "oldMapName": "yard", "newMapName": "court"}
    client.ask("woosh.map.Rename", rename)
    assert scenes(client)["works"] == ["hall", "court"]
    assert version(client, "works", "court") == 8
    client.ask("woosh.robot.SwitchMap", {"sceneName": "works", "mapName": "court"})
    assert distance_ahead(client) == pytest.approx(8.0 - 4.0 - 0.25, abs=0.02)
    files = download(client, "works")
    assert {"court/map.yaml", "court/map.png", "court/mark_info.data"} <= set(files)
    assert not any(name.startswith("yard/") for name in files)
    # A new map of the old name does not replace it.
    new = {"yard_yaml": NAV2, "floor_png": floor_png(6.0)}
    client.ask("woosh.map.Upload", upload("works", **new))
    assert scenes(client)["works"] == ["hall", "court", "yard"]


def test_renaming_the_current_scene_and_map_is_pushed(client: JsonClient) -> None:
    client.subscribe("woosh.robot.Scene")
    before = client.ask("woosh.robot.Scene")
    rename = {"newSceneName": "home", "oldMapName": "wooshmap", "newMapName": "hall"}
    client.ask("woosh.map.Rename", rename)
    pushed = client.next_push("woosh.robot.Scene")
    expected = {"sceneName": "home", "mapName": "hall", "version": str(int(before["version"]) + 1)}
    assert pushed == {**before, **expected}
    assert scenes(client) == {"scenex": ["scenex", "scenex2"], "home": ["hall"]}
    client.ask("woosh.robot.ExecTask", {"taskId": "5", "type": 1, "markNo": "A2"})


def test_scene_and_map_can_be_deleted(client: JsonClient) -> None:
    client.ask("woosh.map.Delete", {"sceneName": "scenex", "mapName": "scenex2"})
    assert scenes(client)["scenex"] == ["scenex"]
    client.ask("woosh.map.Delete", {"sceneName": "scenex"})
    assert scenes(client) == {"wooshmap": ["wooshmap"]}


REFUSED: list[tuple[str, Json, str]] = [
    ("Download", {"sceneName": "moon"}, "unknown scene moon"),
    ("SceneSync", {"scenes": [{"sceneName": "moon"}]}, "unknown scene moon"),
    ("Delete", {}, "scene_name is empty"),
    ("Delete", {"sceneName": "wooshmap"}, "the robot is in scene wooshmap: switch"),
    ("Delete", {"sceneName": "scenex", "mapName": "attic"}, "unknown map attic of scene scenex"),
    ("Delete", {"mapName": "wooshmap"}, "the robot is on map wooshmap: switch"),
    ("Delete", {"sceneName": "lab", "mapName": "floor"}, "the only one of scene lab"),
    ("Rename", {}, "new_scene_name is empty"),
    ("Rename", {"newSceneName": "scenex"}, "scene scenex exists already"),
    ("Rename", {"newSceneName": "../x"}, "new_scene_name '../x' must be a name"),
    ("Rename", {"oldMapName": "wooshmap"}, "new_map_name is empty"),
    ("Rename", {"newMapName": "x"}, "old_map_name is empty"),
    (
        "Rename",
        {"oldSceneName": "scenex", "oldMapName": "scenex", "newMapName": "scenex2"},
        "map scenex2 of scene scenex exists already",
    ),
    ("Rename", {"oldMapName": "wooshmap", "newMapName": "a/b"}, "new_map_name 'a/b' must be"),
    ("Upload", {"sceneName": "new"}, "the upload has no files"),
    ("Upload", upload("../new", a_png=floor_png()), "scene_name '../new' must be a name"),
    ("Upload", upload("new", notes_txt=b"hi"), "no file describes a map of scene new"),
    ("Upload", upload("lab", floor_png=floor_png()[:-400]), "floor.png: not readable as a PNG"),
    ("Upload", upload("wooshmap", FULL, notes_txt=b"hi"), "no file describes a map"),
    (
        "Upload",
        upload("wooshmap", FULL, floor_yaml=NAV2, floor_png=floor_png()),
        "the upload has no map wooshmap, which the robot is on",
    ),
]


def test_bad_requests_are_refused_and_change_nothing(client: JsonClient) -> None:
    client.ask("woosh.map.Upload", upload("lab", floor_yaml=NAV2, floor_png=floor_png()))
    before = library(client.simulator)
    for name, body, reason in REFUSED:
        assert reason in client.refusal(f"woosh.map.{name}", body)
        assert library(client.simulator) == before, reason


def test_the_current_scene_is_not_replaced_during_a_task(client: JsonClient) -> None:
    before = library(client.simulator)
    client.ask("woosh.robot.ExecTask", {"taskId": "5", "type": 1, "markNo": "A2"})
    text = client.refusal("woosh.map.Upload", upload("wooshmap", notes_txt=b"hi"))
    assert text == str(REFUSALS["MAP_CHANGE_DURING_TASK"].explanation)
    assert library(client.simulator) == before
    client.ask("woosh.map.Upload", upload("scenex", notes_txt=b"hi"))
