"""A client that may send only some requests."""

from __future__ import annotations

import pytest
from google.protobuf.message import Message

from tests.link.link_peer import TIMEOUT, Peer, aio, answered, ask, block, linked, soon, turns
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
        assert (await answered(send(Battery(), Sending()), wire)).ok
        client.permit_only(None)
        assert (await answered(client.request(Speak()), wire)).ok
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
        assert (await answered(client.send(Speak(), Sending(always=True)), wire)).ok


@aio
async def test_the_links_own_requests_are_sent() -> None:
    async with Peer() as peer:
        client = peer.client()
        client.permit_only(lambda _message: False, "nothing")
        async with client:
            await client.wait_ready(TIMEOUT)
