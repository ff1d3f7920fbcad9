"""Every request of the endpoint table is answered, and refusals give the reason."""

from __future__ import annotations

from typing import Any

from tests.fact_files import facts
from tests.simulator.sim_wire import JsonClient
from woosh_robot_agent.endpoints import COMMANDS, QUERIES

IDLE, FAULT = 2, 6
# Bodies of the requests that must not be empty.
BODIES: dict[str, Any] = {
    "woosh.robot.SwitchControlMode": {"mode": 1},
    "woosh.robot.SwitchWorkMode": {"mode": 2},
    "woosh.robot.SwitchMap": {"sceneName": "scenex"},
    "woosh.robot.ExecPreTask": {"taskSetId": 666},
    "woosh.robot.ExecTask": {"type": 1, "markNo": "A23"},
    "woosh.robot.ActionOrder": {"order": 2},
    "woosh.robot.ChangeNavPath": {
        "paths": {"planPath": [{"path": {"poses": [{"x": 1.23, "y": 2.34}]}}]}
    },
    "woosh.robot.RobotWiFi": {"order": 1},
}


def test_every_service_is_answered_with_its_type(client: JsonClient) -> None:
    endpoints = facts("endpoints.yaml")
    services = endpoints["info_services"] | endpoints["command_services"]
    for service in services.values():
        request = service["request"]
        answer = client.request(request, BODIES.get(request))
        assert answer["ok"] is True, answer
        assert answer["type"] == service.get("answer", request)
        assert isinstance(answer["msg"], str)
        assert isinstance(answer["timestamp"], int)


REQUESTS = {each.request for each in (*QUERIES, *COMMANDS)} | {"woosh.device.RfRemoteController"}


def test_no_request_is_refused_as_unknown(client: JsonClient) -> None:
    for name in sorted(REQUESTS):
        answer = client.request(name)
        unknown = answer["type"] == "error" or answer["msg"].startswith("unknown message type")
        assert not unknown, answer
        assert answer["ok"] or (answer["type"], answer["body"]) == (name, {})
        assert answer["ok"] or answer["msg"], name


def test_unknown_messages_are_refused(client: JsonClient) -> None:
    for name in ("woosh.robot.Nonsense", "woosh.dispatch.FindTask", "google.protobuf.Any"):
        client.send({"type": name, "body": {}, "sn": 9})
        answer = client.receive()
        assert answer == {**answer, "type": "error", "ok": False, "body": {}, "sn": 9}
        assert answer["msg"] == f"unknown message type {name}"
    client.send({"body": {}, "sn": 10})
    assert client.receive()["msg"] == "the request has no type"


INVALID: list[tuple[str, Any, str]] = [
    ("woosh.robot.ExecTask", {"markNo": "Z9"}, "unknown mark Z9"),
    ("woosh.robot.ExecTask", {}, "no target"),
    ("woosh.robot.ExecTask", {"markNo": "A2"}, "the task has no type"),
    ("woosh.robot.ExecTask", {"planPath": {"planPath": [{}]}}, "no poses"),
    (
        "woosh.robot.ExecTask",
        {"type": 1, "planPath": {"planPath": [{"path": {"poses": [{"x": 3.0}] * 201}}]}},
        "201 poses",
    ),
    ("woosh.robot.ExecTask", {"markNo": "A2", "type": 3}, "not a charger"),
    (
        "woosh.robot.ExecTask",
        {"markNo": "C1", "type": 3, "taskTypeNo": 7},
        "no actions for tasks of type 3 with the number 7: the numbers of this type are 0, 1",
    ),
    ("woosh.robot.ExecTaskSet", {"repeatTimes": 2}, "ExecTaskSet names no task set"),
    ("woosh.robot.ActionOrder", {"order": 2}, "no task is running"),
    ("woosh.robot.ActionOrder", {"order": 4}, "no task is running"),
    ("woosh.robot.ActionOrder", {"order": 6}, "no task is waiting"),
    ("woosh.robot.ActionOrder", {"order": 99}, "unknown order 99"),
    ("woosh.robot.ActionOrder", {"order": 1}, "not supported"),
    ("woosh.robot.ChangeNavPath", {"paths": {}}, "no navigation is running"),
    ("woosh.robot.SwitchControlMode", {"mode": 0}, "unknown control mode 0"),
    ("woosh.robot.SwitchWorkMode", {"mode": 9}, "unknown work mode 9"),
    ("woosh.robot.SwitchFootPrint", {"type": 9}, "unknown footprint 9"),
    ("woosh.robot.SwitchMap", {"sceneName": "moon"}, "unknown scene moon"),
    ("woosh.map.SceneData", {"name": "moon"}, "unknown scene moon"),
    ("woosh.robot.SwitchMap", {"mapName": "attic"}, "unknown map attic"),
    ("woosh.robot.SwitchMap", {"sceneName": "wooshmap", "mapName": "scenex2"}, "unknown map"),
    ("woosh.robot.InitRobot", {"pose": {"x": -5, "y": -6}}, "inside a wall"),
    ("woosh.robot.InitRobot", {"pose": {"x": 99}}, "outside map"),
    ("woosh.robot.Twist", {"linear": "NaN"}, "linear is not a finite number"),
    ("woosh.robot.Twist", {"linear": "fast"}, "unreadable body"),
    ("woosh.robot.setting.Power", {"alarm": 90, "full": 80}, "must rise"),
    ("woosh.robot.setting.Sound", {"volume": 101}, "not within 0 to 100"),
    ("woosh.ros.CallAction", {}, "names no action"),
    ("woosh.ros.CallAction", {"anyAction": {"type": "x"}}, "unknown action x"),
    ("woosh.ros.CallAction", {"moveBase": {"action": 1}}, "no target"),
    ("woosh.ros.CallAction", {"navMode": {"mode": 1}}, "no navigation is running"),
    ("woosh.ros.CallAction", {"navMode": {"mode": 3, "waitTime": 1e38}}, "wait_time is"),
    ("woosh.ros.CallAction", {"liftControl2": {"action": 1, "height": 1.1}}, "lift"),
    (
        "woosh.ros.CallAction",
        {"stepControl": {"action": 1, "steps": [{"mode": 1, "value": 0.001}] * 1001}},
        "StepControl has 1001 steps, more than 1000: split it into several requests",
    ),
    ("woosh.ros.CallAction", {"liftControl": {"action": 1}}, "unknown lift mode 0"),
    (
        "woosh.ros.CallAction",
        {"liftControl3": {"action": 1, "executeMode": 1, "height": 1.5}},
        "not within 0 to 1 m",
    ),
    ("woosh.ros.CallAction", {"chargeControl": {"action": 1, "executeMode": 1}}, "charger"),
    ("woosh.robot.setting.Identity", {"name": "n" * 101}, "longer than 100 characters"),
    ("woosh.robot.LED", {"submodule": 16}, "unknown submodule 16 of the lights"),
]


def test_invalid_requests_are_refused_with_a_reason(client: JsonClient) -> None:
    code = "woosh.robot.count.StatusCode"
    client.subscribe(code)
    before = client.ask("woosh.robot.RobotInfo")
    for name, body, reason in INVALID:
        answer = client.request(name, body)
        assert answer["ok"] is False, reason
        assert reason in answer["msg"]
        assert answer["type"] == name
        assert client.ask("woosh.robot.RobotInfo") == before, reason
    assert client.take_pushes(code) == []  # the reason is in the answer


MODES: list[tuple[str, int, int, str]] = [
    ("SwitchControlMode", 2, 1, "manual mode: switch to automatic first"),
    ("SwitchControlMode", 3, 1, "maintenance mode: switch to automatic first"),
    ("SwitchWorkMode", 1, 2, "deployment mode: switch to task mode first"),
    ("SwitchWorkMode", 3, 2, "schedule mode: a dispatch system drives it; switch to task mode"),
]
"""Switches, modes in which jobs are refused, the usual modes, and the reasons."""


def test_jobs_are_refused_outside_automatic_task_mode(client: JsonClient) -> None:
    requests: list[tuple[str, Any]] = [
        ("woosh.robot.ExecTask", {"type": 1, "markNo": "A2"}),
        ("woosh.robot.ExecPreTask", {"taskSetId": 666}),
        ("woosh.task.RepeatTask", {"order": 3, "taskSet": {"base": {"id": 666}}}),
        ("woosh.robot.Follow", {"type": True}),
        ("woosh.ros.CallAction", {"moveBase": {"action": 1, "targetPose": {"x": 1}}}),
        ("woosh.ros.CallAction", {"liftControl": {"action": 1, "executeMode": 1}}),
    ]
    for switch, mode, usual, reason in MODES:
        client.ask(f"woosh.robot.{switch}", {"mode": mode})
        assert client.ask("woosh.robot.OperationState")["robot"] == 0
        for name, body in requests:
            assert client.refusal(name, body).startswith(f"robot is in {reason}")
        state = FAULT if "maintenance" in reason else IDLE
        assert client.ask("woosh.robot.RobotState")["state"] == state
        client.ask(f"woosh.robot.{switch}", {"mode": usual})
        client.ask("woosh.robot.InitRobot", {"isRecord": True})  # needed after maintenance
        assert client.ask("woosh.robot.OperationState")["robot"] == 1
    for name, body in requests[:2]:
        client.ask(name, body)


def test_request_without_serial_number_is_answered_without_one(client: JsonClient) -> None:
    client.send({"type": "woosh.robot.Mode"})
    answer = client.receive()
    assert answer["ok"] is True
    assert "sn" not in answer


def test_snake_case_enum_names_and_unknown_fields_are_accepted(client: JsonClient) -> None:
    body = {"task_id": 77, "type": "kPick", "mark_no": "A2", "customs": [1], "planPath": None}
    client.ask("woosh.robot.ExecTask", body)
    proc = client.ask("woosh.robot.TaskProc")
    assert (proc["robotTaskId"], proc["type"], proc["dest"]) == ("77", 1, "A2")
