"""Hostile clients: the simulated chassis keeps serving them and the others."""

from __future__ import annotations

import asyncio
import contextlib
import socket

import pytest

from tests.simulator.sim_wire import TIMEOUT, Connect, ConnectTcp, JsonClient, TcpClient, packed
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Speak
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.testing import wait_until

MODE = "woosh.robot.Mode"
MIB = 1024 * 1024
HOSTILE = {
    "number with 4,000 digits": '{"type":"woosh.robot.Speak","sn":' + "9" * 4000 + "}",
    "duplicate keys": '{"type":"woosh.robot.Speak","type":"woosh.Subscription",'
    '"body":{"topics":1}}',
    "subscription to 100,000 topics": '{"type":"woosh.Subscription","body":{"topics":['
    + ",".join(['"x"'] * 100_000)
    + '],"sub":true}}',
    "deeply nested Any": '{"type":"woosh.dispatch.robot.RobotAnyInfo","sn":999,"body":{"info":'
    + '{"@type":"type.googleapis.com/google.protobuf.Any","value":' * 300
    + "{}"
    + "}" * 300
    + "}}",
}


@pytest.mark.parametrize("what", HOSTILE)
def test_hostile_frame_closes_no_connection(client: JsonClient, tcp: TcpClient, what: str) -> None:
    client.send(HOSTILE[what])
    client.ask(MODE)
    assert tcp.request(MODE).ok
    assert client.simulator.connections == 2


def test_refusal_of_a_very_long_type_is_short(client: JsonClient) -> None:
    answer = client.request("x" * 1_000_000)
    assert answer["ok"] is False
    assert len(answer["msg"]) < 1000
    assert len(answer["type"]) < 1000


def test_deeply_nested_groups_close_no_connection(tcp: TcpClient) -> None:
    tcp.send(b"\xfb\x06" * 100_000 + b"\xfc\x06" * 100_000)
    tcp.send(packed(MODE)[:-1])
    assert tcp.request(MODE).ok
    assert tcp.simulator.connections == 1


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


@pytest.mark.parametrize(
    ("origin", "status"),
    [
        ("", "101"),
        ("http://localhost:3000", "101"),
        ("http://127.0.0.1:5480", "101"),
        ("http://[::1]", "101"),
        ("https://somewhere.example", "403"),
        ("http://localhost.somewhere.example", "403"),
        ("http://127.0.0.1.somewhere.example", "403"),
        ("null", "403"),
    ],
)
def test_handshakes_from_foreign_web_pages_are_refused(
    simulator: SimulatorThread, origin: str, status: str
) -> None:
    """A web page in a browser on this machine can reach the loopback address."""
    assert f" {status} " in asyncio.run(_handshake_status(simulator.port, origin))


@pytest.mark.chassis(speed=1, host="0.0.0.0")
def test_all_origins_are_accepted_on_a_public_address(simulator: SimulatorThread) -> None:
    status = asyncio.run(_handshake_status(simulator.port, "https://somewhere.example"))
    assert " 101 " in status


@pytest.mark.chassis(speed=1)
@pytest.mark.parametrize("sent", [b"", b"GET / HTTP/1.1\r\nHost: he"])
def test_connection_without_a_whole_request_is_closed(
    simulator: SimulatorThread, connect: Connect, sent: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("woosh_robot_agent.link.server._OPEN_TIMEOUT", 1.0)
    with socket.create_connection(("127.0.0.1", simulator.port), TIMEOUT) as silent:
        silent.sendall(sent)
        with contextlib.suppress(ConnectionResetError):
            assert silent.recv(1) == b""
    connect().ask(MODE)


@pytest.mark.chassis(max_connections=1)
def test_excess_connections_are_logged_once(
    tcp: TcpClient, connect_tcp: ConnectTcp, caplog: pytest.LogCaptureFixture
) -> None:
    assert tcp.request(MODE).ok
    for _ in range(3):
        with pytest.raises(ConnectionError):
            connect_tcp().receive()
    refused = [each.message for each in caplog.records if "refused" in each.message]
    assert len(refused) == 1
    assert refused[0].endswith("until one disconnects")
