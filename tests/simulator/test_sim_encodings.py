"""Protobuf frames over WebSocket and TCP, beside JSON."""

from __future__ import annotations

import json
from typing import Any

import pytest

from tests.simulator.sim_wire import JsonClient, TcpClient, body_of, packed, subscription
from woosh_robot_agent.pb.robot import robot_pack_pb2, robot_pb2
from woosh_robot_agent.pb.util.commu_pack_pb2 import MessagePackJson


def parse(data: Any) -> MessagePackJson:
    assert isinstance(data, bytes)
    return MessagePackJson.FromString(data)


def test_websocket_serves_protobuf_and_json(client: JsonClient) -> None:
    client.send(packed("woosh.robot.RobotInfo", robot_pb2.RobotInfo(), sn=5))
    pack = parse(client.complete(client.socket.recv()))
    assert (pack.type, pack.ok, pack.sn) == ("woosh.robot.RobotInfo", True, 5)
    info = body_of(pack)
    assert info.robot_id == 30001
    assert info.genral.display_model == "Robase200"
    # The same connection speaks JSON too.
    assert client.ask("woosh.robot.PoseSpeed")["pose"]["x"] == pytest.approx(info.pose_speed.pose.x)


def test_tcp_client_gets_pushes_and_refusals(tcp: TcpClient) -> None:
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


def test_pushes_use_the_encoding_of_the_subscription(client: JsonClient, tcp: TcpClient) -> None:
    client.send(subscription("woosh.robot.Mode"))
    client.subscribe("woosh.robot.Battery")
    tcp.send(subscription("woosh.robot.Mode"))
    assert tcp.request("woosh.robot.Mode").ok
    client.simulator.push(robot_pb2.Battery(power=50))
    assert json.loads(client.complete(client.socket.recv()))["body"]["power"] == 50
    client.send({"type": "woosh.robot.SwitchWorkMode", "body": {"mode": 3}, "sn": 77})
    frames = [client.complete(client.socket.recv()) for _ in range(2)]
    (answer,) = (json.loads(frame) for frame in frames if isinstance(frame, str))
    (push,) = (parse(frame) for frame in frames if isinstance(frame, bytes))
    assert (answer["type"], answer["sn"]) == ("woosh.robot.Mode", 77)
    assert body_of(push).work == body_of(tcp.receive()).work == 3


def test_unreadable_body_is_refused(tcp: TcpClient) -> None:
    pack = MessagePackJson(type="woosh.robot.Twist", sn=3)
    pack.body.value = b"\xff\xff\xff"
    tcp.send(pack.SerializeToString())
    answer = tcp.receive()
    assert (answer.ok, answer.sn) == (False, 3)
    assert "unreadable body" in answer.msg
