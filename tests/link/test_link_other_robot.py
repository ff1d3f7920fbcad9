"""The client belongs to the first robot that answers: others are refused."""

from __future__ import annotations

from typing import Any

import pytest

from tests.link.link_peer import INFO, TIMEOUT, Frame, Peer, Wire, ask, eventually, soon
from woosh_robot_agent.link import (
    ChassisClient,
    ConnectionLostError,
    LinkState,
    NotConnectedError,
    OtherRobotError,
)
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Speak
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed

POSE = "woosh.robot.PoseSpeed"
SPEAK = "woosh.robot.Speak"


def follow(client: ChassisClient) -> list[Any]:
    """Return a list to which everything is appended that the client tells, in order."""
    told: list[Any] = []
    client.subscribe(PoseSpeed, lambda push: told.append(push.map_id))
    client.on_snapshot(lambda info: told.append(f"robot {info.robot_id}"))
    return told


def info(robot_id: int = 0, serial_number: int = 0) -> Frame:
    return {"robotId": robot_id, "genral": {"serialNumber": serial_number}}


async def push_first(wire: Wire, frame: Frame) -> bool:
    """Push a pose ahead of each RobotInfo, as a chassis may do."""
    if frame["type"] == INFO:
        await wire.push(POSE, {"mapId": 10 + len(wire.peer.wires)})
    return False


@pytest.mark.parametrize(
    ("first", "then"),
    [
        (info(1, 11), info(2, 11)),
        (info(1, 11), info(1, 12)),
        (info(0, 11), info(0, 12)),
    ],
)
async def test_another_robot_after_a_reconnect_is_refused_until_the_first_is_back(
    first: Frame, then: Frame
) -> None:
    async with Peer(script=push_first) as peer:
        peer.info = first
        client = peer.client()
        told = follow(client)
        async with client:
            await eventually(lambda: len(told) == 2)
            peer.info = then
            (await peer.wire()).abort()
            await peer.wire(3)  # it tries again
            error = client.last_error
            assert isinstance(error, OtherRobotError)
            number, serial = then["robotId"], then["genral"]["serialNumber"]
            assert f"robot {number} (serial number {serial}) answers instead of" in str(error)
            with pytest.raises(NotConnectedError, match="restart this program"):
                await client.request(Speak())
            assert len(told) == 2, "nothing of the other robot is told"
            peer.info = first
            await client.wait_ready(TIMEOUT)
            await eventually(lambda: len(told) == 4)
            assert told[::2] == [11, 10 + len(peer.wires)]
            assert SPEAK not in [frame["type"] for wire in peer.wires for frame in wire.seen]


@pytest.mark.parametrize("then", [info(1, 11), info(0, 0), info(1, 0)])
async def test_a_robot_that_reports_fewer_numbers_is_the_same(then: Frame) -> None:
    async with Peer() as peer:
        peer.info = info(1, 11)
        async with peer.client() as client:
            for number, robot in enumerate((then, info(1, 11)), 2):
                peer.info = robot
                (await peer.wire(number - 1)).abort()
                await peer.wire(number)
                await eventually(lambda: client.state is LinkState.READY)
            peer.info = info(1, 12)  # the numbers of the first link still count
            (await peer.wire(3)).abort()
            await eventually(lambda: isinstance(client.last_error, OtherRobotError))


async def test_another_robot_at_a_new_address_is_refused() -> None:
    async with Peer() as one, Peer() as two:
        one.info, two.info = info(1), info(2)
        client = one.client()
        told = follow(client)
        async with client:
            wire = await one.wire()
            request = ask(client, Speak())
            frame = await wire.next(SPEAK)
            await client.reconfigure(two.config())
            with pytest.raises(ConnectionLostError):
                await soon(request)
            await eventually(lambda: isinstance(client.last_error, OtherRobotError))
            with pytest.raises(NotConnectedError, match="robot 2 "):
                await client.request(Speak())
            await client.reconfigure(one.config())
            await client.wait_ready(TIMEOUT)
            assert told == ["robot 1", "robot 1"]
            assert frame not in [frame for wire in two.wires for frame in wire.seen]


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
