"""Frames of many MiB: both directions, order and progress."""

from __future__ import annotations

import pytest

from tests.link.link_peer import KINDS, answered, ask, eventually, linked, soon
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Speak


@pytest.mark.parametrize("kind", KINDS)
async def test_frames_of_many_mib_go_both_ways(kind: str) -> None:
    picture = "z" * (1024 * 1024)
    async with linked(kind) as (_peer, client, wire):
        task = ask(client, Speak(text=picture))
        frame = await wire.next()
        assert len(frame["body"]["text"] if kind == "json" else frame["body"]) >= len(picture)
        await wire.answer(frame, frame["body"])
        answer = await soon(task)
        assert isinstance(answer.body, Speak)
        assert answer.body.text == picture


@pytest.mark.parametrize("kind", ["json", "tcp"])
async def test_traffic_shows_what_arrives_and_what_waits(kind: str) -> None:
    async with linked(kind) as (_peer, client, wire):
        received, _ = client.traffic()
        assert received > 0
        text = "x" * 100_000
        body = {"text": text} if kind == "json" else Speak(text=text).SerializeToString()
        await answered(client.request(Speak()), wire, body)
        assert len(text) < client.traffic()[0] - received < 2 * len(text)
        big = ask(client, Speak(text="x" * 20_000_000))
        await eventually(lambda: client.traffic()[1] > 1_000_000)
        await wire.answer(await wire.next())
        await soon(big)
        assert client.traffic()[1] == 0
    assert client.traffic() == (0, 0)
