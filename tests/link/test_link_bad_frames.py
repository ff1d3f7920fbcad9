"""Bad frames are counted, logged once, and skipped."""

from __future__ import annotations

import asyncio
import logging
from typing import Any

import pytest
import websockets

from tests.link.link_peer import TIMEOUT, Packed, Peer, aio, eventually, soon
from woosh_robot_agent.link import ConnectionLostError
from woosh_robot_agent.link.reports import LogOnce
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Speak

OLD = int(websockets.__version__.split(".")[0]) < 14


async def works(client: Any, wire: Any) -> bool:
    task = asyncio.ensure_future(client.request(Speak()))
    await wire.answer(await wire.next("woosh.robot.Speak"))
    return bool((await soon(task)).ok)


@pytest.mark.parametrize(
    ("kind", "frame", "counted"),
    [
        ("json", "{", "json"),
        ("json", "[]", "envelope"),
        ("json", '{"body":{}}', "envelope"),
        ("json", "", "json"),
        ("json", b"\x0a\x01x", "json"),
        ("json", b"\xff", "utf-8"),
        ("json", "[" * 100_000, "json"),
        ("protobuf", "{}", "encoding"),
        ("protobuf", b"\xff\xff", "protobuf"),
        ("protobuf", b"", "envelope"),
        ("tcp", b"\x02\xff\xff", "protobuf"),
        ("tcp", b"\x00", "envelope"),
    ],
)
@aio
async def test_a_bad_frame_is_counted_logged_once_and_skipped(
    kind: str, frame: Any, counted: str
) -> None:
    records: list[logging.LogRecord] = []
    handler = logging.Handler()
    handler.emit = records.append  # type: ignore[method-assign]
    logger = logging.getLogger("woosh_robot_agent.link")
    logger.addHandler(handler)
    logger.setLevel(logging.DEBUG)
    try:
        async with Peer(kind) as peer, peer.client() as client:
            wire = await peer.wire()
            for _ in range(3):
                await wire.raw(frame)
            assert await works(client, wire)
            # a large frame is decoded aside
            await eventually(lambda: client.stats.bad_frames == {counted: 3})
            assert client.stats.rx == 2
            assert client.stats.connects == 1
            logged = [r for r in records if f"bad frame ({counted})" in r.getMessage()]
            assert [r.levelno for r in logged] == [logging.WARNING, logging.DEBUG, logging.DEBUG]
            wire.abort()
            again = await peer.wire(2)
            await client.wait_ready(TIMEOUT)
            await again.raw(frame)  # logged again on a new link
            await eventually(lambda: client.stats.bad_frames == {counted: 4})
            logged = [r for r in records if f"bad frame ({counted})" in r.getMessage()]
            assert logged[-1].levelno == logging.WARNING
            ready = [r for r in records if r.getMessage().startswith("connected to")]
            assert [r.levelno for r in ready] == [logging.INFO] * 2
    finally:
        logger.removeHandler(handler)
        logger.setLevel(logging.NOTSET)


@aio
async def test_text_that_is_not_utf8_is_a_bad_frame() -> None:
    async with Peer() as peer, peer.client() as client:
        wire = await peer.wire()
        wire.transport.write(b"\x81\x02\xff\xff")
        if OLD:  # this version of the library closes the connection
            await peer.wire(2)
            await client.wait_ready(TIMEOUT)
            assert client.stats.connects == 2
        else:
            assert await works(client, wire)
            assert client.stats.bad_frames == {"utf-8": 1}
            assert client.stats.connects == 1


@aio
async def test_a_frame_over_the_limit_on_tcp_is_skipped() -> None:
    async with Peer("tcp") as peer, peer.client(max_frame_size=100_000) as client:
        wire = await peer.wire()
        for size in (100_001, 5_000_000):
            await wire.raw(Packed.varint(size) + b"\x0a" * size)
        assert await works(client, wire)
        assert client.stats.bad_frames == {"oversize": 2}
        assert client.stats.connects == 1


@aio
async def test_a_huge_length_on_tcp_takes_no_memory() -> None:
    async with Peer("tcp") as peer, peer.client(liveness_timeout=0.3) as client:
        wire = await peer.wire()
        await wire.raw(Packed.varint(2**60) + b"x" * 1000)
        await eventually(lambda: client.last_error)


@aio
async def test_the_error_names_the_limit_that_a_websocket_frame_exceeded() -> None:
    async with Peer() as peer, peer.client(max_frame_size=1000) as client:
        wire = await peer.wire()
        task = asyncio.ensure_future(client.request(Speak()))
        await wire.answer(await wire.next(), msg="x" * 2000)
        with pytest.raises(ConnectionLostError, match=r"1009.*raise max_frame_size"):
            await soon(task)
        await client.wait_ready(TIMEOUT)


@aio
async def test_the_error_says_when_the_chassis_refused_a_large_frame() -> None:
    async with Peer() as peer, peer.client() as client:
        wire: Any = await peer.wire()
        task = asyncio.ensure_future(client.request(Speak()))
        await wire.next()
        await wire.socket.close(1009, "too big")
        with pytest.raises(ConnectionLostError, match=r"1009 too big .*a frame from this side"):
            await soon(task)


@aio
async def test_an_internal_error_ends_the_connection_but_not_the_client(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async with Peer() as peer, peer.client() as client:
        wire = await peer.wire()

        def broken(_: object) -> None:
            raise ZeroDivisionError

        client._connection._on_push = broken  # type: ignore[union-attr]
        task = asyncio.ensure_future(client.request(Speak()))
        await wire.next()
        await wire.push("woosh.robot.PoseSpeed")
        with pytest.raises(ConnectionLostError, match="internal error"):
            await soon(task)
        again = await peer.wire(2)
        await client.wait_ready(TIMEOUT)
        assert await works(client, again)


def test_a_cleared_kind_is_logged_again(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.DEBUG)
    log = LogOnce(logging.getLogger("test.once"))
    for kind in ("a", "a", "b"):
        log.warn(kind, kind)
    log.clear("a")
    log.warn("a", "100 %s")
    log.warn("b", "b")
    log.clear()
    log.warn("b", "b")
    warned = [r.message for r in caplog.records if r.levelno == logging.WARNING]
    assert warned == ["a", "b", "100 %s", "b"]
