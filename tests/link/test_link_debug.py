"""The sizes that a client reports: they grow with its load, and shrink after it."""

from __future__ import annotations

import asyncio

import pytest

from tests.link.link_peer import Peer, block, linked, soon, turns
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Speak

IDLE = {"requests": 0, "outbox": 0, "pushes": 0, "tasks": 5}


async def test_all_sizes_are_zero_without_a_link() -> None:
    async with Peer() as peer:
        client = peer.client()
        assert set(client.debug().values()) == {0}
        async with client:
            assert client.debug() == IDLE
        assert set(client.debug().values()) == {0}


@pytest.mark.parametrize("kind", ["json", "tcp"])
async def test_requests_and_unsent_frames_are_counted(kind: str) -> None:
    async with linked(kind) as (_peer, client, wire):
        tasks = [await block(client, wire)]
        tasks += [asyncio.ensure_future(client.request(Speak())) for _ in range(3)]
        await turns()
        assert client.debug() == {**IDLE, "requests": 4, "outbox": 3}
        wire.thaw()
        for task in tasks:
            await wire.answer(await wire.next())
            await soon(task)
        assert client.debug() == IDLE
