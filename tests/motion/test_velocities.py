"""Velocities: the newest one wins, a stale one is not sent, and a zero always is."""

from __future__ import annotations

import asyncio
import logging
import math
from typing import Any

import pytest

from tests.link.link_peer import TIMEOUT, Frame, Peer, Wire, aio, block, eventually, soon, turns
from woosh_robot_agent.link import (
    ConnectionLostError,
    NotConnectedError,
    RequestTimeoutError,
    SupersededError,
    reports,
)
from woosh_robot_agent.motion import MotionGate, timeliness
from woosh_robot_agent.motion.timeliness import LatestWins
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Speak, Twist

TWIST = "woosh.robot.Twist"


@pytest.fixture(autouse=True)
def long_stall(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let no command be stalled or stale unless a test says so, even on a slow machine."""
    monkeypatch.setattr(timeliness, "MAX_AGE", 3600.0)


@pytest.fixture
def short_stall(long_stall: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(timeliness, "MAX_AGE", 0.1)


def drive(gate: MotionGate, speed: float, **options: Any) -> asyncio.Task[Any]:
    return asyncio.ensure_future(gate.request(Twist(linear=speed), **options))


def speeds(wire: Wire) -> list[float]:
    return [frame["body"].get("linear", 0) for frame in wire.seen if frame["type"] == TWIST]


async def stalled(gate: MotionGate, wire: Wire) -> tuple[asyncio.Task[Any], Frame]:
    """Send one command and let it be unanswered for too long; return its task and frame."""
    first = drive(gate, 1)
    frame = await wire.next(TWIST)
    stall(gate._velocities)
    return first, frame


def stall(latest: LatestWins[Any]) -> None:
    """Backdate the unanswered commands, so that they count as stalled."""
    for serial in latest._unanswered:
        latest._unanswered[serial] -= timeliness.MAX_AGE + 1
    assert latest._stalled()


async def ended(*tasks: asyncio.Task[Any]) -> None:
    for task in tasks:
        task.cancel()
    await asyncio.wait(tasks)


@aio
async def test_commands_are_pipelined_while_the_chassis_answers() -> None:
    async with Peer() as peer, peer.client() as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        tasks = [drive(gate, speed) for speed in (1, 2, 3)]
        frames = [await wire.next(TWIST) for _ in tasks]
        for frame in frames:
            await wire.answer(frame)
        assert all(answer.ok for answer in await soon(asyncio.gather(*tasks)))
        assert speeds(wire) == [1, 2, 3]


@aio
async def test_commands_are_sent_even_when_too_many_requests_are_in_flight() -> None:
    async with Peer() as peer, peer.client(max_in_flight=1) as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        waiting = asyncio.ensure_future(client.request(Speak()))
        task = drive(gate, 1)
        await wire.answer(await wire.next(TWIST))
        assert (await soon(task)).ok
        await ended(waiting)


@aio
async def test_commands_do_not_count_as_requests_in_flight() -> None:
    async with Peer() as peer, peer.client(max_in_flight=1) as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        unanswered = [drive(gate, speed) for speed in (1, 2, 3)]
        for _ in unanswered:
            await wire.next(TWIST)
        task = asyncio.ensure_future(client.request(Speak()))
        await wire.answer(await wire.next("woosh.robot.Speak"))
        assert (await soon(task)).ok
        await ended(*unanswered)


@aio
async def test_while_the_chassis_does_not_answer_only_the_newest_is_held() -> None:
    async with Peer() as peer, peer.client() as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        first, frame = await stalled(gate, wire)
        second, third = drive(gate, 2), drive(gate, 3)
        with pytest.raises(SupersededError, match="a newer velocity command"):
            await soon(second)
        await wire.answer(frame)
        assert (await soon(first)).ok
        await wire.answer(await wire.next(TWIST))
        assert (await soon(third)).ok
        assert speeds(wire) == [1, 3]


@pytest.mark.usefixtures("short_stall")
@aio
async def test_a_command_held_too_long_is_not_sent() -> None:
    async with Peer() as peer, peer.client() as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        first, frame = await stalled(gate, wire)
        with pytest.raises(SupersededError, match="too old"):
            await soon(drive(gate, 2))
        await wire.answer(frame)
        await soon(first)
        await turns()
        assert speeds(wire) == [1]


@pytest.mark.parametrize("stop", [Twist(), Twist(linear=-0.0)])
@aio
async def test_a_stop_is_never_held(stop: Twist) -> None:
    async with Peer() as peer, peer.client() as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        first, _ = await stalled(gate, wire)
        held = drive(gate, 2)
        await turns()
        stopping = asyncio.ensure_future(gate.request(stop))
        frame = await wire.next(TWIST)
        assert not frame["body"].get("linear")
        assert not first.done()  # its answer would release a held velocity
        with pytest.raises(SupersededError):
            await soon(held)
        await wire.answer(frame)
        assert (await soon(stopping)).ok
        await ended(first)
        assert speeds(wire) == [1, 0]


@aio
async def test_no_older_command_overtakes_a_stop_even_when_released_just_before() -> None:
    async with Peer() as peer, peer.client() as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        first, _ = await stalled(gate, wire)
        held = drive(gate, 2)
        await turns()
        gate._velocities._release()  # as after an answer
        stopping = asyncio.ensure_future(gate.request(Twist()))
        with pytest.raises(SupersededError):
            await soon(held)
        await wire.answer(await wire.next(TWIST))
        await soon(stopping)
        await ended(first)
        assert speeds(wire) == [1, 0]


@aio
async def test_a_command_held_right_after_another_was_released_is_superseded_at_once() -> None:
    latest = LatestWins[str]()
    answers: list[asyncio.Future[str]] = []

    async def send(_fresh: float) -> str:
        answers.append(asyncio.get_running_loop().create_future())
        return await answers[-1]

    def go(speed: float) -> asyncio.Task[str]:
        now = asyncio.get_running_loop().time()
        return asyncio.ensure_future(latest.request(Twist(linear=speed), send, now))

    first = go(1)
    await turns(3)
    stall(latest)
    second = go(2)
    await turns(3)
    latest._release()
    third = go(3)  # starts before the released second command is sent
    await turns(3)
    with pytest.raises(SupersededError):
        await second
    fourth = go(4)
    await turns(3)
    assert third.done()  # superseded at once, not only when it is stale
    with pytest.raises(SupersededError, match="newer"):
        await third
    answers[0].set_result("first")
    await turns(5)
    answers[1].set_result("fourth")
    assert [await first, await fourth] == ["first", "fourth"]


@aio
async def test_cancelling_a_held_command_passes_through_and_it_is_not_sent() -> None:
    async with Peer() as peer, peer.client() as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        first, _ = await stalled(gate, wire)
        held = drive(gate, 2)
        await turns()
        gate._velocities._release()
        held.cancel()
        with pytest.raises(asyncio.CancelledError):
            await held
        await turns()
        assert speeds(wire) == [1]
        await ended(first)


@pytest.mark.usefixtures("short_stall")
@aio
async def test_a_command_that_waited_for_a_busy_connection_is_not_sent_late() -> None:
    async with Peer() as peer, peer.client() as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        upload = await block(client, wire)
        loop = asyncio.get_running_loop()
        stale = drive(gate, 1)
        stop = asyncio.ensure_future(gate.request(Twist()))
        await turns()
        sent = loop.time()
        await eventually(lambda: loop.time() > sent + timeliness.MAX_AGE)
        assert not stale.done()
        wire.thaw()
        with pytest.raises(SupersededError, match="too old"):
            await soon(stale)
        await wire.answer(await wire.next(TWIST))
        assert (await soon(stop)).ok
        assert speeds(wire) == [0]
        await ended(upload)


@aio
async def test_the_callers_timeout_applies_to_commands() -> None:
    async with Peer() as peer, peer.client() as client:
        gate = MotionGate(client)
        with pytest.raises(RequestTimeoutError, match=r"0\.03 s"):
            await soon(drive(gate, 1, timeout=0.03))
        assert not gate._velocities._unanswered


@aio
async def test_after_a_lost_link_nothing_is_held_and_nothing_sent_again() -> None:
    async with Peer() as peer, peer.client(backoff_min=0.2, backoff_max=0.2) as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        first, _ = await stalled(gate, wire)
        held = drive(gate, 2)
        await turns()
        wire.abort()
        with pytest.raises(ConnectionLostError):
            await soon(first)
        with pytest.raises(NotConnectedError):
            await soon(held)
        again = await peer.wire(2)
        await client.wait_ready(TIMEOUT)
        task = drive(gate, 3)
        await again.answer(await again.next(TWIST))
        await soon(task)
        assert speeds(again) == [3]


@pytest.mark.usefixtures("short_stall")
@aio
async def test_a_stop_never_becomes_stale() -> None:
    latest = LatestWins[float]()
    now = asyncio.get_running_loop().time()

    async def send(fresh: float) -> float:
        return fresh

    assert await latest.request(Twist(), send, now - 10.0) == math.inf
    assert await latest.request(Twist(linear_y=1), send, now + 50.0) > 40.0


@aio
async def test_superseded_velocities_are_counted_and_logged(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    caplog.set_level(logging.INFO, "woosh_robot_agent.motion")
    monkeypatch.setattr(reports, "QUIET", 0.2)

    def told() -> list[int]:
        return [each.levelno for each in caplog.records if "not sent" in each.getMessage()]

    async with Peer() as peer, peer.client() as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        first, frame = await stalled(gate, wire)
        asked = [drive(gate, 0.2) for _ in range(4)]
        done = await asyncio.gather(*asked[:3], return_exceptions=True)
        assert [type(each) for each in done] == [SupersededError] * 3
        await wire.answer(frame)
        await wire.answer(await wire.next(TWIST))
        await soon(asyncio.gather(first, asked[3]))
        assert gate.superseded == 3
        await eventually(lambda: told() == [logging.WARNING, logging.INFO])
