"""The gate when the link turns to another robot, or begins to observe only."""

from __future__ import annotations

import asyncio

import pytest

from tests.link.link_peer import TIMEOUT, Frame, Peer, Wire, aio, block, eventually, soon, turns
from tests.motion.gate_checks import TWIST, answer_all, ok, types
from tests.motion.moving import MOVING
from woosh_robot_agent.link import ChassisClient, LinkError, LinkState, NotPermittedError
from woosh_robot_agent.motion import MotionGate
from woosh_robot_agent.motion.requests import only_reads
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Twist


async def turn_to(client: ChassisClient, gate: MotionGate, peer: Peer) -> None:
    """Turn a client to another robot, as the agent does."""
    await client.reconfigure(peer.config(), gate.farewell(TIMEOUT))
    await client.wait_ready(TIMEOUT)


@pytest.mark.parametrize("drove", [False, True])
@pytest.mark.usefixtures("long_drive")
@aio
async def test_a_robot_that_is_left_gets_its_zero_if_it_may_drive(drove: bool) -> None:
    async with (
        Peer(script=answer_all) as one,
        Peer(script=answer_all) as two,
        one.client() as client,
    ):
        gate = MotionGate(client)
        if drove:
            await ok(gate.request(Twist(linear=1)))
        await turn_to(client, gate, two)
        wire = await one.wire()
        assert types(wire) == [TWIST, TWIST] * drove
        assert all("linear" not in frame["body"] for frame in wire.seen[-1:] if drove)
        assert not gate.driving
        await gate.close(TIMEOUT)
        assert types(await two.wire()) == []


@pytest.mark.usefixtures("long_drive")
@aio
async def test_no_velocity_follows_the_zero_of_a_robot_that_is_left() -> None:
    async with Peer(script=answer_all) as one, Peer() as two, one.client() as client:
        gate = MotionGate(client)
        wire = await one.wire()
        await ok(gate.request(Twist(linear=1)))
        load = await block(client, wire)
        waiting = asyncio.ensure_future(gate.request(Twist(linear=2)))
        await turns()
        turning = asyncio.ensure_future(turn_to(client, gate, two))
        await turns()
        late = asyncio.ensure_future(gate.request(Twist(linear=3)))
        for each in (load, waiting, late):
            with pytest.raises(LinkError):
                await soon(each)
        wire.thaw()
        await soon(turning)
        speeds = [frame["body"].get("linear") for frame in wire.seen if frame["type"] == TWIST]
        assert speeds == [1, None]


@pytest.mark.parametrize("refused", [False, True])
@pytest.mark.usefixtures("long_drive")
@aio
async def test_a_robot_that_is_left_and_cannot_be_stopped_is_an_error(
    refused: bool, caplog: pytest.LogCaptureFixture
) -> None:
    async def refuse_zero(wire: Wire, frame: Frame) -> bool:
        if frame["type"] == TWIST and "linear" not in frame["body"] and refused:
            await wire.answer(frame, ok=False, msg="no speed control")
            return True
        return await answer_all(wire, frame)

    async with (
        Peer(script=refuse_zero) as one,
        Peer() as two,
        one.client(backoff_min=60.0, backoff_max=60.0) as client,
    ):
        gate = MotionGate(client)
        await ok(gate.request(Twist(linear=1)))
        if not refused:
            (await one.wire()).abort()
            await eventually(lambda: client.state is not LinkState.READY)
        await turn_to(client, gate, two)
        (record,) = [each for each in caplog.records if each.levelname == "ERROR"]
        assert f"ws://127.0.0.1:{one.port} was not stopped" in record.getMessage()
        assert ("no speed control" if refused else "not connected") in record.getMessage()


@pytest.mark.usefixtures("long_drive")
@aio
async def test_a_robot_that_is_only_observed_from_now_on_gets_its_zero_and_no_other_command() -> (
    None
):
    async with Peer(script=answer_all) as peer, peer.client() as client:
        gate = MotionGate(client)
        await ok(gate.request(Twist(linear=1)))
        stop = gate.farewell(TIMEOUT)
        client.permit_only(only_reads, "it only observes")
        assert stop is not None
        await soon(asyncio.ensure_future(stop()))
        for request in (*MOVING, Twist()):
            with pytest.raises(NotPermittedError, match="it only observes"):
                await gate.request(request)
        assert not gate.driving, "a refused velocity does not drive"
        report = await gate.stop(TIMEOUT)
        assert not report.success
        assert "it only observes" in report.message
        await gate.close(TIMEOUT)
        assert types(await peer.wire()) == [TWIST, TWIST]


@aio
async def test_the_task_of_a_former_robot_does_not_own_the_wheels() -> None:
    running = {"taskProc": {"robotTaskId": "7", "state": "kExecuting"}}
    async with Peer(info=running) as one, Peer() as two:
        client = one.client()
        gate = MotionGate(client)
        async with client:
            await eventually(lambda: gate.owner == "task 7")
            changing = asyncio.ensure_future(client.reconfigure(two.config()))
            await turns(1)
            assert gate.owner == ""
            await changing
