"""A changed setting or device shows alike in its getter, its push and RobotInfo."""

from __future__ import annotations

from typing import Any

import pytest

from tests.simulator.sim_wire import Connect, Json, JsonClient
from woosh_robot_agent.pb.robot.robot_pack_pb2 import LED

LIGHT, REMOTE = "woosh.robot.LED", "woosh.device.RfRemoteController"

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


def test_permission_setters_are_answered_and_pushed(client: JsonClient) -> None:
    client.subscribe("woosh.robot.Setting")
    for name in ("AutoCharge", "AutoPark", "GoodsCheck"):
        key = name[0].lower() + name[1:]
        for allow in (False, True):
            body = {"allow": allow}
            assert client.ask(f"woosh.robot.setting.{name}", body) == body
            assert client.next_push("woosh.robot.Setting")["allow"][key] is allow


def test_pose_setters_move_the_robot_and_its_scan(client: JsonClient) -> None:
    for number, setter in enumerate(("InitRobot", "SetRobotPose")):
        pose = {"x": 1.0 + number, "y": 2.34, "theta": 1.57}
        client.ask(f"woosh.robot.{setter}", {"pose": pose})
        assert client.ask("woosh.robot.PoseSpeed")["pose"] == pytest.approx(pose)
        assert client.ask("woosh.robot.ScannerData")["pose"] == pytest.approx(pose)
    # An empty pose stands for the place where the robot is.
    before = client.ask("woosh.robot.PoseSpeed")
    client.ask("woosh.robot.InitRobot", {"isRecord": True, "pose": {"x": 0, "y": 0, "theta": 0}})
    assert client.ask("woosh.robot.PoseSpeed") == before


def test_subscription_pushes_only_later_changes_until_it_ends(
    client: JsonClient, connect: Connect
) -> None:
    other = connect()
    client.subscribe("woosh.robot.Mode", "woosh.robot.Mode", "woosh.robot.Nonsense")
    assert client.take_pushes("woosh.robot.Mode") == []
    client.ask("woosh.robot.SwitchWorkMode", {"mode": 3})
    assert len(client.take_pushes("woosh.robot.Mode")) == 1
    client.subscribe("woosh.robot.Mode", sub=False)
    other.subscribe("woosh.robot.Mode")  # each client has its own subscriptions
    client.ask("woosh.robot.SwitchWorkMode", {"mode": 2})
    assert client.take_pushes("woosh.robot.Mode") == []
    assert [body["work"] for body in other.take_pushes("woosh.robot.Mode")] == [2]


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


def test_emergency_stop_and_lost_localisation_show_in_all_states(client: JsonClient) -> None:
    abnormal, stopped, lost = "woosh.robot.count.AbnormalCodes", "110201000013", "130103000012"

    def next_codes() -> list[str]:
        return [each["code"] for each in client.next_push(abnormal)["scs"]]

    client.subscribe(abnormal, "woosh.robot.RobotState")
    client.simulator.set_emergency_stop(True)
    assert client.next_push("woosh.robot.RobotState")["state"] == 6
    info = client.ask("woosh.robot.RobotInfo")
    device = info["deviceState"]
    assert (device["hardware"], device["software"]) == (1024, 1)
    assert info["operationState"]["robot"] == 0
    assert [code["code"] for code in info["abnormalCodes"]["scs"]] == [stopped]
    client.pushes.clear()
    fault = client.simulator.inject("lost_localisation")
    assert next_codes() == [stopped, lost]
    assert client.ask("woosh.robot.DeviceState")["software"] == 0
    fault.clear()
    assert next_codes() == [stopped]
    assert "emergency stop" in client.refusal("woosh.robot.ExecTask", {"type": 1, "markNo": "A2"})
    assert "emergency stop" in client.refusal("woosh.robot.Twist", {"linear": 0.2})
    client.simulator.set_emergency_stop(False)
    assert client.ask("woosh.robot.count.AbnormalCodes")["scs"] == []
    assert client.ask("woosh.robot.RobotState")["state"] == 2
    client.ask("woosh.robot.ExecTask", {"type": 1, "markNo": "A2"})


def test_lights_are_kept_by_submodule(client: JsonClient) -> None:
    assert client.simulator.state.lights == {}
    red = {"submodule": 0, "urgency": 1, "abnormal": 2, "normal": 3, "color": 0xFF0000}
    answer = client.request(LIGHT, red)
    assert (answer["type"], answer["ok"], answer["body"]) == (LIGHT, True, red)
    client.ask(LIGHT, {"submodule": 2, "color": 7})
    client.ask(LIGHT, {"submodule": 2, "color": 8})
    assert client.simulator.state.lights == {0: LED(**red), 2: LED(submodule=2, color=8)}


def test_keys_of_the_remote_controller_are_pushed_when_they_change(client: JsonClient) -> None:
    client.subscribe(REMOTE)
    assert client.ask(REMOTE) == {"address": 0, "keys": 0}
    client.simulator.hold_remote_keys(0b101, address=7)
    assert client.next_push(REMOTE) == {"address": 7, "keys": 5}
    assert client.ask(REMOTE) == {"address": 7, "keys": 5}
    assert client.simulator.state.remote_keys == 5
    client.simulator.hold_remote_keys(0b101, address=7)
    client.simulator.hold_remote_keys(0, address=7)
    assert client.next_push(REMOTE) == {"address": 7, "keys": 0}
    assert client.take_pushes(REMOTE) == []
    # The keys of a fault are released at its end.
    client.simulator.inject("remote_keys", keys=2, address=3, for_=5)
    assert client.next_push(REMOTE) == {"address": 3, "keys": 2}
    assert client.next_push(REMOTE) == {"address": 3, "keys": 0}
