"""The sizes that a client reports: they grow with its load, and shrink after it."""

from __future__ import annotations

import asyncio

import pytest

from tests.link.link_peer import Packed, Peer, aio, block, eventually, linked, soon, turns
from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Speak

IDLE = {"requests": 0, "outbox": 0, "pushes": 0}


def sizes_without_tasks(sizes: dict[str, int]) -> dict[str, int]:
    return {name: size for name, size in sizes.items() if name != "tasks"}


@aio
async def test_all_sizes_are_zero_without_a_link() -> None:
    async with Peer() as peer:
        client = peer.client()
        assert client.debug() == {**IDLE, "tasks": 0}
        async with client:
            assert client.debug() == {**IDLE, "tasks": 5}
        assert client.debug() == {**IDLE, "tasks": 0}


@pytest.mark.parametrize("kind", ["json", "tcp"])
@aio
async def test_requests_and_unsent_frames_are_counted(kind: str) -> None:
    async with linked(kind) as (_peer, client, wire):
        tasks = [await block(client, wire)]
        tasks += [asyncio.ensure_future(client.request(Speak())) for _ in range(3)]
        await turns()
        assert sizes_without_tasks(client.debug()) == {**IDLE, "requests": 4, "outbox": 3}
        wire.thaw()
        for task in tasks:
            await wire.answer(await wire.next())
            await soon(task)
        assert sizes_without_tasks(client.debug()) == IDLE


@aio
async def test_queued_pushes_are_counted() -> None:
    async with linked("tcp") as (_peer, client, wire):
        queued: list[int] = []
        client.subscribe(StatusCode, lambda _: queued.append(client.debug()["pushes"]))
        one = Packed.pack({"type": "woosh.robot.count.StatusCode", "body": b"\x08\x01"})
        await wire.raw((Packed.varint(len(one)) + one) * 300)  # they are read together
        await eventually(lambda: len(queued) == 300)
        assert max(queued) > 0
        assert queued[-1] == client.debug()["pushes"] == 0
