"""Connecting, losing the link and reconnecting."""

from __future__ import annotations

import asyncio
import logging
import re
from itertools import pairwise
from typing import Any

import pytest

from tests.link.link_peer import (
    INFO,
    TIMEOUT,
    Frame,
    Peer,
    RawServer,
    Wire,
    config,
    drops,
    error_of,
    eventually,
    ours,
    silent,
    states,
    turns,
)
from woosh_robot_agent.link import (
    ChassisClient,
    ConnectionLostError,
    HandshakeError,
    LinkState,
    NotConnectedError,
    RequestTimeoutError,
)
from woosh_robot_agent.link.reconnect import Backoff
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Speak

WHOLE_HTTP = b"HTTP/1.1 404 Not Found\r\nContent-Length: 2\r\nConnection: close\r\n\r\nno"


async def test_the_states_of_a_link_that_is_made_lost_made_again_and_closed() -> None:
    async with Peer(auto=False) as peer:
        client = peer.client()
        seen = states(client)
        client.start()
        wire = await peer.wire()
        frame = await wire.next(INFO)
        assert client.state is LinkState.CONNECTING
        with pytest.raises(NotConnectedError):  # it is ready with the first RobotInfo, not before
            await client.request(Speak())
        await wire.answer(frame)
        await client.wait_ready(TIMEOUT)
        peer.auto = True
        wire.abort()
        await peer.wire(2)
        await client.wait_ready(TIMEOUT)
        assert client.stats.connects == 2
        assert client.last_error is None
        await client.close()
        assert seen == [
            *(LinkState.CONNECTING, LinkState.READY),
            *(LinkState.WAITING, LinkState.CONNECTING, LinkState.READY),
            *(LinkState.WAITING, LinkState.STOPPED),
        ]


@pytest.mark.parametrize("kind", ["json", "tcp"])
async def test_an_attempt_ends_after_the_handshake_timeout(kind: str) -> None:
    async with Peer(kind, auto=False) as peer:
        error = await error_of(peer.client(handshake_timeout=0.05))
        assert isinstance(error, RequestTimeoutError)
        assert "woosh.robot.RobotInfo within 0.05 s" in str(error)


async def test_an_unreadable_robot_info_costs_only_the_first_values() -> None:
    async with Peer(info={"state": []}) as peer, peer.client() as client:
        assert client.state is LinkState.READY
        assert client.stats.bad_frames == {"body": 1}


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"ok": False, "msg": "still booting"}, "still booting"),
        ({"ok": False, "msg": ""}, "RobotInfo: refused"),
        ({"type": "woosh.robot.Mode"}, "another type"),
        ({"type": "woosh.New"}, "unknown type"),
    ],
)
async def test_a_chassis_without_a_robot_info_is_refused(changes: Any, reason: str) -> None:
    async def script(wire: Wire, frame: Frame) -> bool:
        await wire.answer(frame, **changes)
        return True

    async with Peer(script=script) as peer:
        error = await error_of(peer.client())
        assert isinstance(error, HandshakeError)
        assert reason in str(error)


@pytest.mark.parametrize("transport", ["websocket", "tcp"])
async def test_a_refused_connection_is_reported(transport: str) -> None:
    async with RawServer(drops) as server:
        port = server.port
    error = await error_of(ChassisClient(config=config(port, transport=transport)))
    assert isinstance(error, NotConnectedError)
    assert str(error) == "Connection refused"


@pytest.mark.parametrize(
    ("said", "told"),
    [
        (WHOLE_HTTP, "not a WebSocket server.*404"),
        (b"\x00\xff garbage \r\n\r\n", "."),
        (b"", "."),
        (b"HTTP/1.1 200 OK\r\n\r\n", "."),
    ],
)
async def test_a_server_that_does_not_speak_websocket_is_reported(said: bytes, told: str) -> None:
    async def handle(reader: Any, writer: Any) -> None:
        if said:
            await reader.readuntil(b"\r\n\r\n")
        writer.write(said)
        await writer.drain()

    async with RawServer(handle) as server:
        error = await error_of(ChassisClient(config=config(server.port)))
        assert isinstance(error, HandshakeError | NotConnectedError)
        assert re.match(told, str(error))


async def test_an_attempt_at_a_silent_server_ends_after_the_connect_timeout() -> None:
    async with RawServer(silent) as server:
        client = ChassisClient(config=config(server.port, connect_timeout=0.05, close_timeout=10))
        error = await error_of(client)
        assert isinstance(error, NotConnectedError)
        assert "within 0.05 s" in str(error)
        await eventually(lambda: all(writer.transport.is_closing() for writer in server.open))


@pytest.mark.parametrize(
    ("said", "kind", "told"),
    [
        (WHOLE_HTTP, ConnectionLostError, ""),
        (b"\xff" * 40, Exception, "not delimited protobuf"),  # a length that is no varint
    ],
)
async def test_a_server_that_does_not_speak_protobuf_on_the_tcp_port_is_reported(
    said: bytes, kind: type[Exception], told: str
) -> None:
    async def handle(reader: Any, writer: Any) -> None:
        writer.write(said)
        if told:
            await reader.read()

    async with RawServer(handle) as server:
        error = await error_of(ChassisClient(config=config(server.port, transport="tcp")))
        assert isinstance(error, kind)
        assert told in str(error)


async def test_a_host_name_is_resolved() -> None:
    async with Peer() as peer, peer.client(ip="localhost") as client:
        assert client.state is LinkState.READY
    error = await error_of(ChassisClient(config=config(1, ip="no-such-host.invalid")))
    assert isinstance(error, NotConnectedError)


async def test_async_with_fails_in_time_and_leaves_nothing() -> None:
    async with RawServer(drops) as server:
        port = server.port
    client = ChassisClient(config=config(port, connect_timeout=0.5, handshake_timeout=0.5))
    with pytest.raises(NotConnectedError, match=rf"127\.0\.0\.1:{port}.*Connection refused"):
        await client.__aenter__()
    assert client.state is LinkState.STOPPED
    assert not ours()


async def test_the_loss_is_known_before_the_close_has_ended() -> None:
    async with Peer() as peer, peer.client(close_timeout=10, liveness_timeout=0.5) as client:
        (await peer.wire()).freeze()
        await eventually(lambda: client.state is not LinkState.READY)
        assert client.state is LinkState.WAITING
        assert isinstance(client.last_error, ConnectionLostError)
        with pytest.raises(NotConnectedError, match="nothing was heard"):
            await client.request(Speak())
        with pytest.raises(NotConnectedError):
            await client.wait_ready(0.01)


def test_pauses_double_up_to_the_longest_with_jitter() -> None:
    backoff = Backoff(0.5, 15.0)
    pauses = [backoff.next() for _ in range(8)]
    for pause, full in zip(pauses, [0.5, 1, 2, 4, 8, 15, 15, 15], strict=True):
        assert 0.8 * full <= pause <= full
    assert len({pause / 15 for pause in pauses[5:]}) == 3
    backoff.reset()
    assert backoff.next() <= 0.5


@pytest.mark.parametrize(("stable_after", "grows"), [(500.0, True), (0.0, False)])
async def test_pauses_are_reset_only_after_a_stable_link(stable_after: float, grows: bool) -> None:
    times: list[float] = []

    async def script(wire: Wire, frame: Frame) -> bool:  # ready, then dropped
        times.append(asyncio.get_running_loop().time())
        await wire.answer(frame)
        await turns()
        wire.abort()
        return True

    async with Peer(script=script) as peer:
        client = peer.client(backoff_min=0.05, backoff_max=5, stable_after=stable_after)
        client.start()
        await eventually(lambda: len(times) == (6 if grows else 12))
        await client.close()
    pauses = [after - before for before, after in pairwise(times)]
    # never shorter, but longer on a busy machine
    if grows:
        assert all(pause >= 0.8 * 0.05 * 2**n for n, pause in enumerate(pauses))
    else:
        assert min(pauses[5:]) < 0.8 * 0.05 * 2**5


async def test_failures_and_the_recovery_are_logged_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.DEBUG, "woosh_robot_agent.link")
    async with RawServer(drops) as server:
        port = server.port
    client = ChassisClient(config=config(port))
    client.start()
    await eventually(lambda: len([r for r in caplog.records if "cannot connect" in r.message]) >= 4)
    async with Peer(port=port):
        await client.wait_ready(TIMEOUT)
    await client.close()
    levels = [r.levelno for r in caplog.records if "cannot connect" in r.message]
    assert levels[0] == logging.WARNING
    assert set(levels[1:]) == {logging.DEBUG}
    ready = [
        r.levelno for r in caplog.records if r.message == f"connected to {client.config.address}"
    ]
    assert ready == [logging.INFO]


async def test_robot_info_is_requested_again_if_no_answer_comes() -> None:
    """The first answer to any of the requests counts."""
    unanswered: list[Frame] = []

    async def script(wire: Wire, frame: Frame) -> bool:
        if frame["type"] != INFO:
            return False
        unanswered.append(frame)
        if len(unanswered) == 2:
            await wire.answer(unanswered[0])  # the late answer of a slow chassis
        return True

    async with Peer(script=script) as peer, peer.client(handshake_timeout=30.0) as client:
        assert len(unanswered) == 2
        assert client.stats.connects == 1
