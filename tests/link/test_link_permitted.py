"""A client that may send only some requests."""

from __future__ import annotations

import asyncio

import pytest
from google.protobuf.message import Message

from tests.link.link_peer import TIMEOUT, Peer, aio, ask, block, linked, soon, turns
from woosh_robot_agent.link import NotPermittedError, Sending, SupersededError
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Speak
from woosh_robot_agent.pb.robot.robot_pb2 import Battery

SPEAK = "woosh.robot.Speak"
BATTERY = "woosh.robot.Battery"


def is_battery(message: Message) -> bool:
    return isinstance(message, Battery)


@pytest.mark.parametrize("reserved", [False, True])
@aio
async def test_only_permitted_requests_are_sent(reserved: bool) -> None:
    async with linked() as (_peer, client, wire):
        send = client.reserve(is_battery) if reserved else client.send
        client.permit_only(is_battery, "it may not speak")
        for way in {send, client.send}:
            with pytest.raises(NotPermittedError, match=f"{SPEAK} was not sent: it may not speak"):
                await way(Speak(), Sending())
        assert client.refusal(Speak()) == "it may not speak"
        assert client.refusal(Battery()) == ""
        request = asyncio.ensure_future(send(Battery(), Sending()))
        await wire.answer(await wire.next(BATTERY))
        assert (await soon(request)).ok
        client.permit_only(None)
        request = ask(client, Speak())
        await wire.answer(await wire.next(SPEAK))
        assert (await soon(request)).ok
        assert [f["type"] for f in wire.seen if f["type"] in (SPEAK, BATTERY)] == [BATTERY, SPEAK]


@aio
async def test_requests_that_wait_are_withdrawn() -> None:
    async with linked() as (_peer, client, wire):
        load = await block(client, wire)
        waiting = ask(client, Speak(text="late"))
        await turns()
        client.permit_only(is_battery, "it may not speak")
        with pytest.raises(SupersededError, match="it may not speak"):
            await soon(waiting)
        wire.thaw()
        await wire.answer(await wire.next(SPEAK))
        await soon(load)
        assert len([frame for frame in wire.seen if frame["type"] == SPEAK]) == 1


@aio
async def test_what_is_not_permitted_can_be_sent_on_demand() -> None:
    async with linked() as (_peer, client, wire):
        client.permit_only(lambda _message: False, "nothing")
        request = asyncio.ensure_future(client.send(Speak(), Sending(always=True)))
        await wire.answer(await wire.next(SPEAK))
        assert (await soon(request)).ok


@aio
async def test_the_links_own_requests_are_sent() -> None:
    async with Peer() as peer:
        client = peer.client()
        client.permit_only(lambda _message: False, "nothing")
        async with client:
            await client.wait_ready(TIMEOUT)
