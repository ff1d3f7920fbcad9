"""A stop through the motion gate."""

from __future__ import annotations

import asyncio

import pytest
from google.protobuf.message import Message

from tests.link.link_peer import TIMEOUT, Frame, Peer, Wire, aio, block, eventually, soon, turns
from tests.motion.gate_checks import (
    ORDERS,
    TWIST,
    answer_all,
    every_moving_request,
    ok,
    types,
)
from woosh_robot_agent.link import SupersededError
from woosh_robot_agent.motion import MotionGate
from woosh_robot_agent.motion import gate as gate_module
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Twist

pytestmark = pytest.mark.usefixtures("long_hold")


@aio
async def test_a_stop_sends_the_zero_first_and_then_every_cancel() -> None:
    async with Peer(script=answer_all) as peer, peer.client() as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        report = await soon(asyncio.ensure_future(gate.stop(TIMEOUT)))
        assert report.success
        sent = types(wire)
        assert sent[:2] == [TWIST, "woosh.robot.ActionOrder"]
        assert sent[2:] == ["woosh.ros.CallAction"] * (ORDERS - 2)
        cancelled = {next(iter(frame["body"])) for frame in wire.seen if frame["type"] == sent[-1]}
        assert len(cancelled) == ORDERS - 2


@every_moving_request
@aio
async def test_after_a_stop_nothing_that_moves_is_sent(request_: Message) -> None:
    async with Peer(script=answer_all) as peer, peer.client() as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        await soon(asyncio.ensure_future(gate.stop(TIMEOUT)))
        with pytest.raises(SupersededError, match="cancelled by a stop of the robot"):
            await gate.request(request_)
        await ok(gate.request(Twist()))
        assert len(types(wire)) == ORDERS + 1


@every_moving_request
@aio
async def test_a_stop_withdraws_what_waits_to_be_sent(request_: Message) -> None:
    async with Peer(script=answer_all) as peer, peer.client() as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        load = await block(client, wire)
        waiting = asyncio.ensure_future(gate.request(request_))
        await turns()
        stop = asyncio.ensure_future(gate.stop(TIMEOUT))
        with pytest.raises(SupersededError, match=r"cancelled by a stop of the robot|newer"):
            await soon(waiting)
        wire.thaw()
        assert (await soon(stop)).success
        await soon(load)
        assert len(types(wire)) == ORDERS


@aio
async def test_a_request_some_time_after_a_stop_is_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gate_module, "HOLD", 0.05)
    async with Peer(script=answer_all) as peer, peer.client() as client:
        gate = MotionGate(client)
        loop = asyncio.get_running_loop()
        await soon(asyncio.ensure_future(gate.stop(TIMEOUT)))
        await eventually(lambda: loop.time() > gate._forbidden_until)
        await ok(gate.request(Twist(linear=1)))


@aio
async def test_a_stop_without_an_answer_says_so() -> None:
    async with Peer() as peer, peer.client() as client:
        gate = MotionGate(client)
        report = await soon(asyncio.ensure_future(gate.stop(0.03)))
        assert not report.success
        assert report.message.startswith("NOT STOPPED: the chassis did not answer")
        assert report.message.endswith("press its emergency stop")


@aio
async def test_a_stop_without_the_answer_to_one_cancel_is_a_failure() -> None:
    async def all_but_the_task(wire: Wire, frame: Frame) -> bool:
        return frame["type"] == "woosh.robot.ActionOrder" or await answer_all(wire, frame)

    async with Peer(script=all_but_the_task) as peer, peer.client() as client:
        gate = MotionGate(client)
        await peer.wire()
        await client.wait_ready(TIMEOUT)
        report = await soon(asyncio.ensure_future(gate.stop(1.0)))
        assert not report.success
        assert report.message.startswith("stopped; ")
        assert "cancel of task: the chassis did not answer" in report.message
        assert report.message.endswith("press its emergency stop")
