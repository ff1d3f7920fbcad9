"""Another robot at the other end: after a change of address or id, and after a reconnect."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import Any

import pytest

from tests.link.link_peer import INFO, TIMEOUT, Frame, Peer, Wire, aio, eventually, soon, turns
from woosh_robot_agent.link import (
    ChassisClient,
    ConnectionLostError,
    LinkConfig,
    LinkState,
    NotConnectedError,
)
from woosh_robot_agent.link.codecs.frames import Envelope
from woosh_robot_agent.link.codecs.json_codec import JsonCodec
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Speak
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed

POSE = "woosh.robot.PoseSpeed"
SPEAK = "woosh.robot.Speak"


def follow(client: ChassisClient) -> list[Any]:
    """Return a list to which everything is appended that the client tells, in order."""
    told: list[Any] = []
    client.subscribe(PoseSpeed, lambda push: told.append(push.map_id))
    client.on_snapshot(lambda info: told.append(f"robot {info.robot_id}"))
    client.on_robot_changed(lambda: told.append("changed"))
    return told


def info(robot_id: int = 0, serial_number: int = 0) -> Frame:
    return {"robotId": robot_id, "genral": {"serialNumber": serial_number}}


@pytest.mark.parametrize(
    ("change", "is_same"),
    [
        ({}, True),
        ({"encoding": "protobuf"}, True),
        ({"transport": "tcp"}, True),
        ({"port": 5480}, True),
        ({"ip": "10.0.0.2"}, False),
        ({"port": 5479}, False),
        ({"robot_id": 2}, False),
    ],
)
def test_which_configurations_lead_to_the_same_robot(change: Any, is_same: bool) -> None:
    config = LinkConfig(ip="10.0.0.1")
    assert config.addresses_same_robot(replace(config, **change)) is is_same


@aio
async def test_all_of_the_former_robot_is_told_before_the_change_and_all_of_the_new_after() -> None:
    async with Peer() as one, Peer() as two, one.client() as client:
        one.info, two.info = info(1), info(2)
        told = follow(client)
        wire = await one.wire()
        await wire.push(POSE, {"mapId": 1})
        await eventually(lambda: told == [1])
        changing = asyncio.ensure_future(client.reconfigure(two.config()))
        await turns(1)
        assert told == [1, "changed"], "at once"
        assert client.state is not LinkState.READY
        await wire.push(POSE, {"mapId": 2})  # too late
        await changing
        await client.wait_ready(TIMEOUT)
        await (await two.wire()).push(POSE, {"mapId": 3})
        await eventually(lambda: told[-1] == 3)
        assert told == [1, "changed", "robot 2", 3]


@aio
async def test_pushes_that_wait_for_their_consumers_are_discarded() -> None:
    async with Peer() as peer, peer.client() as client:
        told = follow(client)
        for number in range(5):
            client._subscriptions.put_push(JsonCodec(), Envelope(POSE, {"mapId": number}))
        client._subscriptions.forget_robot()
        await turns()
        assert told == ["changed"]
        assert client.debug()["pushes"] == 0


@aio
async def test_pending_requests_fail_and_answers_that_come_later_are_ignored() -> None:
    async with Peer() as one, Peer() as two, one.client() as client:
        wire = await one.wire()
        tapped: list[Any] = []
        request = asyncio.ensure_future(client.request(Speak(), tap=tapped.append))
        frame = await wire.next(SPEAK)
        changing = asyncio.ensure_future(client.reconfigure(two.config()))
        with pytest.raises(ConnectionLostError, match=f"turned from ws://127.0.0.1:{one.port}"):
            await soon(request)
        with pytest.raises(NotConnectedError):
            await client.request(Speak())
        await wire.answer(frame)
        await changing
        await client.wait_ready(TIMEOUT)
        assert tapped == []


@aio
async def test_an_answer_that_is_read_but_not_handled_yet_is_not_passed_on() -> None:
    async with Peer() as peer, peer.client() as client:
        wire = await peer.wire()
        request = asyncio.ensure_future(client.request(Speak()))
        frame = await wire.next(SPEAK)
        (pending,) = client._connection._pending.values()  # type: ignore[union-attr]
        # called when the answer is read, before the request resumes
        pending.tap = lambda _answer: client._subscriptions.forget_robot()
        await wire.answer(frame)
        with pytest.raises(ConnectionLostError, match="another robot"):
            await soon(request)


@aio
async def test_the_farewell_is_sent_before_the_connection_ends() -> None:
    async with Peer() as one, Peer() as two, one.client() as client:
        told = follow(client)
        wire = await one.wire()
        send = client.reserve(lambda _message: True)
        answers: list[bool] = []

        async def farewell() -> None:
            answers.append((await send(Speak(text="bye"), TIMEOUT, farewell=True)).ok)

        changing = asyncio.ensure_future(client.reconfigure(two.config(), farewell))
        frame = await wire.next(SPEAK)
        assert frame["body"] == {"text": "bye"}
        with pytest.raises(NotConnectedError):
            await send(Speak())
        assert not two.wires
        await wire.push(POSE, {"mapId": 5})  # of the robot that has been left
        await wire.answer(frame)
        await changing
        await client.wait_ready(TIMEOUT)
        assert answers == [True]
        assert 5 not in told
        await soon(wire.gone.wait())


@aio
async def test_a_second_change_does_not_wait_for_the_farewell_to_the_first() -> None:
    async with Peer() as one, Peer() as two, Peer() as three, one.client() as client:
        told = follow(client)
        wire = await one.wire()
        changing = asyncio.ensure_future(client.reconfigure(two.config(), asyncio.Event().wait))  # type: ignore[arg-type]
        await turns()
        again = asyncio.ensure_future(client.reconfigure(three.config()))
        await turns()
        assert told == ["changed", "changed"]
        await client.close()
        await asyncio.gather(changing, again)
        await soon(wire.gone.wait())


@pytest.mark.parametrize(
    ("before", "after", "changes"),
    [
        (info(1, 11), info(1, 11), False),
        (info(1, 11), info(2, 11), True),
        (info(1, 11), info(1, 12), True),
        (info(0, 11), info(0, 12), True),
        (info(1, 11), info(0, 0), False),
        (info(), info(1, 11), False),
    ],
)
@aio
async def test_another_robot_after_a_reconnect_is_noticed(
    before: Frame, after: Frame, changes: bool
) -> None:
    async with Peer() as peer:
        peer.info = before
        client = peer.client()
        told = follow(client)
        async with client:
            await eventually(lambda: told)
            peer.info = after
            (await peer.wire()).abort()
            await peer.wire(2)
            await eventually(lambda: len(told) == 2 + changes)
            assert ("changed" in told) is changes
            assert told[-1] == f"robot {after['robotId']}"


@aio
async def test_pushes_before_the_first_robot_info_are_held_until_the_robot_is_known() -> None:
    async def push_first(wire: Wire, frame: Frame) -> bool:
        if frame["type"] == INFO:
            await wire.push(POSE, {"mapId": 10 + len(wire.peer.wires)})
        return False

    async with Peer(script=push_first) as peer:
        peer.info = info(1)
        client = peer.client()
        told = follow(client)
        async with client:
            await eventually(lambda: len(told) == 2)
            peer.info = info(2)
            (await peer.wire()).abort()
            await peer.wire(2)
            await eventually(lambda: len(told) == 5)
            assert told == [11, "robot 1", "changed", 12, "robot 2"]


@aio
async def test_pushes_of_a_failed_handshake_are_discarded() -> None:
    async def refuse_first(wire: Wire, frame: Frame) -> bool:
        if frame["type"] == INFO and len(wire.peer.wires) == 1:
            await wire.push(POSE, {"mapId": 1})
            await wire.answer(frame, ok=False, msg="starting")
            return True
        return False

    async with Peer(script=refuse_first) as peer:
        client = peer.client()
        told = follow(client)
        async with client:
            await eventually(lambda: told)
            assert told == ["robot 0"]
