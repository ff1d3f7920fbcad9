"""Marks of the current map: created, found, changed, deleted, and used by tasks."""

from __future__ import annotations

import base64
from typing import Any

import pytest
from google.protobuf.json_format import ParseDict

from tests.simulator.sim_wire import Json, JsonClient
from woosh_robot_agent.pb.map.storage_edit_pb2 import Create
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.protocol.handlers import dispatch
from woosh_robot_agent.simulator.world.maps import Mark

PREFIX, SCENE = "woosh.map.mark.storage", "woosh.robot.Scene"
EVERYTHING: Json = {
    "identity": {"id": 77, "no": "N1", "desc": "new one"},
    "pose": {
        "dock": {"x": 4.0, "y": -6.5, "theta": 0.5},
        "real": {"x": 4.5, "y": -6.5, "theta": 0.5},
        "adjust": {"pose": {"x": 3.5, "y": -6.5, "theta": 0.5}},
    },
    "nav": {"arr": 1},
    "dock": {"boardType": 1, "tag": "north", "verify": {"topPhotoelec": True}},
    "custom": base64.b64encode(b"\x00\xff").decode(),
    "rack": {"numbers": ["R1", "R2"]},
}


def storage(number: str = "N1", x: float = 4.0, y: float = -6.5, **more: Any) -> Json:
    identity = {"no": number, **more.pop("identity", {})}
    return {"storage": {"identity": identity, "pose": {"dock": {"x": x, "y": y}}, **more}}


def find(client: JsonClient, number: str) -> Json:
    answer = client.request(f"{PREFIX}.Find", {"no": number})
    assert (answer["ok"], answer["type"]) == (True, "woosh.map.mark.Storage"), answer
    found: Json = answer["body"]
    return found


def without_defaults(value: Any) -> Any:
    if isinstance(value, dict):
        found = {key: without_defaults(each) for key, each in value.items()}
        return {key: each for key, each in found.items() if each not in (0, "", False, [], {})}
    return value


def run_task(client: JsonClient, mark: str) -> None:
    client.subscribe("woosh.robot.TaskProc")
    client.ask("woosh.robot.ExecTask", {"taskId": "9", "type": 1, "markNo": mark})
    client.next_push("woosh.robot.TaskProc", lambda body: body.get("state") in (7, 8, 9))


def test_created_mark_is_found_with_all_its_data(client: JsonClient) -> None:
    answer = client.request(f"{PREFIX}.Create", {"storage": EVERYTHING})
    assert (answer["ok"], answer["type"]) == (True, "woosh.map.mark.Storage"), answer
    assert without_defaults(answer["body"]) == EVERYTHING
    assert without_defaults(find(client, "N1")) == EVERYTHING
    answer = client.request(f"{PREFIX}.Storages")
    assert answer["type"] == "woosh.map.mark.Storages"
    assert "N1" in [each["identity"]["no"] for each in answer["body"]["racks"]]
    (area,) = client.ask("woosh.map.SceneData")["maps"]
    found = [each for each in area["markInfo"]["storages"] if each["identity"]["no"] == "N1"]
    assert [without_defaults(each) for each in found] == [EVERYTHING]
    # Marks without an id get a free one.
    taken = {each["identity"]["id"] for each in area["markInfo"]["storages"]}
    ids = [client.ask(f"{PREFIX}.Create", storage(number))["identity"]["id"] for number in "xy"]
    assert len({*ids, *taken}) == len(taken) + 2


def test_tasks_use_created_moved_and_deleted_marks_at_once(client: JsonClient) -> None:
    version = int(client.ask(SCENE)["version"])
    client.ask(f"{PREFIX}.Create", storage(x=5.0, y=-6.5))
    run_task(client, "N1")
    assert (client.simulator.state.pose.x, client.simulator.state.pose.y) == pytest.approx(
        (5.0, -6.5), abs=0.05
    )
    assert client.ask(f"{PREFIX}.Update", storage(x=4.0, y=-7.5)) == {}
    run_task(client, "N1")
    assert (client.simulator.state.pose.x, client.simulator.state.pose.y) == pytest.approx(
        (4.0, -7.5), abs=0.05
    )
    assert client.ask(f"{PREFIX}.Delete", {"no": "N1"}) == {}
    text = client.refusal("woosh.robot.ExecTask", {"taskId": "9", "type": 1, "markNo": "N1"})
    assert "unknown mark N1" in text
    assert "unknown mark N1" in client.refusal(f"{PREFIX}.Find", {"no": "N1"})
    assert client.ask(SCENE)["version"] == str(version + 3)  # each change is a new version


def test_update_changes_only_what_it_gives(client: JsonClient) -> None:
    client.ask(f"{PREFIX}.Create", {"storage": EVERYTHING})
    client.ask(f"{PREFIX}.Update", storage(x=5.0))
    moved = without_defaults(find(client, "N1"))
    assert moved == {**EVERYTHING, "identity": {"id": 77, "no": "N1"}, "pose": moved["pose"]}
    assert moved["pose"] == {"dock": {"x": 5.0, "y": -6.5}}
    client.ask(f"{PREFIX}.Update", {"storage": {"identity": {"no": "N1"}, "charger": {}}})
    changed = find(client, "N1")
    assert "rack" not in changed
    assert "charger" in changed


def test_update_by_id_gives_a_new_number(client: JsonClient) -> None:
    id_ = find(client, "A2")["identity"]["id"]
    client.ask(f"{PREFIX}.Update", storage("B2", identity={"id": id_}))
    assert find(client, "B2")["identity"]["id"] == id_
    assert "unknown mark A2" in client.refusal(f"{PREFIX}.Find", {"no": "A2"})


def test_changed_marks_survive_another_map_and_an_upload(client: JsonClient) -> None:
    client.ask(f"{PREFIX}.Create", {"storage": EVERYTHING})
    client.ask(f"{PREFIX}.Delete", {"no": "A1"})
    client.ask("woosh.robot.SwitchMap", {"sceneName": "scenex"})
    assert "unknown mark N1" in client.refusal(f"{PREFIX}.Find", {"no": "N1"})
    files = [{"name": "notes.txt", "data": "AA=="}]
    client.ask("woosh.robot.SwitchMap", {"sceneName": "wooshmap", "fileDatas": files})
    assert without_defaults(find(client, "N1")) == EVERYTHING
    assert "unknown mark A1" in client.refusal(f"{PREFIX}.Find", {"no": "A1"})


def test_change_of_a_mark_does_not_touch_the_localisation(client: JsonClient) -> None:
    pose = client.simulator.state.pose
    client.simulator.inject("obstacle", x=pose.x, y=pose.y)
    client.ask(f"{PREFIX}.Create", storage())
    client.ask("woosh.map.Rename", {"newSceneName": "home"})
    assert client.ask("woosh.robot.DeviceState")["software"] & 1
    client.ask(f"{PREFIX}.Find", {"no": "N1"})


REFUSED: list[tuple[str, Json, str]] = [
    ("Find", {"no": "Z9"}, "unknown mark Z9 in map wooshmap"),
    ("Find", {}, "unknown mark"),
    ("Delete", {"no": "Z9"}, "unknown mark Z9 in map wooshmap"),
    ("Update", storage("Z9"), "unknown mark Z9 in map wooshmap"),
    ("Update", storage("Z9", identity={"id": 4000}), "unknown mark Z9"),
    ("Update", storage("A1", identity={"id": 2}), "has the id 2 already"),
    ("Update", storage("A1", x=99.0), "mark A1 is outside map wooshmap"),
    ("Create", {}, "the mark has no number"),
    ("Create", storage("A1"), "mark A1 of map wooshmap exists already"),
    ("Create", storage(identity={"id": 1}), "has the id 1 already"),
    ("Create", {"storage": {"identity": {"no": "N1"}}}, "mark N1 has no pose"),
    ("Create", storage(x=99.0), "mark N1 is outside map wooshmap"),
    ("Create", storage(x=float("nan")), "storage.pose.dock.x is not a finite number"),
    ("Create", storage("n" * 101), "identity.no is longer than 100 characters"),
    ("Create", storage(identity={"desc": "d" * 5000}), "bytes, more than 4096"),
]


def test_bad_requests_are_refused_and_change_nothing(client: JsonClient) -> None:
    before = client.ask("woosh.map.SceneData")
    for name, body, reason in REFUSED:
        assert reason in client.refusal(f"{PREFIX}.{name}", body)
        assert client.ask("woosh.map.SceneData") == before, reason


def test_number_of_marks_is_limited(chassis: Chassis) -> None:
    marks = {f"m{n}": Mark(n, f"m{n}", chassis.base.pose) for n in range(1, 5000)}
    chassis.change_map(marks=marks)
    one, two = (ParseDict(storage(number), Create()) for number in ("one", "two"))
    assert dispatch(chassis, one).ok
    assert dispatch(chassis, two).msg == "map wooshmap has 5000 marks already: delete one first"
