"""Binary frames, on the WebSocket and on TCP, beside JSON."""

from __future__ import annotations

import json
from typing import Any

import pytest

from tests.simulator.sim_wire import JsonClient, TcpClient, body_of, packed, subscription
from woosh_robot_agent.pb.robot import robot_pack_pb2, robot_pb2
from woosh_robot_agent.pb.util.commu_pack_pb2 import MessagePackJson
from woosh_robot_agent.protos import message_type
from woosh_robot_agent.simulator import SimulatorThread


def parsed(data: Any) -> MessagePackJson:
    assert isinstance(data, bytes)
    pack = MessagePackJson()
    pack.ParseFromString(data)
    return pack


def binary(client: JsonClient, frame: bytes) -> MessagePackJson:
    """The answer to a binary frame, the next binary one."""
    client.send(frame)
    return parsed(client._await(client.socket.recv()))


def test_binary_over_websocket(client: JsonClient) -> None:
    pack = binary(client, packed("woosh.robot.RobotInfo", robot_pb2.RobotInfo(), sn=5))
    assert (pack.type, pack.ok, pack.sn) == ("woosh.robot.RobotInfo", True, 5)
    info = body_of(pack)
    assert info.robot_id == 30001
    assert info.genral.display_model == "Robase200"
    # The same connection speaks JSON too.
    assert client.ask("woosh.robot.PoseSpeed")["pose"]["x"] == pytest.approx(info.pose_speed.pose.x)


def test_everything_is_answered_over_tcp(tcp: TcpClient, endpoints: Any) -> None:
    services = endpoints["info_services"] | endpoints["command_services"]
    for sn, service in enumerate(services.values(), start=1):
        name = service["request"]
        pack = tcp.request(name, message_type(name)(), sn)
        assert pack.type in (name, service.get("answer"))
        assert pack.ok or pack.msg


def test_a_request_without_a_body_has_an_empty_one(tcp: TcpClient) -> None:
    assert tcp.request("woosh.robot.Mode").ok


def test_commands_and_pushes_over_tcp(tcp: TcpClient) -> None:
    tcp.send(subscription("woosh.robot.TaskProc"))
    request = robot_pack_pb2.ExecTask(type=1, mark_no="A2")  # type: ignore[arg-type]
    assert tcp.request("woosh.robot.ExecTask", request).ok
    while True:
        pack = tcp.receive()
        assert (pack.type, pack.sn) == ("woosh.robot.TaskProc", 0)
        if body_of(pack).state == 7:
            break
    refused = tcp.request("woosh.robot.ExecTask", robot_pack_pb2.ExecTask(mark_no="Z"))
    assert not refused.ok
    assert refused.msg.startswith("unknown mark Z in map wooshmap")
    assert refused.body.value == b""


def test_pushes_come_in_the_encoding_of_the_subscription(
    simulator: SimulatorThread, client: JsonClient, tcp: TcpClient
) -> None:
    client.send(subscription("woosh.robot.Mode"))
    client.subscribe("woosh.robot.Battery")
    tcp.send(subscription("woosh.robot.Mode"))
    assert tcp.request("woosh.robot.Mode").ok
    simulator.push(robot_pb2.Battery(power=50))
    assert json.loads(client._await(client.socket.recv()))["body"]["power"] == 50
    client.send({"type": "woosh.robot.SwitchWorkMode", "body": {"mode": 3}, "sn": 77})
    frames = [client._await(client.socket.recv()) for _ in range(2)]
    (answer,) = (json.loads(frame) for frame in frames if isinstance(frame, str))
    (push,) = (parsed(frame) for frame in frames if isinstance(frame, bytes))
    assert (answer["type"], answer["sn"]) == ("woosh.robot.Mode", 77)
    assert body_of(push).work == body_of(tcp.receive()).work == 3


def test_unreadable_body_is_refused(tcp: TcpClient) -> None:
    pack = MessagePackJson(type="woosh.robot.Twist", sn=3)
    pack.body.value = b"\xff\xff\xff"
    tcp.send(pack.SerializeToString())
    answer = tcp.receive()
    assert (answer.ok, answer.sn) == (False, 3)
    assert "unreadable body" in answer.msg
