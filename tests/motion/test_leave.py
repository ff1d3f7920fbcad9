"""The gate when the link is about to be closed, or the agent begins to observe only."""

from __future__ import annotations

import asyncio

import pytest

from tests.link.link_peer import TIMEOUT, Frame, Peer, Wire, aio, eventually, soon, turns
from tests.motion.gate_checks import TWIST, answer_all, ok, types
from tests.motion.moving import MOVING
from woosh_robot_agent.link import LinkState, NotPermittedError, SupersededError
from woosh_robot_agent.motion import MotionGate
from woosh_robot_agent.motion.requests import only_reads
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Twist

pytestmark = pytest.mark.usefixtures("long_drive")
REASON = "the settings of the link have changed"


@pytest.mark.parametrize("drove", [False, True])
@aio
async def test_a_robot_gets_its_zero_if_it_may_drive(drove: bool) -> None:
    async with Peer(script=answer_all) as peer, peer.client() as client:
        gate = MotionGate(client)
        if drove:
            await ok(gate.request(Twist(linear=1)))
        await gate.leave(REASON, TIMEOUT)
        wire = await peer.wire()
        assert types(wire) == [TWIST, TWIST] * drove
        assert all("linear" not in frame["body"] for frame in wire.seen[-1:] if drove)
        assert not gate.driving


@aio
async def test_no_velocity_follows_the_zero() -> None:
    async def answer_velocities(wire: Wire, frame: Frame) -> bool:
        is_zero = frame["type"] == TWIST and "linear" not in frame["body"]
        return is_zero or await answer_all(wire, frame)

    async with Peer(script=answer_velocities) as peer, peer.client() as client:
        gate = MotionGate(client)
        await ok(gate.request(Twist(linear=1)))
        leaving = asyncio.ensure_future(gate.leave(REASON, TIMEOUT))
        await turns()
        with pytest.raises(SupersededError, match=REASON):
            await gate.request(Twist(linear=3))
        wire = await peer.wire()
        zero = next(f for f in wire.seen if f["type"] == TWIST and "linear" not in f["body"])
        await wire.answer(zero)
        await soon(leaving)
        speeds = [frame["body"].get("linear") for frame in wire.seen if frame["type"] == TWIST]
        assert speeds == [1, None]


@pytest.mark.parametrize("refused", [False, True])
@aio
async def test_a_robot_that_cannot_be_stopped_is_an_error(
    refused: bool, caplog: pytest.LogCaptureFixture
) -> None:
    async def refuse_zero(wire: Wire, frame: Frame) -> bool:
        if frame["type"] == TWIST and "linear" not in frame["body"] and refused:
            await wire.answer(frame, ok=False, msg="no speed control")
            return True
        return await answer_all(wire, frame)

    async with (
        Peer(script=refuse_zero) as peer,
        peer.client(backoff_min=60.0, backoff_max=60.0) as client,
    ):
        gate = MotionGate(client)
        await ok(gate.request(Twist(linear=1)))
        if not refused:
            (await peer.wire()).abort()
            await eventually(lambda: client.state is not LinkState.READY)
        await gate.leave(REASON, TIMEOUT)
        (record,) = [each for each in caplog.records if each.levelname == "ERROR"]
        assert "the robot was not stopped" in record.getMessage()
        assert ("no speed control" if refused else "not connected") in record.getMessage()


@aio
async def test_a_robot_that_is_only_observed_from_now_on_gets_its_zero_and_no_other_command() -> (
    None
):
    async with Peer(script=answer_all) as peer, peer.client() as client:
        gate = MotionGate(client)
        await ok(gate.request(Twist(linear=1)))
        client.permit_only(only_reads, "it only observes")
        await gate.leave("it only observes", TIMEOUT)
        for request in (*MOVING, Twist()):
            with pytest.raises(NotPermittedError, match="it only observes"):
                await gate.request(request)
        assert not gate.driving, "a refused velocity does not drive"
        report = await gate.stop(TIMEOUT)
        assert not report.success
        assert "it only observes" in report.message
        await gate.close(TIMEOUT)
        assert types(await peer.wire()) == [TWIST, TWIST]
