"""Unsent requests can expire or be withdrawn; types of requests can be reserved for one sender."""

from __future__ import annotations

import asyncio

import pytest

from tests.link.link_peer import aio, answered, ask, block, linked, soon, turns
from woosh_robot_agent.link import Sending, SupersededError, TooManyRequestsError
from woosh_robot_agent.pb.robot.robot_pack_pb2 import SetMuteCall, Speak


@aio
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
            await wire.answer(await wire.next("woosh.robot.Speak"))
            assert (await soon(task)).ok


@aio
async def test_a_request_that_is_withdrawn_is_not_sent() -> None:
    async with linked() as (_peer, client, wire):
        load = await block(client, wire)
        withdrawn = ask(client, SetMuteCall())
        other = ask(client, Speak(text="other"))
        await turns()
        client.withdraw(lambda message: isinstance(message, SetMuteCall), "not wanted any more")
        with pytest.raises(SupersededError, match="not sent: not wanted any more"):
            await soon(withdrawn)
        wire.thaw()
        for task in (load, other):
            await wire.answer(await wire.next("woosh.robot.Speak"))
            assert (await soon(task)).ok
        assert "woosh.robot.SetMuteCall" not in [frame["type"] for frame in wire.seen]


@aio
async def test_an_urgent_request_is_sent_even_when_too_many_are_in_flight() -> None:
    async with linked(max_in_flight=1) as (_peer, client, wire):
        waiting = ask(client, Speak())
        first = await wire.next("woosh.robot.Speak")
        with pytest.raises(TooManyRequestsError):
            await client.request(SetMuteCall())
        assert (await answered(client.send(SetMuteCall(), Sending(urgent=True)), wire)).ok
        await wire.answer(first)
        await soon(waiting)


@aio
async def test_reserved_requests_are_sent_by_their_owner_only() -> None:
    async with linked() as (_peer, client, wire):
        send = client.reserve(lambda message: isinstance(message, SetMuteCall))
        with pytest.raises(RuntimeError, match=r"woosh\.robot\.SetMuteCall is reserved"):
            await client.request(SetMuteCall())
        with pytest.raises(RuntimeError, match="reserved already"):
            client.reserve(lambda _message: True)
        assert (await answered(send(SetMuteCall(), Sending()), wire)).ok
