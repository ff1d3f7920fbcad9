"""Liveness: which connections count as alive, and which as lost."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any

import pytest

from tests.link.link_peer import (
    INFO,
    LOAD,
    TIMEOUT,
    Frame,
    Wire,
    ask,
    delimited,
    eventually,
    linked,
    soon,
    states,
    varint,
)
from woosh_robot_agent.link import (
    ConnectionLostError,
    LinkError,
    RequestTimeoutError,
    SupersededError,
)
from woosh_robot_agent.link.connection import Liveness
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Speak


@asynccontextmanager
async def repeating(send: Callable[[], Awaitable[None]]) -> AsyncIterator[None]:
    """Call `send` every 10 ms while the block runs."""

    async def repeat() -> None:
        while True:
            await send()
            await asyncio.sleep(0.01)

    task = asyncio.ensure_future(repeat())
    try:
        yield
    finally:
        task.cancel()
        await asyncio.wait([task])


@pytest.mark.parametrize("kind", ["json", "tcp"])
async def test_a_half_open_connection_is_noticed(kind: str) -> None:
    async with linked(kind, liveness_timeout=0.3) as (peer, client, wire):
        wire.freeze()
        await eventually(lambda: client.last_error)
        assert "nothing was heard for 0.3 s" in str(client.last_error)
        await peer.wire(2)
        await client.wait_ready(TIMEOUT)


@pytest.mark.parametrize("kind", ["json", "tcp"])
async def test_a_quiet_chassis_that_answers_probes_stays_connected(kind: str) -> None:
    async def script(wire: Wire, frame: Frame) -> bool:
        if frame["type"] == "woosh.robot.RobotState":
            await wire.answer(frame)
        return frame["type"] == "woosh.robot.RobotState"

    async with linked(kind, script=script, liveness_timeout=0.8) as (_peer, client, wire):
        seen = states(client)
        probes: list[bool] = []
        transport = client._connection._transport  # type: ignore[union-attr]
        ping = transport.ping

        async def counted() -> bool:  # a probe begins with a ping on all transports
            probes.append(True)
            return await ping()

        transport.ping = counted  # type: ignore[method-assign]
        await eventually(lambda: len(probes) >= 5)  # as many as are due in twice the timeout
        asked = [frame["type"] for frame in wire.seen if frame["type"] != INFO]
        assert seen == []
        if kind == "tcp":  # TCP has no ping
            assert set(asked) == {"woosh.robot.RobotState"}
        else:
            assert asked == []


async def test_a_cancelled_ping_does_not_cancel_the_pong() -> None:
    """Up to websockets 14.1, the arrival of a cancelled pong ends the connection."""
    async with linked() as (_peer, client, wire):
        transport: Any = client._connection._transport  # type: ignore[union-attr]
        ping, pongs = transport._socket.ping, []

        async def noted() -> Any:
            pongs.append(await ping())
            return pongs[-1]

        transport._socket.ping = noted
        wire.freeze()
        probe = asyncio.ensure_future(transport.ping())
        await eventually(lambda: pongs)
        probe.cancel()
        await asyncio.wait({probe})
        assert not pongs[0].cancelled()
        wire.thaw()
        await soon(pongs[0])


async def test_bad_frames_are_not_a_sign_of_life() -> None:
    async with linked("tcp", liveness_timeout=0.2) as (_peer, client, wire):
        async with repeating(lambda: wire.raw(b"\x02\xff\xff")):
            await eventually(lambda: client.last_error)
        assert "nothing was heard" in str(client.last_error)


@pytest.mark.parametrize("kind", ["json", "tcp"])
async def test_a_frame_that_trickles_in_is_not_a_sign_of_life(kind: str) -> None:
    async with linked(kind, liveness_timeout=0.5) as (_peer, client, wire):
        wire.freeze()  # from now on only the trickling bytes arrive
        size = 32 * 1024 * 1024
        first = 0x81 if kind == "json" else 0x82
        head = bytes([first, 0x7F]) + size.to_bytes(8, "big")
        wire.transport.write(varint(size) if kind == "tcp" else head)

        async def trickle() -> None:
            wire.transport.write(b"x")

        async with repeating(trickle):
            await eventually(lambda: client.last_error)
        assert "nothing was heard" in str(client.last_error)


@pytest.mark.parametrize(("kind", "size"), [("json", 100 * 1024), ("tcp", 2 * 1024 * 1024)])
async def test_a_large_frame_on_a_slow_network_is_a_sign_of_life(kind: str, size: int) -> None:
    async with linked(kind, liveness_timeout=1.0) as (_peer, client, wire):
        wire.freeze()  # no pongs: a pong waits behind the big frame
        seen = states(client)
        taken: list[Any] = []
        client.subscribe(Speak, taken.append)
        message: Frame = {"type": "woosh.robot.Speak"}
        if kind == "json":
            data = json.dumps({**message, "body": {"text": "x" * size}}).encode()
            frame = b"\x81\x7f" + len(data).to_bytes(8, "big") + data
        else:
            frame = delimited({**message, "body": Speak(text="x" * size).SerializeToString()})
        step = len(frame) // 8 + 1
        for at in range(0, len(frame), step):
            wire.transport.write(frame[at : at + step])
            await asyncio.sleep(0.25)  # the whole frame takes longer than the timeout
        await eventually(lambda: taken)
        assert seen == []
        assert len(taken[0].text) == size


@pytest.mark.parametrize("kind", ["json", "tcp"])
async def test_a_chassis_that_pushes_but_reads_nothing_is_lost(kind: str) -> None:
    async with linked(kind, liveness_timeout=0.3) as (_peer, client, wire):
        wire.freeze()
        task = ask(client, Speak(text=LOAD))
        body: Any = {} if kind == "json" else b""
        async with repeating(lambda: wire.push("woosh.robot.PoseSpeed", body)):
            with pytest.raises(ConnectionLostError, match=r"read nothing for 0\.3 s"):
                await soon(task)


class Quiet:
    """A transport that receives nothing."""

    progress_at = 0.0
    left = 0
    """Bytes that wait to be sent."""
    sent = 0
    """Number of frames sent."""

    def backlog(self) -> int:
        return self.left


def liveness_of(
    quiet: Any, timeout: float, probe: Callable[[], Awaitable[None]] = asyncio.Future
) -> Liveness:
    """Return the liveness of a transport; by default its probes are never answered."""
    return Liveness(quiet, timeout, probe, lambda: quiet.sent)


@pytest.mark.parametrize("error", [RequestTimeoutError, SupersededError])
async def test_a_probe_that_fails_ends_no_link(error: type[LinkError]) -> None:
    probes = 0

    async def probe() -> None:
        nonlocal probes
        probes += 1
        if probes < 3:
            raise error("no answer, or not sent")

    watching = asyncio.ensure_future(liveness_of(Quiet(), 0.4, probe).watch())
    await eventually(lambda: probes >= 3)
    assert not watching.done()
    watching.cancel()


@pytest.mark.parametrize("frames", [0, 1], ids=["one large frame", "many frames"])
async def test_a_chassis_that_reads_slowly_is_alive(frames: int) -> None:
    slow = Quiet()
    watching = asyncio.ensure_future(liveness_of(slow, 0.8).watch())
    slow.left = 12
    while slow.left:
        await asyncio.sleep(0.12)  # all together takes longer than the timeout
        slow.left -= 1
        slow.sent += frames
        assert not watching.done()
    with pytest.raises(ConnectionLostError, match="nothing was heard"):
        await soon(watching)


async def watched(quiet: Quiet) -> None:
    """Watch a transport until it has been silent for 10 s."""
    await liveness_of(quiet, 10.0).watch()


class LateTimers(asyncio.SelectorEventLoop):
    """An event loop with simulated time, in which each timer fires late by `late` seconds."""

    now = 0.0
    late = 0.05

    def time(self) -> float:
        return self.now

    def _run_once(self) -> None:
        if not self._ready and self._scheduled:  # type: ignore[attr-defined]
            self.now = self._scheduled[0].when() + self.late  # type: ignore[attr-defined]
        super()._run_once()  # type: ignore[misc]


@pytest.mark.parametrize(("late", "within"), [(0.05, 10.0), (5.0, 150.0)])
def test_a_loss_is_noticed_in_bounded_time_though_timers_fire_late(
    late: float, within: float
) -> None:
    loop = LateTimers()
    loop.late = late
    with pytest.raises(ConnectionLostError, match="nothing was heard for 10 s"):
        loop.run_until_complete(watched(Quiet()))
    loop.close()
    assert 9.0 < loop.now <= within


@pytest.mark.parametrize("when", ["idle", "probing"])
async def test_time_in_which_this_program_was_busy_does_not_count_as_silence(when: str) -> None:
    """While the program decodes a frame of many MiB for seconds, it receives nothing."""
    asked = answered = 0

    async def probe() -> None:
        nonlocal asked, answered
        asked += 1
        if when == "probing":
            time.sleep(0.8)
        await asyncio.sleep(0.05)
        answered += 1

    watching = asyncio.ensure_future(liveness_of(Quiet(), 0.4, probe).watch())
    await asyncio.sleep(0)
    for _ in range(3):
        before = asked
        if when == "idle":
            time.sleep(0.8)  # the program is busy for longer than the timeout
        await eventually(lambda before=before: watching.done() or answered > before)  # type: ignore[misc]
        assert not watching.done()
    watching.cancel()


def test_bytes_that_came_just_before_this_program_was_busy_are_a_sign_of_life() -> None:
    quiet, loop = Quiet(), LateTimers()
    loop.late = 0.0

    def receive() -> None:
        quiet.progress_at = loop.now
        loop.now += 30.0  # the program is busy

    loop.call_at(9.6, receive)
    with pytest.raises(ConnectionLostError, match="nothing was heard for 10 s"):
        loop.run_until_complete(watched(quiet))
    loop.close()
    assert loop.now > 9.6 + 30.0 + 9.0
