"""Bad frames are counted, logged once, and skipped."""

from __future__ import annotations

import logging
from typing import Any

import pytest
import websockets

from tests.link.link_peer import TIMEOUT, answered, ask, eventually, linked, soon, varint
from woosh_robot_agent.link import ConnectionLostError
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Speak

OLD = int(websockets.__version__.split(".")[0]) < 14


@pytest.mark.parametrize(
    ("kind", "frame", "counted"),
    [
        ("json", "{", "json"),
        ("json", b"\x0a\x01x", "json"),
        ("json", "[" * 100_000, "json"),
        ("protobuf", "{}", "encoding"),
        ("protobuf", b"\xff\xff", "protobuf"),
        ("tcp", b"\x02\xff\xff", "protobuf"),
    ],
)
async def test_a_bad_frame_is_counted_logged_once_and_skipped(
    kind: str, frame: Any, counted: str, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.DEBUG, "woosh_robot_agent.link")

    def levels(text: str) -> list[int]:
        return [each.levelno for each in caplog.records if text in each.getMessage()]

    async with linked(kind) as (peer, client, wire):
        for _ in range(3):
            await wire.raw(frame)
        assert (await answered(client.request(Speak()), wire)).ok
        # a large frame is decoded in the thread
        await eventually(lambda: client.stats.bad_frames == {counted: 3})
        assert client.stats.rx == 2
        assert client.stats.connects == 1
        said = f"bad frame ({counted})"
        assert levels(said) == [logging.WARNING, logging.DEBUG, logging.DEBUG]
        wire.abort()
        again = await peer.wire(2)
        await client.wait_ready(TIMEOUT)
        await again.raw(frame)  # logged again on a new link
        await eventually(lambda: client.stats.bad_frames == {counted: 4})
        assert levels(said)[-1] == logging.WARNING
        assert levels("connected to ") == [logging.INFO] * 2


async def test_text_that_is_not_utf8_is_a_bad_frame() -> None:
    async with linked() as (peer, client, wire):
        wire.transport.write(b"\x81\x02\xff\xff")
        if OLD:  # this version of the library closes the connection
            await peer.wire(2)
            await client.wait_ready(TIMEOUT)
            assert client.stats.connects == 2
        else:
            assert (await answered(client.request(Speak()), wire)).ok
            assert client.stats.bad_frames == {"utf-8": 1}
            assert client.stats.connects == 1


async def test_a_frame_over_the_limit_on_tcp_is_skipped() -> None:
    async with linked("tcp", max_frame_size=100_000) as (_peer, client, wire):
        for size in (100_001, 5_000_000):
            await wire.raw(varint(size) + b"\x0a" * size)
        assert (await answered(client.request(Speak()), wire)).ok
        assert client.stats.bad_frames == {"oversize": 2}
        assert client.stats.connects == 1


async def test_the_error_names_the_limit_that_a_websocket_frame_exceeded() -> None:
    async with linked(max_frame_size=1000) as (_peer, client, wire):
        task = ask(client, Speak())
        await wire.answer(await wire.next(), msg="x" * 2000)
        with pytest.raises(ConnectionLostError, match=r"1009.*raise max_frame_size, a parameter"):
            await soon(task)
        await client.wait_ready(TIMEOUT)


@pytest.mark.parametrize(
    ("code", "reason", "told"),
    [
        (4001, "out of order", "4001 out of order"),
        (1009, "too big", r"1009 too big .*a frame from this side"),
    ],
)
async def test_the_error_says_why_the_chassis_closed_the_connection(
    code: int, reason: str, told: str
) -> None:
    async with linked() as (_peer, client, wire):
        task = ask(client, Speak())
        await wire.next()
        closing = code.to_bytes(2, "big") + reason.encode()
        wire.transport.write(bytes([0x88, len(closing)]) + closing)
        with pytest.raises(ConnectionLostError, match=told):
            await soon(task)


async def test_an_internal_error_ends_the_connection_but_not_the_client() -> None:
    async with linked() as (peer, client, wire):

        def broken(_: object) -> None:
            raise ZeroDivisionError

        client._connection._on_push = broken  # type: ignore[union-attr]
        task = ask(client, Speak())
        await wire.next()
        await wire.push("woosh.robot.PoseSpeed")
        with pytest.raises(ConnectionLostError, match="internal error"):
            await soon(task)
        again = await peer.wire(2)
        await client.wait_ready(TIMEOUT)
        assert (await answered(client.request(Speak()), again)).ok
