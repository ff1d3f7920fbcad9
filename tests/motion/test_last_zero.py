"""The zero velocity that a gate sends on closing if the robot may be driving."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace

import pytest

from tests.link.link_peer import TIMEOUT, Frame, Peer, Wire, aio, eventually, soon, turns
from tests.motion.gate_checks import TWIST, answer_all, ok, types
from woosh_robot_agent.link import NotConnectedError, RequestTimeoutError, SupersededError
from woosh_robot_agent.motion import MotionGate
from woosh_robot_agent.motion import gate as gate_module
from woosh_robot_agent.motion.gate import ZeroRefusedError
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Twist


@pytest.mark.parametrize("drove", [False, True])
@aio
async def test_the_last_zero_is_sent_only_if_the_robot_may_drive(drove: bool) -> None:
    async with Peer(script=answer_all) as peer, peer.client() as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        if drove:
            await ok(gate.request(Twist(linear=1)))
        await gate.close(TIMEOUT)
        await gate.close(TIMEOUT)
        assert types(wire) == [TWIST, TWIST] * drove


@aio
async def test_a_zero_that_was_not_confirmed_is_sent_again() -> None:
    async with Peer() as peer, peer.client() as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        task = asyncio.ensure_future(gate.request(Twist(linear=1)))
        await wire.answer(await wire.next(TWIST))
        await soon(task)
        with pytest.raises(RequestTimeoutError):
            await gate.close(0.03)
        closing = asyncio.ensure_future(gate.close(TIMEOUT))
        await wire.next(TWIST)
        await wire.answer(await wire.next(TWIST))
        await soon(closing)
        assert not gate.driving


@aio
async def test_a_refused_zero_does_not_count_as_stopped(long_drive: None) -> None:
    async def refuse_zeros(wire: Wire, frame: Frame) -> bool:
        if frame["type"] == TWIST:
            await wire.answer(frame, ok=bool(frame["body"].get("linear")), msg="no remote control")
        return frame["type"] == TWIST

    async with Peer(script=refuse_zeros) as peer, peer.client() as client:
        gate = MotionGate(client)
        await ok(gate.request(Twist(linear=1)))
        assert not (await gate.request(Twist())).ok
        assert gate.driving
        with pytest.raises(ZeroRefusedError, match="refused the zero velocity: no remote control"):
            await gate.close(TIMEOUT)


@aio
async def test_the_last_zero_replaces_a_held_velocity(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async with Peer() as peer, peer.client() as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        first = asyncio.ensure_future(gate.request(Twist(linear=1)))
        frame = await wire.next(TWIST)
        for serial in gate._velocities._unanswered:
            gate._velocities._unanswered[serial] -= 3600.0  # unanswered for too long
        held = asyncio.ensure_future(gate.request(Twist(linear=2)))
        await turns()
        closing = asyncio.ensure_future(gate.close(TIMEOUT))
        await wire.answer(await wire.next(TWIST))
        await soon(closing)
        await wire.answer(frame)
        await soon(first)
        with pytest.raises(SupersededError):
            await soon(held)
        assert types(wire) == [TWIST, TWIST]


@aio
async def test_a_robot_that_drove_when_the_link_was_lost_counts_as_not_stopped() -> None:
    async with (
        Peer(script=answer_all) as peer,
        peer.client(backoff_min=60.0, backoff_max=60.0) as client,
    ):
        gate = MotionGate(client)
        wire = await peer.wire()
        await ok(gate.request(Twist(linear=1)))
        wire.abort()
        await eventually(lambda: client.state.value == "waiting")
        with pytest.raises(NotConnectedError):
            await gate.close(TIMEOUT)


@aio
async def test_a_velocity_that_was_not_sent_does_not_count_as_driving() -> None:
    async with Peer() as peer, peer.client() as client:
        gate = MotionGate(client)
        await client.close()
        with pytest.raises(NotConnectedError):
            await gate.request(Twist(linear=1))
        await gate.close(TIMEOUT)


@aio
async def test_the_robot_counts_as_standing_1500_ms_after_the_last_velocity(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = 100.0
    monkeypatch.setattr(gate_module, "time", SimpleNamespace(monotonic=lambda: now))
    async with Peer(script=answer_all) as peer, peer.client() as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        await ok(gate.request(Twist(linear=1)))
        now = 101.0
        await ok(gate.request(Twist(linear=1)))
        now = 102.499
        assert gate.driving
        now = 102.501
        assert not gate.driving
        await gate.close(TIMEOUT)
        assert types(wire) == [TWIST, TWIST]
