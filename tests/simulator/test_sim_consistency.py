"""A changed setting shows alike in its getter, its push and RobotInfo."""

from __future__ import annotations

from typing import Any

import pytest

from tests.simulator.sim_wire import Connect, Json, JsonClient

# Setter, its body, the state message it changes, its field in RobotInfo, expected fields.
SETTERS: list[tuple[str, Json, str, str, Json]] = [
    ("SetOccupancy", {"occupy": True}, "DeviceState", "deviceState", {"software": 1 | 8}),
    ("SetMuteCall", {"mute": True}, "DeviceState", "deviceState", {"software": 1 | 16}),
    ("SetProgramMute", {"mute": True}, "DeviceState", "deviceState", {"software": 1 | 32}),
    ("SwitchControlMode", {"mode": 2}, "Mode", "mode", {"ctrl": 2, "work": 2}),
    ("SwitchWorkMode", {"mode": 3}, "Mode", "mode", {"ctrl": 1, "work": 3}),
    ("SwitchControlMode", {"mode": 2}, "OperationState", "operationState", {"robot": 0}),
    ("SwitchFootPrint", {"type": 1}, "Model", "model", {"type": 1}),
    ("SwitchMap", {"sceneName": "scenex"}, "Scene", "scene", {"sceneName": "scenex", "mapId": 1}),
    ("SwitchMap", {"sceneName": "scenex"}, "PoseSpeed", "poseSpeed", {"mapId": 1}),
    ("RobotWiFi", {"order": 5, "enable": True}, "Network", "network", {}),
    *(
        (f"setting.{name}", body, "Setting", "setting", {name.lower(): body})
        for name, body in {
            "Identity": {"name": "woow"},
            "Server": {"ip": "10.0.0.1", "port": 99},
            "Power": {"alarm": 5, "low": 20, "idle": 80, "full": 100},
            "Sound": {"mute": True, "volume": 7},
        }.items()
    ),
]


@pytest.mark.parametrize(("setter", "body", "state", "part", "expected"), SETTERS)
def test_setter_changes_getter_push_and_robot_info(
    client: JsonClient, setter: str, body: Json, state: str, part: str, expected: Json
) -> None:
    name = f"woosh.robot.{state}"
    before = client.ask(name)
    client.subscribe(name)
    client.ask(f"woosh.robot.{setter}", body)
    pushed = client.next_push(name)
    assert pushed != before
    assert pushed == {**pushed, **expected}
    assert client.ask(name) == pushed
    assert client.ask("woosh.robot.RobotInfo")[part] == pushed
    # Setting the same value again changes nothing, so nothing is pushed.
    client.ask(f"woosh.robot.{setter}", body)
    assert client.take_pushes(name) == []


@pytest.mark.parametrize("allow", ["AutoCharge", "AutoPark", "GoodsCheck"])
def test_permission_setters_are_answered_and_pushed(client: JsonClient, allow: str) -> None:
    key = allow[0].lower() + allow[1:]
    client.subscribe("woosh.robot.Setting")
    assert client.ask(f"woosh.robot.setting.{allow}", {"allow": False}) == {"allow": False}
    assert client.next_push("woosh.robot.Setting")["allow"][key] is False
    assert client.ask(f"woosh.robot.setting.{allow}", {"allow": True}) == {"allow": True}
    assert client.next_push("woosh.robot.Setting")["allow"][key] is True


def test_setter_answers_with_the_new_value(client: JsonClient) -> None:
    assert client.ask("woosh.robot.SwitchWorkMode", {"mode": 3})["work"] == 3
    assert client.ask("woosh.robot.SwitchFootPrint", {"type": 2}) == {"type": 2}
    assert client.ask("woosh.robot.setting.Identity", {"name": "x"}) == {"name": "x"}


@pytest.mark.parametrize("setter", ["InitRobot", "SetRobotPose"])
def test_pose_setter_moves_robot_and_scan(client: JsonClient, setter: str) -> None:
    client.subscribe("woosh.robot.PoseSpeed")
    client.ask(f"woosh.robot.{setter}", {"pose": {"x": 1.23, "y": 2.34, "theta": 1.57}})
    pose = client.next_push("woosh.robot.PoseSpeed")["pose"]
    assert [pose["x"], pose["y"], pose["theta"]] == pytest.approx([1.23, 2.34, 1.57])
    scan = client.ask("woosh.robot.ScannerData")
    assert scan["pose"] == pose
    assert client.simulator.state.pose.x == pytest.approx(1.23)


def test_init_robot_in_place_ignores_the_empty_pose(client: JsonClient) -> None:
    before = client.ask("woosh.robot.PoseSpeed")
    client.ask("woosh.robot.InitRobot", {"isRecord": True, "pose": {"x": 0, "y": 0, "theta": 0}})
    assert client.ask("woosh.robot.PoseSpeed") == before


def test_subscription_pushes_only_later_changes_until_it_ends(client: JsonClient) -> None:
    client.subscribe("woosh.robot.Mode", "woosh.robot.Mode", "woosh.robot.Nonsense")
    assert client.take_pushes("woosh.robot.Mode") == []
    client.ask("woosh.robot.SwitchWorkMode", {"mode": 3})
    assert len(client.take_pushes("woosh.robot.Mode")) == 1
    client.subscribe("woosh.robot.Mode", sub=False)
    client.ask("woosh.robot.SwitchWorkMode", {"mode": 2})
    assert client.take_pushes("woosh.robot.Mode") == []


def test_each_client_has_its_own_subscriptions(client: JsonClient, connect: Connect) -> None:
    other = connect()
    client.subscribe("woosh.robot.Mode")
    other.ask("woosh.robot.SwitchWorkMode", {"mode": 3})
    assert client.next_push("woosh.robot.Mode")["work"] == 3
    # A later subscriber gets only the changes after its subscription.
    other.subscribe("woosh.robot.Mode")
    client.ask("woosh.robot.SwitchWorkMode", {"mode": 2})
    assert [body["work"] for body in other.take_pushes("woosh.robot.Mode")] == [2]


def test_uploaded_scene_is_kept(client: JsonClient) -> None:
    files = [{"name": "map.png", "data": "AQID"}]
    client.ask("woosh.robot.SwitchMap", {"sceneName": "new", "mapName": "m", "fileDatas": files})
    scene = client.ask("woosh.robot.Scene")
    assert (scene["sceneName"], scene["mapName"], scene["version"]) == ("new", "m", "1")
    client.ask("woosh.robot.SwitchMap", {"sceneName": "new", "fileDatas": files})
    assert client.ask("woosh.robot.Scene")["version"] == "1"  # its map has not changed
    client.ask("woosh.robot.SwitchMap", {"sceneName": "wooshmap"})
    client.ask("woosh.robot.SwitchMap", {"sceneName": "new"})
    kept = {each["name"]: each["data"] for each in client.ask("woosh.map.Download")["fileDatas"]}
    assert kept["map.png"] == "AQID"


def test_scene_data_groups_marks_by_kind(client: JsonClient) -> None:
    data = client.ask("woosh.map.SceneDataEasy")
    (area,) = data["maps"]
    groups: dict[str, list[Any]] = area["storages"]
    numbers = {group: {each["identity"]["no"] for each in marks} for group, marks in groups.items()}
    assert data["name"] == area["name"] == "wooshmap"
    assert {"A2", "A23"} <= numbers["racks"]
    assert numbers["chargers"] == {"C1"}
    assert numbers["parkspots"] == {"P1"}
    assert all(numbers.values())  # there is a mark of each kind
    (charger,) = groups["chargers"]
    assert charger["pose"]["dock"]["x"] == pytest.approx(-10.8)


def test_task_sets_of_the_scene_are_listed(client: JsonClient) -> None:
    sets = [each["taskSet"] for each in client.ask("woosh.task.RepeatTasks")["repeatTasks"]]
    calls = [each["taskSet"] for each in client.ask("woosh.task.CallTasks")["callTasks"]]
    assert {666, 1735291765} <= {each["base"]["id"] for each in sets}
    assert calls


def test_wifi_orders_show_in_network(client: JsonClient) -> None:
    client.subscribe("woosh.ros.Feedbacks", "woosh.robot.Network")
    answer = client.ask("woosh.robot.RobotWiFi", {"order": 1})
    network = client.next_push("woosh.robot.Network")
    assert network["wifi"]["listJson"] == answer["content"]
    client.ask("woosh.robot.RobotWiFi", {"order": 4, "content": "d29vc2gtZmFjdG9yeQ=="})
    assert client.next_push("woosh.robot.Network")["wifi"]["name"] == ""


def test_emergency_stop_shows_in_all_states(client: JsonClient) -> None:
    topics = ["DeviceState", "RobotState", "OperationState", "HardwareState"]
    client.subscribe("woosh.robot.count.AbnormalCodes", *(f"woosh.robot.{t}" for t in topics))
    client.simulator.set_emergency_stop(True)
    assert client.next_push("woosh.robot.RobotState")["state"] == 6
    info = client.ask("woosh.robot.RobotInfo")
    assert info["deviceState"]["hardware"] == 1024
    assert info["operationState"]["robot"] == 0
    assert [code["code"] for code in info["abnormalCodes"]["scs"]] == ["110201000013"]
    assert "emergency stop" in client.refusal("woosh.robot.ExecTask", {"type": 1, "markNo": "A2"})
    assert "emergency stop" in client.refusal("woosh.robot.Twist", {"linear": 0.2})
    client.simulator.set_emergency_stop(False)
    assert client.ask("woosh.robot.count.AbnormalCodes")["scs"] == []
    assert client.ask("woosh.robot.RobotState")["state"] == 2
    client.ask("woosh.robot.ExecTask", {"type": 1, "markNo": "A2"})
