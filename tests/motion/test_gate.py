"""The motion gate: reserved requests, closing, and the end of the link."""

from __future__ import annotations

import asyncio

import pytest
from google.protobuf.message import Message

from tests.link.link_peer import TIMEOUT, Peer, aio, soon
from tests.motion.gate_checks import ORDERS, answer_all, every_moving_request, ok, types
from woosh_robot_agent.link import NotConnectedError, SupersededError
from woosh_robot_agent.motion import MotionGate
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Speak

pytestmark = pytest.mark.usefixtures("long_hold")


@every_moving_request
@aio
async def test_moving_requests_are_refused_outside_the_gate(request_: Message) -> None:
    async with Peer(script=answer_all) as peer, peer.client() as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        with pytest.raises(RuntimeError, match="reserved"):
            await client.request(request_)
        assert types(wire) == []
        await ok(gate.request(request_))
        assert types(wire) == [request_.DESCRIPTOR.full_name]


@aio
async def test_a_client_can_have_only_one_gate() -> None:
    async with Peer() as peer, peer.client() as client:
        MotionGate(client)
        with pytest.raises(RuntimeError, match="reserved already"):
            MotionGate(client)


@aio
async def test_requests_that_move_nothing_are_sent_even_when_closed() -> None:
    async with Peer(script=answer_all) as peer, peer.client() as client:
        gate = MotionGate(client)
        await gate.close(TIMEOUT)
        await ok(gate.request(Speak()))


@every_moving_request
@aio
async def test_once_closed_nothing_that_moves_is_sent(request_: Message) -> None:
    async with Peer(script=answer_all) as peer, peer.client() as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        await gate.close(TIMEOUT)
        await soon(asyncio.ensure_future(gate.stop(TIMEOUT)))  # forbids motion for a while only
        with pytest.raises(SupersededError, match="the agent is stopping"):
            await gate.request(request_)
        assert len(types(wire)) == ORDERS


@every_moving_request
@aio
async def test_nothing_is_sent_again_after_a_lost_link(request_: Message) -> None:
    async with Peer() as peer, peer.client(backoff_min=0.05, backoff_max=0.05) as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        task = asyncio.ensure_future(gate.request(request_))
        await wire.next(request_.DESCRIPTOR.full_name)
        wire.abort()
        await asyncio.wait([task])
        assert task.exception() is not None
        with pytest.raises(NotConnectedError):
            await gate.request(request_)  # a request without a link is not sent later either
        again = await peer.wire(2)
        await client.wait_ready(TIMEOUT)
        speaking = asyncio.ensure_future(gate.request(Speak()))
        await again.answer(await again.next("woosh.robot.Speak"))
        await soon(speaking)
        assert types(again) == []
