"""A velocity is not sent late, whatever it waited for, and a stall moves nothing."""

from __future__ import annotations

import asyncio
import time
from dataclasses import dataclass
from typing import Any

import pytest

from tests.link.link_peer import Peer, Wire, aio, eventually, soon
from tests.motion.gate_checks import TWIST, answer_all, every_moving_request, ok, types
from woosh_robot_agent.link import SupersededError
from woosh_robot_agent.motion import MotionGate, Sender, VelocityDriver, VelocityLimits, timeliness
from woosh_robot_agent.motion.timeliness import SenderClock
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Twist


def speeds(wire: Wire) -> list[float]:
    return [frame["body"].get("linear", 0) for frame in wire.seen if frame["type"] == TWIST]


def ago(seconds: float) -> float:
    """Return a loop time in the past."""
    return asyncio.get_running_loop().time() - seconds


def hold_up() -> None:
    """Keep the event loop from running for longer than a stall."""
    time.sleep(timeliness.STALL + 0.3)


# Ages


@dataclass
class Clock:
    """The clocks of this computer."""

    monotonic_now: float = 1000.0
    ahead: float = 5e8

    def monotonic(self) -> float:
        return self.monotonic_now

    def time(self) -> float:
        return self.monotonic_now + self.ahead


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(timeliness, "time", clock)
    return clock


class RemoteSender:
    """Sends messages to this computer, by a clock of its own."""

    def __init__(self, clock: Clock, ahead: float) -> None:
        self.clock = clock
        self.ahead = ahead

    def age(self, ages: SenderClock, network: float = 0.001, queue: float = 0.0) -> float:
        """Return the age that is found for a message that was under way for some time."""
        now = self.clock.monotonic_now
        received = now - queue
        unix = received + self.clock.ahead
        sent = received - network + self.clock.ahead + self.ahead
        return now - ages.published(sent, unix, now)


@pytest.mark.parametrize("ahead", [0.0, 3600.0, -3600.0])
def test_a_late_message_is_as_old_as_it_is_later_than_the_quickest(
    clock: Clock, ahead: float
) -> None:
    ages, sender = SenderClock(), RemoteSender(clock, ahead)
    assert sender.age(ages) == pytest.approx(0.0, abs=1e-5)
    clock.monotonic_now += 3.0
    assert sender.age(ages, network=2.501) == pytest.approx(2.5, abs=1e-5)
    assert sender.age(ages, network=0.501, queue=1.0) == pytest.approx(1.5, abs=1e-5)
    assert sender.age(ages) == pytest.approx(0.0, abs=1e-5)


def test_a_long_pause_of_the_sender_teaches_nothing(clock: Clock) -> None:
    ages, sender = SenderClock(), RemoteSender(clock, -7.0)
    sender.age(ages)
    clock.monotonic_now += 3600.0
    assert sender.age(ages, network=4.001) == pytest.approx(4.0, abs=1e-5)


def test_the_wait_in_this_process_counts_even_for_the_first_message(clock: Clock) -> None:
    assert RemoteSender(clock, 100.0).age(SenderClock(), queue=2.0) == pytest.approx(2.0, abs=1e-5)


def test_a_sender_whose_clock_was_set_back_is_old_for_a_while_only(clock: Clock) -> None:
    ages, sender = SenderClock(), RemoteSender(clock, 0.0)
    sender.age(ages)
    sender.ahead = -30.0
    found = []
    for _ in range(25):
        clock.monotonic_now += 1.0
        found.append(sender.age(ages))
    assert found[0] == pytest.approx(30.0, abs=1e-5)
    assert found[-1] == pytest.approx(0.0, abs=1e-5)


@pytest.mark.parametrize(("source", "received"), [(0.0, 0.0), (0.0, 5e8 + 998.0)])
def test_a_middleware_without_source_times(clock: Clock, source: float, received: float) -> None:
    published = SenderClock().published(source, received, clock.monotonic_now)
    assert published == pytest.approx(998.0 if received else 1000.0, abs=1e-5)


# Old velocities


@aio
async def test_an_old_velocity_is_not_sent_and_is_counted() -> None:
    async with Peer(script=answer_all) as peer, peer.client() as client:
        gate, wire = MotionGate(client), await peer.wire()
        with pytest.raises(SupersededError, match=r"2\.00 s old"):
            await soon(gate.request(Twist(linear=0.2), sender=Sender(published=ago(2.0))))
        assert gate.superseded == 1
        assert not gate.driving
        await ok(gate.request(Twist(linear=0.3), sender=Sender(published=ago(0.01))))
        assert speeds(wire) == [pytest.approx(0.3)]


@aio
async def test_a_shorter_limit_holds() -> None:
    async with Peer(script=answer_all) as peer, peer.client() as client:
        gate, wire = MotionGate(client), await peer.wire()
        with pytest.raises(SupersededError, match=r"0\.1 s are allowed"):
            await soon(
                gate.request(Twist(linear=0.2), sender=Sender(published=ago(0.2), max_age=0.1))
            )
        await ok(gate.request(Twist(), sender=Sender(published=ago(60.0), max_age=0.1)))
        assert speeds(wire) == [0]


@aio
async def test_an_old_velocity_does_not_replace_a_newer_one_that_waits() -> None:
    async with Peer() as peer, peer.client() as client:
        gate, wire = MotionGate(client), await peer.wire()
        first = asyncio.ensure_future(gate.request(Twist(linear=0.1)))
        frame = await wire.next(TWIST)
        for serial in gate._velocities._unanswered:  # unanswered for so long that the next waits
            gate._velocities._unanswered[serial] -= 1.0
        newer = asyncio.ensure_future(gate.request(Twist(linear=0.2)))
        await eventually(lambda: gate._velocities._held)
        with pytest.raises(SupersededError, match="old"):
            await soon(gate.request(Twist(linear=0.3), sender=Sender(published=ago(2.0))))
        await wire.answer(frame)
        await wire.answer(await wire.next(TWIST))
        assert (await soon(first)).ok
        assert (await soon(newer)).ok
        assert speeds(wire) == [pytest.approx(0.1), pytest.approx(0.2)]


def driver_of(gate: MotionGate, client: Any, **limits: float) -> VelocityDriver:
    values = VelocityLimits(max_linear=1.0, max_angular=1.0, rate=100.0, timeout=0.5)
    return VelocityDriver(
        gate, client, "stream", lambda: VelocityLimits(**{**values.__dict__, **limits})
    )


@pytest.mark.parametrize("limits", [{}, {"timeout": 0.2}, {"max_age": 0.2}])
@aio
async def test_an_old_velocity_of_a_stream_does_not_drive(limits: dict[str, float]) -> None:
    async with Peer(script=answer_all) as peer, peer.client() as client:
        gate, wire = MotionGate(client), await peer.wire()
        driver = driver_of(gate, client, **limits)
        driver.drive(0.2, 0.0, 0.0, published=ago(0.3 if limits else 0.6))
        assert gate.superseded == 1
        driver.drive(0.3, 0.0, 0.0, published=ago(0.01))
        await eventually(lambda: speeds(wire))
        assert speeds(wire) == [pytest.approx(0.3)]


@aio
async def test_silence_counts_from_when_the_last_velocity_was_published() -> None:
    async with Peer(script=answer_all) as peer, peer.client() as client:
        gate, wire = MotionGate(client), await peer.wire()
        driver = driver_of(gate, client)
        driver.drive(0.2, 0.0, 0.0, published=ago(0.3))
        assert driver._due() <= asyncio.get_running_loop().time() + 0.2
        await eventually(lambda: speeds(wire))


# Stalls


@every_moving_request
@aio
async def test_what_arrived_during_a_stall_moves_nothing(request_: Any) -> None:
    async with Peer(script=answer_all) as peer, peer.client() as client:
        gate, wire = MotionGate(client), await peer.wire()
        await asyncio.sleep(0)
        hold_up()
        for published in (ago(0.2), ago(0.0)):
            with pytest.raises(SupersededError, match=r"stood still for|old"):
                await soon(gate.request(request_, sender=Sender(published=published)))
        assert types(wire) == []
        await ok(gate.request(request_))  # of this process, for example of an order that goes on
        await asyncio.sleep(timeliness.SETTLE)
        await ok(gate.request(request_, sender=Sender(published=ago(0.0))))


@aio
async def test_a_stall_without_a_link_ends_before_the_next_link() -> None:
    async with Peer(script=answer_all) as peer:
        client = peer.client()
        gate = MotionGate(client)
        hold_up()
        async with client:
            await ok(gate.request(Twist(linear=0.1), sender=Sender(published=ago(0.0))))


# Stops


@aio
async def test_an_announced_stop_overtakes_what_waits_for_the_event_loop() -> None:
    async with Peer(script=answer_all) as peer, peer.client() as client:
        gate, wire = MotionGate(client), await peer.wire()
        gate.announce_stop()  # in another thread, while velocities wait for the event loop
        with pytest.raises(SupersededError, match="cancelled by a stop"):
            await soon(gate.request(Twist(linear=0.2), sender=Sender(published=ago(0.01))))
        report = await soon(gate.stop(1.0))
        assert report.success
        assert speeds(wire) == [0]
