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


class JsonPeer(Peer):
    """JSON over a WebSocket."""

    def __init__(self, simulator: SimulatorThread) -> None:
        self.simulator = simulator
        self._client = JsonClient(simulator.port)

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


@pytest.fixture(params=[JsonPeer, Peer])
def peer(simulator: SimulatorThread, request: pytest.FixtureRequest) -> Iterator[Peer]:
    with closing(request.param(simulator)) as peer:
        yield peer


def exchange(peer: Peer, sn: int, type_name: str = MODE) -> tuple[str, int, Any]:
    peer.ask(sn, type_name)
    return peer.parse(peer.receive_raw())


def test_damaged_answers_and_pushes_are_unreadable(peer: Peer) -> None:
    peer.subscribe(BATTERY)
    assert exchange(peer, 3)[:2] == (MODE, 3)
    for name in ("garbage", "truncated", "invalid_utf8"):
        if name == "invalid_utf8" and LEGACY and isinstance(peer, JsonPeer):
            continue  # this client closes the connection, see the next test
        fault = peer.simulator.inject(name, frames="all", type=BATTERY, count=2)
        peer.ask(4, BATTERY)
        peer.simulator.push(robot_pb2.Battery(power=7))
        for _ in range(2):
            with pytest.raises(ValueError):
                peer.parse(peer.receive_raw())
        assert not fault.active
        assert exchange(peer, 5, BATTERY)[:2] == (BATTERY, 5)
    assert peer.simulator.connections == 1
    peer.simulator.inject("garbage", length=10, count=1)
    peer.ask(6)
    assert len(peer.receive_raw()) == 10


def test_invalid_utf8_closes_a_websocket(client: JsonClient) -> None:
    """A client must close the connection with code 1007, unless it reads text as bytes."""
    client.simulator.inject("invalid_utf8", count=1)
    client.send({"type": MODE, "sn": 1})
    with pytest.raises(ConnectionClosed) as error:
        client.receive()
    assert error.value.sent is not None
    assert error.value.sent.code == 1007


def test_frame_truncated_on_the_wire_ends_the_connection(peer: Peer) -> None:
    peer.simulator.inject("truncated", where="wire", count=1)
    peer.ask(1)
    with pytest.raises((ConnectionClosed, ConnectionError)):
        peer.receive_raw()
    with closing(type(peer)(peer.simulator)) as again:
        assert exchange(again, 2)[:2] == (MODE, 2)


def test_oversize_frame_is_valid(peer: Peer) -> None:
    usual = exchange(peer, 1)[2]
    peer.simulator.inject("oversize", mib=2, count=1)
    peer.ask(2)
    data = peer.receive_raw()
    assert 2 * MIB <= len(data) < 2 * MIB + 100
    assert isinstance(usual, dict) is isinstance(peer, JsonPeer)
    type_name, sn, body = peer.parse(data)
    assert (type_name, sn) == (MODE, 2)
    assert len(str(body)) == len(str(usual))


def test_unknown_fields_keep_the_other_fields(peer: Peer) -> None:
    usual = exchange(peer, 1, BATTERY)[2]
    peer.simulator.inject("unknown_fields", frames="all")
    type_name, sn, body = exchange(peer, 2, BATTERY)
    assert (type_name, sn) == (BATTERY, 2)
    assert body != usual
    if isinstance(body, dict):
        assert {key: body[key] for key in usual} == usual
        assert len(body) == len(usual) + 1
    else:
        body.DiscardUnknownFields()
        assert body == usual
    peer.subscribe(BATTERY)
    exchange(peer, 3)
    push = robot_pb2.Battery(power=7)
    peer.simulator.push(push)
    type_name, sn, body = peer.parse(peer.receive_raw())
    assert (type_name, sn, body == push) == (BATTERY, 0, False)


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


def test_wrong_field_type_replaces_an_empty_body_whatever_comes_after(client: JsonClient) -> None:
    for fault in ("wrong_field_type", "wrong_field_type", "unknown_fields"):
        client.simulator.inject(fault, frames="all")
    client.send({"type": "woosh.robot.SetOccupancy", "sn": 1})
    assert client.receive()["body"] == "neither"
