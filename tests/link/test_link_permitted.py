"""Requests that are not sent: not permitted, reserved for another caller, withdrawn or expired."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest
from google.protobuf.message import Message

from tests.link.link_peer import Peer, answered, ask, block, linked, soon, turns
from woosh_robot_agent.link import ChassisClient, NotPermittedError, Sending, SupersededError
from woosh_robot_agent.pb.robot.robot_pack_pb2 import SetMuteCall, Speak
from woosh_robot_agent.pb.robot.robot_pb2 import Battery

SPEAK = "woosh.robot.Speak"
BATTERY = "woosh.robot.Battery"


def is_battery(message: Message) -> bool:
    return isinstance(message, Battery)


@pytest.mark.parametrize("reserved", [False, True])
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
        assert (await answered(client.send(Speak(), Sending(always=True)), wire)).ok
        client.permit_only(None)
        assert (await answered(client.request(Speak()), wire)).ok
        asked = [frame["type"] for frame in wire.seen if frame["type"] in (SPEAK, BATTERY)]
        assert asked == [BATTERY, SPEAK, SPEAK]


async def test_the_links_own_requests_are_always_sent() -> None:
    async with Peer() as peer:
        client = peer.client()
        client.permit_only(lambda _message: False, "nothing")
        async with client:
            pass  # the link is ready


async def test_reserved_requests_are_sent_by_their_owner_only() -> None:
    async with linked() as (_peer, client, wire):
        send = client.reserve(lambda message: isinstance(message, SetMuteCall))
        with pytest.raises(RuntimeError, match=r"woosh\.robot\.SetMuteCall is reserved"):
            await client.request(SetMuteCall())
        with pytest.raises(RuntimeError, match="reserved already"):
            client.reserve(lambda _message: True)
        assert (await answered(send(SetMuteCall(), Sending()), wire)).ok


@pytest.mark.parametrize(
    "withdraw",
    [
        lambda client: client.withdraw(lambda message: isinstance(message, SetMuteCall), "no use"),
        lambda client: client.permit_only(lambda message: isinstance(message, Speak), "no use"),
    ],
    ids=["withdrawn", "not permitted any more"],
)
async def test_a_waiting_request_that_is_withdrawn_is_not_sent(
    withdraw: Callable[[ChassisClient], None],
) -> None:
    async with linked() as (_peer, client, wire):
        load = await block(client, wire)
        withdrawn = ask(client, SetMuteCall())
        other = ask(client, Speak(text="other"))
        await turns()
        withdraw(client)
        with pytest.raises(SupersededError, match="not sent: no use"):
            await soon(withdrawn)
        wire.thaw()
        for task in (load, other):
            await wire.answer(await wire.next(SPEAK))
            assert (await soon(task)).ok
        assert "woosh.robot.SetMuteCall" not in [frame["type"] for frame in wire.seen]


async def test_a_request_that_waited_too_long_is_not_sent() -> None:
    async with linked() as (_peer, client, wire):
        load = await block(client, wire)
        stale = asyncio.ensure_future(client.send(Speak(text="stale"), Sending(within=0.0)))
        fresh = ask(client, Speak(text="fresh"))
        await turns()
        wire.thaw()
        with pytest.raises(SupersededError, match="too old"):
            await soon(stale)
        for task in (load, fresh):
            await wire.answer(await wire.next(SPEAK))
            assert (await soon(task)).ok
