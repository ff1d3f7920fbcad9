"""Many clients, bad frames, hostile clients, and the simulator's hooks for tests."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
from collections.abc import Iterable
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed

from tests.simulator.sim_wire import (
    TIMEOUT,
    Connect,
    ConnectTcp,
    JsonClient,
    TcpClient,
    body_of,
    packed,
    pass_time,
    subscription,
)
from woosh_robot_agent.pb.robot import robot_count_pb2, robot_pb2
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Speak
from woosh_robot_agent.pb.util.commu_pack_pb2 import MessagePackJson
from woosh_robot_agent.simulator import Outgoing, SimulatorThread
from woosh_robot_agent.testing import wait_until

MODE = "woosh.robot.Mode"
MIB = 1024 * 1024
MANY_TOPICS = (
    '{"type":"woosh.Subscription","body":{"topics":['
    + ",".join(['"x"'] * 100_000)
    + '],"sub":true}}'
)
GARBAGE: list[str | bytes] = [
    "",
    "garbage",
    "[1, 2]",
    "{}",
    '{"type": 5}',
    '{"type": "woosh.robot.Mode", "sn": "x"}',
    '{"type": "woosh.Subscription", "body": {"topics": 5}}',
    "[" * 100_000,
    b"",
    b"\xff\xff\xff\xff",
    b"\x00" * 1000,
]


def test_bad_frames_are_skipped(client: JsonClient) -> None:
    for frame in GARBAGE:
        client.send(frame)
    assert client.ask("woosh.robot.Mode")["ctrl"] == 1
    assert client.simulator.bad_frames == len(GARBAGE)
    assert client.simulator.connections == 1


def test_bad_frames_over_tcp_are_skipped(tcp: TcpClient) -> None:
    for frame in (b"\xff\xff", b"", b"{}"):
        tcp.send(frame)
    assert tcp.request("woosh.robot.Mode").ok
    pack = MessagePackJson(type="woosh.robot.Twist", sn=3)
    pack.body.value = b"\xff\xff\xff"
    tcp.send(pack.SerializeToString())
    answer = tcp.receive()
    assert (answer.ok, answer.sn) == (False, 3)
    assert "unreadable body" in answer.msg
    with socket.create_connection(("127.0.0.1", tcp.simulator.tcp_port)) as other:
        other.sendall(b"\xff" * 20)  # a varint that never ends
        other.settimeout(5)
        assert other.recv(1) == b""
    assert tcp.request("woosh.robot.Mode").ok


def parse(data: Any) -> MessagePackJson:
    assert isinstance(data, bytes)
    return MessagePackJson.FromString(data)


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


def test_hostile_frames_close_no_connection(client: JsonClient, tcp: TcpClient) -> None:
    client.send(MANY_TOPICS)
    client.ask(MODE)
    answer = client.request("x" * 1_000_000)  # its refusal is short
    assert answer["ok"] is False
    assert len(answer["msg"]) < 1000
    assert len(answer["type"]) < 1000
    tcp.send(b"\xfb\x06" * 100_000 + b"\xfc\x06" * 100_000)  # deeply nested groups
    tcp.send(packed(MODE)[:-1])
    assert tcp.request(MODE).ok
    assert client.simulator.connections == 2


def test_client_with_too_many_unread_bytes_is_dropped(tcp: TcpClient) -> None:
    """The limit counts bytes as well as frames, because a few frames can be large."""
    assert tcp.request(MODE).ok
    frame = b"x" * (20 * MIB)
    for _ in range(6):
        tcp.simulator.send_raw(frame)
    wait_until(lambda: not tcp.simulator.connections, "the end of the connection")


def test_record_of_received_messages_is_limited_in_bytes(tcp: TcpClient) -> None:
    speech = Speak(text="x" * (8 * MIB))
    for number in range(1, 11):
        assert tcp.request("woosh.robot.Speak", speech, number).sn == number
    assert tcp.simulator.counts["woosh.robot.Speak"] == 10
    assert len(tcp.simulator.received) == 7


async def _handshake_status(port: int, origin: str) -> str:
    """Return the status line of the answer to a WebSocket handshake with this origin."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    header = f"Origin: {origin}\r\n" if origin else ""
    writer.write(
        (
            f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\n{header}"
            "Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
        ).encode()
    )
    line = await asyncio.wait_for(reader.readline(), TIMEOUT)
    writer.close()
    return line.decode()


ORIGINS = {
    "": 101,
    "http://localhost:3000": 101,
    "http://127.0.0.1:5480": 101,
    "http://[::1]": 101,
    "https://somewhere.example": 403,
    "http://localhost.somewhere.example": 403,
    "http://127.0.0.1.somewhere.example": 403,
    "null": 403,
}


def test_handshakes_from_foreign_web_pages_are_refused(simulator: SimulatorThread) -> None:
    """A web page in a browser on this machine can reach the loopback address."""
    for origin, status in ORIGINS.items():
        assert f" {status} " in asyncio.run(_handshake_status(simulator.port, origin)), origin


@pytest.mark.chassis(speed=1, host="0.0.0.0")
def test_all_origins_are_accepted_on_a_public_address(simulator: SimulatorThread) -> None:
    status = asyncio.run(_handshake_status(simulator.port, "https://somewhere.example"))
    assert " 101 " in status


@pytest.mark.chassis(speed=1)
def test_connections_without_a_whole_request_are_closed(
    simulator: SimulatorThread, connect: Connect, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("woosh_robot_agent.link.server._OPEN_TIMEOUT", 0.5)
    address = ("127.0.0.1", simulator.port)
    with (
        socket.create_connection(address, TIMEOUT) as silent,
        socket.create_connection(address, TIMEOUT) as slow,
    ):
        slow.sendall(b"GET / HTTP/1.1\r\nHost: he")
        for each in (silent, slow):
            with contextlib.suppress(ConnectionResetError):
                assert each.recv(1) == b""
    connect().ask(MODE)


@pytest.mark.chassis(speed=1, max_outbox=5)
def test_slow_client_is_dropped_and_delays_no_other(
    simulator: SimulatorThread, connect_tcp: ConnectTcp
) -> None:
    slow, quick = connect_tcp(), connect_tcp()
    assert quick.request("woosh.robot.Mode").ok
    slow.send(subscription("woosh.robot.count.StatusCode"))
    simulator.wait_received("woosh.Subscription")
    while simulator.connections > 1:  # `slow` never reads
        simulator.push(robot_count_pb2.StatusCode(msg="x" * 1_000_000))
        assert quick.request("woosh.robot.Mode").ok


def test_client_of_a_frame_that_cannot_be_sent_is_dropped(
    client: JsonClient, caplog: pytest.LogCaptureFixture
) -> None:
    client.simulator.send_raw("half a surrogate pair: \ud83d")
    with pytest.raises(ConnectionClosed):
        client.receive()
    assert "cannot send a frame to" in caplog.text


def test_an_interceptor_may_use_the_simulator(client: JsonClient) -> None:
    """It runs in the simulator's thread, which must not wait for itself."""
    simulator, seen = client.simulator, []

    def use(outgoing: Any) -> list[Any]:
        with pytest.raises(RuntimeError, match="its own thread"):
            simulator.wait_received("woosh.robot.PoseSpeed")
        seen.append(simulator.state)
        return [outgoing]

    remove = simulator.intercept(use)
    client.ask("woosh.robot.PoseSpeed")
    remove()
    assert seen


def test_failing_interceptor_closes_no_connection(client: JsonClient) -> None:
    def fail(frame: Outgoing) -> Iterable[Outgoing]:
        raise RuntimeError("on purpose")

    client.subscribe("woosh.robot.PoseSpeed")
    remove = client.simulator.intercept(fail)
    client.send({"type": "woosh.robot.Twist", "body": {"linear": 0.5}, "sn": 800})
    client.simulator.wait_received("woosh.robot.Twist")
    pass_time(client.simulator, 0.2)
    remove()
    client.send({"type": "woosh.robot.Twist", "body": {"linear": 0.5}, "sn": 801})
    client.next_push("woosh.robot.PoseSpeed")
    client.ask("woosh.robot.Mode")
