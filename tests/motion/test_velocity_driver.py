"""Rules for a stream of velocities, tested without ROS."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.link.link_peer import TIMEOUT, Frame, Peer, Wire, aio, eventually, soon, turns
from woosh_robot_agent.link import ChassisClient
from woosh_robot_agent.link.tasks import cancel_and_wait
from woosh_robot_agent.motion import (
    MAX_VELOCITY,
    MotionGate,
    UnusableVelocityError,
    VelocityDriver,
    VelocityLimits,
)
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Follow, Speak, Twist

TWIST = "woosh.robot.Twist"
SPEAK = "woosh.robot.Speak"
LIMITS = VelocityLimits(max_linear=1.0, max_angular=1.0, rate=100.0, timeout=3600.0)
RUNNING = {"robotTaskId": "7", "state": "kExecuting"}


def feedback(state: str) -> Frame:
    """Return the body of a report on a navigation."""
    return {"fbs": [{"action": "woosh.ros.action.MoveBase", "state": state}]}


async def answer_all(wire: Wire, frame: Frame) -> bool:
    answered = (
        TWIST,
        SPEAK,
        "woosh.robot.ActionOrder",
        "woosh.robot.Follow",
        "woosh.ros.CallAction",
    )
    if frame["type"] not in answered:
        return False
    await wire.answer(frame)
    return True


def velocities(wire: Wire) -> list[tuple[float, float, float]]:
    """Return the velocities that the chassis has received: linear, linear_y, angular."""
    return [
        tuple(frame["body"].get(name, 0.0) for name in ("linear", "linearY", "angular"))  # type: ignore[misc]
        for frame in wire.seen
        if frame["type"] == TWIST
    ]


@dataclass
class Rig:
    """A velocity driver, its gate, and the chassis's end of the link."""

    peer: Peer
    wire: Wire
    client: ChassisClient
    gate: MotionGate
    driver: VelocityDriver
    limits: VelocityLimits = LIMITS

    async def sent(self, *expected: tuple[float, float, float]) -> None:
        """Wait until exactly these velocities have reached the chassis."""
        await eventually(lambda: len(velocities(self.wire)) >= len(expected))
        assert velocities(self.wire) == [pytest.approx(each) for each in expected]

    async def settle(self) -> None:
        """Wait until everything that is due now has reached the chassis."""
        await turns()
        assert (await soon(asyncio.ensure_future(self.gate.request(Speak())))).ok


@asynccontextmanager
async def driving(**limits: float) -> AsyncIterator[Rig]:
    async with (
        Peer(script=answer_all) as peer,
        peer.client(backoff_min=0.05, backoff_max=0.05) as client,
    ):
        gate = MotionGate(client)
        rig: Rig
        driver = VelocityDriver(gate, client, "joystick", lambda: rig.limits)
        rig = Rig(peer, await peer.wire(), client, gate, driver)
        rig.limits = replace(LIMITS, **limits)
        running = asyncio.ensure_future(driver.run())
        try:
            yield rig
        finally:
            await cancel_and_wait(running)


@aio
async def test_a_velocity_is_sent() -> None:
    async with driving() as rig:
        rig.driver.drive(0.1, -0.2, 0.3)
        await rig.sent((0.1, -0.2, 0.3))


@aio
async def test_a_velocity_that_is_not_finite_is_refused(caplog: pytest.LogCaptureFixture) -> None:
    async with driving() as rig:
        rig.driver.drive(math.nan, 0.0, 0.0)
        rig.driver.drive(0.1, math.inf, 0.0)
        rig.driver.drive(0.1, 0.0, 0.0)
        await rig.sent((0.1, 0.0, 0.0))
    warned = [each.getMessage() for each in caplog.records if each.levelname == "WARNING"]
    assert len([text for text in warned if "joystick is ignored" in text]) == 1


@aio
async def test_a_velocity_beyond_the_limits_is_scaled_down() -> None:
    async with driving(max_linear=0.5, max_angular=0.2) as rig:
        rig.driver.drive(3.0, 4.0, -9.0)
        await rig.sent((0.3, 0.4, -0.2))


@aio
async def test_a_velocity_that_no_robot_reaches_is_refused(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async with driving() as rig:
        for values in ((3e38, 0.0, 0.0), (1e308, 1e308, 0.0), (0.1, 0.0, -10.5)):
            rig.driver.drive(*values)
        rig.driver.drive(-10.0, 0.0, 0.0)
        await rig.sent((-1.0, 0.0, 0.0))
    assert "joystick is ignored: linear is 3e+38" in caplog.text


@given(
    st.tuples(*3 * [st.floats(width=32)]), st.floats(0, MAX_VELOCITY), st.floats(0, MAX_VELOCITY)
)
def test_each_velocity_is_within_the_limits_or_refused(
    values: tuple[float, float, float], linear: float, angular: float
) -> None:
    velocity = Twist(linear=values[0], linear_y=values[1], angular=values[2])
    limits = replace(LIMITS, max_linear=linear, max_angular=angular)
    if not all(abs(value) <= MAX_VELOCITY for value in values):
        with pytest.raises(UnusableVelocityError, match=r"^(linear|linear_y|angular) is "):
            limits.apply(velocity)
        return
    limited = limits.apply(velocity)
    assert math.hypot(limited.linear, limited.linear_y) <= linear * (1 + 1e-6) + 1e-40
    assert abs(limited.angular) <= angular * (1 + 1e-6) + 1e-40
    if math.hypot(*values[:2]) <= linear and abs(values[2]) <= angular:
        assert limited == velocity


@aio
async def test_only_the_newest_velocity_is_sent_at_the_rate() -> None:
    async with driving(rate=0.001) as rig:
        rig.driver.drive(0.1, 0.0, 0.0)
        await rig.sent((0.1, 0.0, 0.0))
        for speed in (0.2, 0.3, 0.4):
            rig.driver.drive(speed, 0.0, 0.0)
            await rig.settle()
        rig.limits = LIMITS  # their period is over already
        rig.driver.drive(0.5, 0.0, 0.0)
        await rig.sent((0.1, 0.0, 0.0), (0.5, 0.0, 0.0))


@aio
async def test_the_first_zero_is_not_delayed_by_the_rate() -> None:
    async with driving(rate=0.001) as rig:
        rig.driver.drive(0.1, 0.0, 0.0)
        await rig.sent((0.1, 0.0, 0.0))
        rig.driver.drive(0.0, 0.0, 0.0)
        await rig.sent((0.1, 0.0, 0.0), (0.0, 0.0, 0.0))


@aio
async def test_silence_stops_the_robot() -> None:
    async with driving(timeout=0.05) as rig:
        rig.driver.drive(0.1, 0.0, 0.0)
        await rig.sent((0.1, 0.0, 0.0), (0.0, 0.0, 0.0))


@pytest.mark.parametrize("override", [False, True])
@pytest.mark.parametrize(
    ("type_", "runs", "ended"),
    [
        ("woosh.robot.TaskProc", RUNNING, {**RUNNING, "state": "kCompleted"}),
        ("woosh.ros.Feedbacks", feedback("kRosExecuting"), feedback("kRosSuccess")),
    ],
    ids=["task", "action"],
)
@aio
async def test_a_velocity_is_refused_while_a_task_or_action_owns_the_robot_unless_it_may_override(
    type_: str, runs: Frame, ended: Frame, override: bool
) -> None:
    async with driving(override=override) as rig:
        await rig.wire.push(type_, runs)
        await eventually(lambda: rig.gate.owner)
        rig.driver.drive(0.1, 0.0, 0.0)
        if override:
            await rig.sent((0.1, 0.0, 0.0))
        await rig.wire.push(type_, ended)
        await eventually(lambda: not rig.gate.owner)
        rig.driver.drive(0.2, 0.0, 0.0)
        await eventually(lambda: (0.2, 0.0, 0.0) in velocities(rig.wire))
        assert ((0.1, 0.0, 0.0) in velocities(rig.wire)) == override


@aio
async def test_no_zero_follows_the_start_of_another_clients_task() -> None:
    """Neither the sender's zero nor the watchdog's."""
    async with driving() as rig:
        rig.driver.drive(0.1, 0.0, 0.0)
        await rig.sent((0.1, 0.0, 0.0))
        await rig.settle()
        await rig.wire.push("woosh.robot.TaskProc", RUNNING)
        await eventually(lambda: rig.gate.owner)
        rig.driver.drive(0.0, 0.0, 0.0)
        await rig.settle()
        rig.limits = replace(LIMITS, timeout=0.0)
        rig.driver._wake.set()
        await eventually(lambda: not rig.driver._driving)
        await rig.settle()
        await rig.sent((0.1, 0.0, 0.0))


@aio
async def test_no_zero_follows_an_accepted_follow() -> None:
    async with driving() as rig:
        rig.driver.drive(0.1, 0.0, 0.0)
        await rig.sent((0.1, 0.0, 0.0))
        follow = rig.gate.request(Follow(type=True))
        assert (await soon(asyncio.ensure_future(follow))).ok
        rig.driver.drive(0.0, 0.0, 0.0)
        await rig.settle()
        await rig.sent((0.1, 0.0, 0.0))


@aio
async def test_a_velocity_that_overrides_a_task_is_stopped_by_silence() -> None:
    async with driving(override=True, timeout=0.05) as rig:
        await rig.wire.push("woosh.robot.TaskProc", RUNNING)
        await eventually(lambda: rig.gate.owner)
        rig.driver.drive(0.1, 0.0, 0.0)
        await rig.sent((0.1, 0.0, 0.0), (0.0, 0.0, 0.0))


@aio
async def test_zeros_of_an_idle_sender_are_not_sent() -> None:
    async with driving() as rig:
        for _ in range(2):
            rig.driver.drive(0.0, 0.0, 0.0)
            await rig.settle()
        rig.driver.drive(0.1, 0.0, 0.0)
        await rig.sent((0.1, 0.0, 0.0))


async def stop_stream(rig: Rig) -> None:
    """Send a velocity, stop the robot, and send another velocity, which must be refused."""
    rig.driver.drive(0.1, 0.0, 0.0)
    await rig.sent((0.1, 0.0, 0.0))
    assert (await soon(asyncio.ensure_future(rig.gate.stop(TIMEOUT)))).success
    rig.gate._forbidden_until = -math.inf  # the gate itself permits motion again
    rig.driver.drive(0.2, 0.0, 0.0)
    await rig.settle()


@aio
async def test_a_stop_silences_the_stream_until_a_zero() -> None:
    async with driving(rate=1e9) as rig:
        await stop_stream(rig)
        rig.driver.drive(0.0, 0.0, 0.0)
        rig.driver.drive(0.3, 0.0, 0.0)
        await rig.sent((0.1, 0.0, 0.0), (0.0, 0.0, 0.0), (0.3, 0.0, 0.0))


@aio
async def test_a_stop_silences_the_stream_until_a_pause() -> None:
    async with driving(rate=1e9) as rig:
        await stop_stream(rig)
        rig.driver._heard -= 2.0  # as after silence
        rig.driver.drive(0.3, 0.0, 0.0)
        await rig.settle()
        await rig.sent((0.1, 0.0, 0.0), (0.0, 0.0, 0.0), (0.3, 0.0, 0.0))


async def lose_link(rig: Rig) -> None:
    rig.wire.abort()
    await eventually(lambda: rig.client.state.value != "ready")


@pytest.mark.parametrize("owned", [False, True])
@aio
async def test_after_a_lost_link_the_robot_gets_a_zero(owned: bool) -> None:
    async with driving() as rig:
        rig.driver.drive(0.1, 0.0, 0.0)
        await rig.sent((0.1, 0.0, 0.0))
        await lose_link(rig)
        rig.driver.drive(0.2, 0.0, 0.0)  # there is no link, and this must not be sent later
        if owned:
            rig.peer.info = {**(rig.peer.info or {}), "taskProc": RUNNING}
        rig.wire = await rig.peer.wire(2)
        await rig.client.wait_ready(TIMEOUT)
        if owned:
            rig.limits = replace(LIMITS, override=True)
            await eventually(lambda: rig.gate.owner)
            rig.driver.drive(0.3, 0.0, 0.0)
            await rig.sent((0.3, 0.0, 0.0))
        else:
            await rig.sent((0.0, 0.0, 0.0))


@pytest.mark.parametrize("connected", [False, True])
@aio
async def test_a_velocity_without_a_link_is_not_kept(connected: bool) -> None:
    """Neither one that comes without a link, nor one that waits when the link is lost."""
    async with driving(rate=0.001) as rig:
        # the next velocity has to wait for its period
        rig.driver._pace.sent(asyncio.get_running_loop().time(), rig.limits.rate)
        if connected:
            await rig.client.wait_ready(TIMEOUT)
            rig.driver.drive(0.2, 0.0, 0.0)
            assert rig.driver._waiting is not None
        await lose_link(rig)
        if not connected:
            rig.driver.drive(0.2, 0.0, 0.0)
        rig.wire = await rig.peer.wire(2)
        await rig.client.wait_ready(TIMEOUT)
        rig.limits = replace(LIMITS, rate=1e9)
        rig.driver.drive(0.0, 0.0, 0.0)  # not sent, because there is nothing to stop
        await rig.settle()
        assert velocities(rig.wire) == []


@aio
async def test_velocities_that_are_not_permitted_are_refused_and_silence_the_stream() -> None:
    async with driving() as rig:
        rig.client.permit_only(lambda message: isinstance(message, Speak), "it only observes")
        rig.driver.drive(0.1, 0.0, 0.0)
        rig.driver.drive(0.0, 0.0, 0.0)
        rig.driver.drive(0.2, 0.0, 0.0)
        await rig.settle()
        assert not rig.gate.driving
        rig.client.permit_only(None)
        rig.driver.drive(0.3, 0.0, 0.0)
        await rig.settle()
        assert velocities(rig.wire) == []
        rig.driver.drive(0.0, 0.0, 0.0)
        rig.driver.drive(0.4, 0.0, 0.0)
        await rig.sent((0.4, 0.0, 0.0))
