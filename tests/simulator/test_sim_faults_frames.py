"""Faults of single frames, over each transport and encoding."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import pytest
import websockets
from google.protobuf.message import DecodeError
from websockets.exceptions import ConnectionClosed

from tests.simulator.sim_wire import JsonClient, TcpClient, body_of, packed, subscription
from woosh_robot_agent.pb.robot import robot_pb2
from woosh_robot_agent.pb.util.commu_pack_pb2 import MessagePackJson
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.testing import running_chassis

MODE = "woosh.robot.Mode"
BATTERY = "woosh.robot.Battery"
MIB = 1024 * 1024
LEGACY = int(websockets.version.version.split(".")[0]) < 14


class Peer:
    """A client that receives frames undecoded and parses them on demand; here protobuf over TCP."""

    def __init__(self, simulator: SimulatorThread) -> None:
        self.simulator = simulator
        self._client: Any = TcpClient(simulator.tcp_port)

    def ask(self, sn: int, type_name: str = MODE) -> None:
        self._client.send(packed(type_name, sn=sn))

    def subscribe(self, type_name: str) -> None:
        self._client.send(subscription(type_name))

    def receive_raw(self) -> bytes:
        data: bytes = self._client.receive_bytes()
        return data

    def parse(self, data: bytes) -> tuple[str, int, Any]:
        """Return type, serial number and body. Raise ValueError if it is not a valid frame."""
        try:
            pack = MessagePackJson.FromString(data)
        except DecodeError as error:
            raise ValueError from error
        return pack.type, pack.sn, body_of(pack)

    def close(self) -> None:
        self._client.close()


class BinaryPeer(Peer):
    """Protobuf over a WebSocket."""

    def __init__(self, simulator: SimulatorThread) -> None:
        self.simulator = simulator
        self._client = JsonClient(simulator.port)

    def receive_raw(self) -> bytes:
        data = self._client.complete(self._client.socket.recv())
        assert isinstance(data, bytes)
        return data


class JsonPeer(BinaryPeer):
    def ask(self, sn: int, type_name: str = MODE) -> None:
        self._client.send({"type": type_name, "sn": sn})

    def subscribe(self, type_name: str) -> None:
        self._client.send({"type": "woosh.Subscription", "body": {"topics": [type_name], "sub": 1}})

    def receive_raw(self) -> bytes:
        socket = self._client.socket
        data = self._client.complete(socket.recv() if LEGACY else socket.recv(decode=False))
        return data.encode() if isinstance(data, str) else data

    def parse(self, data: bytes) -> tuple[str, int, Any]:
        frame = json.loads(data)
        return frame["type"], frame.get("sn", 0), frame["body"]


@pytest.fixture(params=[JsonPeer, BinaryPeer, Peer])
def peer(simulator: SimulatorThread, request: pytest.FixtureRequest) -> Iterator[Peer]:
    with closing(request.param(simulator)) as peer:
        yield peer


def exchange(peer: Peer, sn: int, type_name: str = MODE) -> tuple[str, int, Any]:
    peer.ask(sn, type_name)
    return peer.parse(peer.receive_raw())


@pytest.mark.parametrize("name", ["garbage", "truncated", "invalid_utf8"])
def test_damaged_frames_are_unreadable(peer: Peer, name: str) -> None:
    if name == "invalid_utf8" and LEGACY and isinstance(peer, JsonPeer):
        return  # this client closes the connection, see the next test
    fault = peer.simulator.inject(name, type=BATTERY, count=2)
    for sn in (1, 2):
        peer.ask(sn, BATTERY)
        with pytest.raises(ValueError):
            peer.parse(peer.receive_raw())
    assert not fault.active
    assert exchange(peer, 3, BATTERY)[:2] == (BATTERY, 3)
    assert peer.simulator.connections == 1
    assert peer.simulator.counts[BATTERY] == 3


def test_invalid_utf8_closes_a_websocket(client: JsonClient) -> None:
    """A client must close the connection with code 1007, unless it reads text as bytes."""
    client.simulator.inject("invalid_utf8", count=1)
    client.send({"type": MODE, "sn": 1})
    with pytest.raises(ConnectionClosed) as error:
        client.receive()
    assert error.value.sent is not None
    assert error.value.sent.code == 1007


@pytest.mark.parametrize("name", ["garbage", "truncated", "unknown_fields", "wrong_field_type"])
def test_faults_damage_pushes(peer: Peer, name: str) -> None:
    peer.simulator.inject(name, frames="pushes", type=BATTERY)
    peer.subscribe(BATTERY)
    assert exchange(peer, 3)[:2] == (MODE, 3)
    push = robot_pb2.Battery(power=7)
    peer.simulator.push(push)
    data = peer.receive_raw()
    if name in ("garbage", "truncated"):
        with pytest.raises(ValueError):
            peer.parse(data)
    else:
        assert peer.parse(data)[:2] == (BATTERY, 0)
        assert peer.parse(data)[2] != push
    assert exchange(peer, 4)[:2] == (MODE, 4)


def test_faults_damage_answers_and_pushes(peer: Peer) -> None:
    peer.subscribe(BATTERY)
    assert exchange(peer, 3)[:2] == (MODE, 3)
    peer.simulator.inject("garbage", frames="all", length=10, count=2)
    peer.simulator.push(robot_pb2.Battery(power=7))
    assert len(peer.receive_raw()) == 10
    peer.ask(4)
    assert len(peer.receive_raw()) == 10
    assert exchange(peer, 5)[:2] == (MODE, 5)


def test_frame_truncated_on_the_wire_ends_the_connection(peer: Peer) -> None:
    peer.simulator.inject("truncated", where="wire", count=1)
    peer.ask(1)
    with pytest.raises((ConnectionClosed, ConnectionError)):
        peer.receive_raw()
    with closing(type(peer)(peer.simulator)) as again:
        assert exchange(again, 2)[:2] == (MODE, 2)


def test_oversize_frame_is_valid(peer: Peer) -> None:
    usual = exchange(peer, 1)[2]
    peer.simulator.inject("oversize", mib=3, count=1)
    peer.ask(1)
    data = peer.receive_raw()
    assert 3 * MIB <= len(data) < 3 * MIB + 100
    assert isinstance(usual, dict) is isinstance(peer, JsonPeer)
    type_name, sn, body = peer.parse(data)
    assert (type_name, sn) == (MODE, 1)
    assert len(str(body)) == len(str(usual))
    assert exchange(peer, 2)[:2] == (MODE, 2)


def test_oversize_exceeds_64_mib_by_default(simulator: SimulatorThread) -> None:
    simulator.inject("oversize")
    with closing(Peer(simulator)) as peer:
        peer.ask(1)
        assert len(peer.receive_raw()) > 64 * MIB


def test_unknown_fields_keep_the_other_fields(peer: Peer) -> None:
    usual = exchange(peer, 1, BATTERY)[2]
    peer.simulator.inject("unknown_fields")
    type_name, sn, body = exchange(peer, 2, BATTERY)
    assert (type_name, sn) == (BATTERY, 2)
    assert body != usual
    if isinstance(body, dict):
        assert {key: body[key] for key in usual} == usual
        assert len(body) == len(usual) + 1
    else:
        body.DiscardUnknownFields()
        assert body == usual


def test_wrong_field_type_changes_one_field(peer: Peer) -> None:
    usual = exchange(peer, 1, BATTERY)[2]
    peer.simulator.inject("wrong_field_type")
    body = exchange(peer, 2, BATTERY)[2]
    if isinstance(body, dict):
        (wrong,) = [key for key in usual if type(body[key]) is not type(usual[key])]
        assert {**body, wrong: usual[wrong]} == usual
    else:
        before = {field.name for field, _ in usual.ListFields()}
        body.ByteSize()
        (wrong,) = before - {field.name for field, _ in body.ListFields()}
        assert len(body.SerializeToString()) > 0
        usual.ClearField(wrong)
        body.DiscardUnknownFields()
        assert body == usual


def test_wrong_field_type_takes_the_body_of_a_wrong_type(tcp: TcpClient) -> None:
    tcp.simulator.inject("wrong_type")
    tcp.simulator.inject("wrong_field_type")
    answer = tcp.request("woosh.robot.RobotInfo")
    assert answer.type == "woosh.robot.Network"
    assert b"\1" * 8 in answer.body.value


def test_wrong_field_type_replaces_an_empty_body(client: JsonClient) -> None:
    client.simulator.inject("wrong_field_type", type="woosh.robot.SetOccupancy")
    client.send({"type": "woosh.robot.SetOccupancy", "sn": 1})
    assert client.receive()["body"] == "neither"


def test_equal_seeds_damage_frames_equally() -> None:
    seen = []
    for _ in range(2):
        with running_chassis(speed=1, seed=8) as simulator:
            simulator.inject("garbage", count=3)
            simulator.inject("wrong_field_type", type=BATTERY)
            peer = JsonPeer(simulator)
            frames = []
            for sn in range(3):
                peer.ask(sn)
                frames.append(peer.receive_raw())
            kinds = []
            for sn in range(5):
                body = exchange(peer, sn, BATTERY)[2]
                kinds.append([type(value) for value in body.values()])
            seen.append((frames, kinds))
            peer.close()
    assert seen[0] == seen[1]
