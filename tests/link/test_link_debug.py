"""The sizes that a client reports: they grow with its load, and shrink after it."""

from __future__ import annotations

import asyncio

import pytest

from tests.link.link_peer import Peer, aio, block, eventually, soon, turns
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Speak
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed

POSE = "woosh.robot.PoseSpeed"
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
    async with Peer(kind) as peer, peer.client() as client:
        wire = await peer.wire()
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
    async with Peer() as peer, peer.client() as client:
        wire = await peer.wire()
        queued: list[int] = []
        client.subscribe(PoseSpeed, lambda _: queued.append(client.debug()["pushes"]))
        connection = client._connection
        assert connection is not None
        envelope = connection._codec.decode(f'{{"type":"{POSE}"}}')
        for _ in range(3):  # all before the delivery task runs
            connection._on_push(envelope)
        assert client.debug()["pushes"] == 3
        await eventually(lambda: len(queued) == 3)
        assert queued == [2, 1, 0]
        assert not wire.gone.is_set()
