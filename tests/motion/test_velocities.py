"""Velocities: the newest one wins, a stale one is not sent, and a zero always is."""

from __future__ import annotations

import asyncio
import logging
import re
import time
from dataclasses import dataclass, replace
from typing import Any

import pytest

from tests.link.link_peer import INFO, Frame, Wire, block, eventually, soon, turns
from tests.motion.gate_checks import (
    NEVER,
    TWIST,
    Rig,
    answer_all,
    answer_nothing,
    gated,
    ok,
    speeds,
    types,
)
from tests.motion.moving import MOVING
from woosh_robot_agent.link import (
    RequestTimeoutError,
    SupersededError,
)
from woosh_robot_agent.motion import MotionTiming, Sender, timeliness
from woosh_robot_agent.motion.timeliness import SenderClock, StallWatch
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Speak, Twist

SPEAK = "woosh.robot.Speak"


async def ended(*tasks: asyncio.Task[Any]) -> None:
    for task in tasks:
        task.cancel()
    await asyncio.wait(tasks)


# The newest one wins


async def stalled(rig: Rig) -> tuple[asyncio.Task[Any], Frame]:
    """Send one velocity, and hold back those that come before its answer; return task and frame."""
    rig.gate.timing = MotionTiming(**{**vars(rig.gate.timing), "unanswered": 0.0})
    first = rig.drive(1)
    return first, await rig.wire.next(TWIST)


async def test_commands_and_other_requests_in_flight_do_not_limit_each_other() -> None:
    async with gated(answer_nothing, {"max_in_flight": 1}) as rig:
        unanswered = [rig.drive(speed) for speed in (1, 2, 3)]
        for _ in unanswered:
            await rig.wire.next(TWIST)
        waiting = asyncio.ensure_future(rig.client.request(Speak()))
        frame = await rig.wire.next(SPEAK)
        task = rig.drive(4)
        await rig.wire.answer(await rig.wire.next(TWIST))
        assert (await soon(task)).ok
        await rig.wire.answer(frame)
        assert (await soon(waiting)).ok
        await ended(*unanswered)


async def test_while_the_chassis_does_not_answer_only_the_newest_is_held(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.INFO, "woosh_robot_agent.motion")
    async with gated(answer_nothing) as rig:
        first, frame = await stalled(rig)
        *replaced, newest = [rig.drive(speed) for speed in (2, 3, 4, 5)]
        for task in replaced:
            with pytest.raises(SupersededError, match="a newer velocity command"):
                await soon(task)
        await rig.wire.answer(frame)
        assert (await soon(first)).ok
        await rig.wire.answer(await rig.wire.next(TWIST))
        assert (await soon(newest)).ok
        assert speeds(rig.wire) == [1, 5]
        assert rig.gate.superseded == 3
    told = [each.levelno for each in caplog.records if "not sent" in each.getMessage()]
    assert told == [logging.WARNING], "only the first one"


async def test_a_command_held_too_long_is_not_sent() -> None:
    async with gated(answer_nothing) as rig:
        first, frame = await stalled(rig)
        rig.gate.timing = MotionTiming(max_age=0.1, unanswered=0.0)
        with pytest.raises(SupersededError, match="too old"):
            await soon(rig.drive(2))
        await rig.wire.answer(frame)
        await soon(first)
        await turns()
        assert speeds(rig.wire) == [1]


@pytest.mark.parametrize("stop", [Twist(), Twist(linear=-0.0)])
async def test_a_stop_is_never_held(stop: Twist) -> None:
    async with gated(answer_nothing) as rig:
        first, _ = await stalled(rig)
        held = rig.drive(2)
        await turns()
        stopping = asyncio.ensure_future(rig.gate.request(stop))
        frame = await rig.wire.next(TWIST)
        assert not first.done()  # its answer would release a held velocity
        with pytest.raises(SupersededError):
            await soon(held)
        await rig.wire.answer(frame)
        assert (await soon(stopping)).ok
        await ended(first)
        assert speeds(rig.wire) == [1, 0]


async def test_no_older_command_overtakes_a_stop_even_when_released_just_before() -> None:
    async with gated(answer_nothing) as rig:
        first, frame = await stalled(rig)
        held = rig.drive(2)
        await turns()
        stopping: list[asyncio.Task[Any]] = []

        def stop(_answered: object) -> None:  # the answer has just released the held velocity
            if not stopping:
                stopping.append(asyncio.ensure_future(rig.gate.request(Twist())))

        rig.gate.on_answered(stop)
        await rig.wire.answer(frame)
        await soon(first)
        with pytest.raises(SupersededError):
            await soon(held)
        await rig.wire.answer(await rig.wire.next(TWIST))
        assert (await soon(stopping[0])).ok
        assert speeds(rig.wire) == [1, 0]


async def test_cancelling_a_held_command_passes_through_and_it_is_not_sent() -> None:
    async with gated(answer_nothing) as rig:
        first, frame = await stalled(rig)
        held = rig.drive(2)
        await turns()
        rig.gate.on_answered(lambda _: held.cancel())  # just after it was released
        await rig.wire.answer(frame)
        await soon(first)
        with pytest.raises(asyncio.CancelledError):
            await held
        await turns()
        assert speeds(rig.wire) == [1]


async def test_a_command_that_waited_for_a_busy_connection_is_not_sent_late() -> None:
    async with gated(answer_nothing, max_age=0.1) as rig:
        upload = await block(rig.client, rig.wire)
        loop = asyncio.get_running_loop()
        stale = rig.drive(1)
        stop = asyncio.ensure_future(rig.gate.request(Twist()))
        await turns()
        sent = loop.time()
        await eventually(lambda: loop.time() > sent + 0.1)
        assert not stale.done()
        rig.wire.thaw()
        with pytest.raises(SupersededError, match="too old"):
            await soon(stale)
        await rig.wire.answer(await rig.wire.next(TWIST))
        assert (await soon(stop)).ok
        assert speeds(rig.wire) == [0]
        await ended(upload)


async def test_the_callers_timeout_applies_to_commands_which_hold_back_nothing_afterwards() -> None:
    async with gated(answer_nothing, unanswered=0.0) as rig:
        with pytest.raises(RequestTimeoutError, match=r"0\.03 s"):
            await soon(rig.drive(1, timeout=0.03))
        await rig.wire.next(TWIST)
        task = rig.drive(2)
        await rig.wire.answer(await rig.wire.next(TWIST))
        assert (await soon(task)).ok


# The age of a velocity


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


@dataclass
class RemoteSender:
    """Sends messages to this computer, by a clock that is some seconds ahead."""

    clock: Clock
    ahead: float

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
    assert sender.age(ages) == pytest.approx(0.0, abs=2e-3)
    clock.monotonic_now += 3.0
    assert sender.age(ages, network=2.501) == pytest.approx(2.5, abs=1e-5)
    assert sender.age(ages, network=0.501, queue=1.0) == pytest.approx(1.5, abs=1e-5)
    assert sender.age(ages) == pytest.approx(0.0, abs=1e-5)


@pytest.mark.parametrize("ahead", [0.0, 0.5])
def test_the_first_message_may_be_a_late_one(clock: Clock, ahead: float) -> None:
    ages, sender = SenderClock(), RemoteSender(clock, ahead)
    assert sender.age(ages, network=3.0) == pytest.approx(3.0 - ahead, abs=1e-5)
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


def sent(seconds: float, **options: float) -> Sender:
    """Return the sender of a command that was published some seconds ago."""
    published = asyncio.get_running_loop().time() - seconds
    return Sender(published=published, **options)  # type: ignore[arg-type]


async def test_an_old_velocity_is_not_sent_and_is_counted() -> None:
    async with gated(max_age=0.5) as rig:
        with pytest.raises(SupersededError, match=r"2\.\d\d s old"):
            await soon(rig.drive(2, sender=sent(2.0)))
        assert rig.gate.superseded == 1
        assert not rig.gate.driving
        with pytest.raises(SupersededError, match=r"0\.1 s are allowed"):
            await soon(rig.drive(3, sender=sent(0.2, max_age=0.1)))
        await ok(rig.gate.request(Twist(), sender=sent(60.0, max_age=0.1)))
        await ok(rig.drive(4, sender=sent(0.01)))
        assert speeds(rig.wire) == [0, 4]


async def test_each_reason_for_which_velocities_are_not_sent_is_logged(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async with gated(max_age=0.5) as rig:
        for age in (2.0, 3.0):
            with pytest.raises(SupersededError):
                await soon(rig.drive(2, sender=sent(age)))
        rig.gate.announce_stop()
        for _ in range(2):
            with pytest.raises(SupersededError):
                await soon(rig.drive(2, sender=sent(0.01)))
    warnings = [each.getMessage() for each in caplog.records if each.levelno == logging.WARNING]
    told = [each for each in warnings if "not sent" in each]
    assert len(told) == 2
    assert re.search(r"2\.\d\d s old", told[0])
    assert "stop" in told[1]


async def test_an_old_velocity_does_not_replace_a_newer_one_that_waits() -> None:
    async with gated(answer_nothing, max_age=60.0) as rig:
        first, frame = await stalled(rig)
        newer = rig.drive(2)
        await turns()
        with pytest.raises(SupersededError, match="old"):
            await soon(rig.drive(3, sender=sent(70.0)))
        await rig.wire.answer(frame)
        await rig.wire.answer(await rig.wire.next(TWIST))
        assert (await soon(first)).ok
        assert (await soon(newer)).ok
        assert speeds(rig.wire) == [1, 2]


# Stalls


def hold_up() -> None:
    """Keep the event loop from running for longer than a stall."""
    time.sleep(MotionTiming().stall + 0.3)


async def settled(rig: Rig, request_: Any) -> None:
    """Send a new command once the time after a stall is over; a busy machine may stall again."""
    while True:
        await asyncio.sleep(rig.gate.timing.settle)
        try:
            await ok(asyncio.ensure_future(rig.gate.request(request_, sender=sent(0.0))))
        except SupersededError:
            continue
        return


async def test_what_arrived_during_a_stall_moves_nothing() -> None:
    async with gated() as rig:
        await asyncio.sleep(0)
        hold_up()
        usual, rig.gate.timing = rig.gate.timing, replace(rig.gate.timing, settle=NEVER)
        for request in MOVING:
            for seconds in (0.2, 0.0):
                with pytest.raises(SupersededError, match="stood still for"):
                    await soon(rig.gate.request(request, sender=sent(seconds)))
        assert types(rig.wire) == []
        for request in MOVING:  # of this process, e.g. of an order that goes on
            await ok(rig.gate.request(request))
        rig.gate.timing = usual
        await settled(rig, MOVING[0])


async def test_a_stall_is_noticed_wherever_it_lies_between_two_heartbeats() -> None:
    async with gated() as rig:
        rig.gate.timing = replace(rig.gate.timing, stall=0.3)
        for delay in (0.0, 0.05, 0.1, 0.15):
            await settled(rig, Twist(linear=1))
            await asyncio.sleep(delay)
            time.sleep(0.31)
            with pytest.raises(SupersededError, match="stood still for"):
                await soon(rig.drive(2, sender=sent(0.0)))


async def test_a_suspension_of_the_computer_is_a_stall(monkeypatch: pytest.MonkeyPatch) -> None:
    """The monotonic time stands still meanwhile."""
    clock = time.clock_gettime
    async with gated() as rig:
        await asyncio.sleep(0)
        monkeypatch.setattr(time, "clock_gettime", lambda which: clock(which) + 60.0)
        with pytest.raises(SupersededError, match="stood still for 60"):
            await soon(rig.drive(1, sender=sent(0.0)))


async def test_a_stall_while_the_link_is_being_made_counts() -> None:
    """Otherwise a command of that time would be executed as soon as the link is ready."""

    async def script(wire: Wire, frame: Frame) -> bool:
        if frame["type"] != INFO:
            return await answer_all(wire, frame)
        await wire.answer(frame)
        if len(wire.peer.wires) > 1:
            hold_up()  # the answer arrives meanwhile
        return True

    async with gated(script) as rig:
        rig.wire.abort()
        await rig.second_wire()
        with pytest.raises(SupersededError, match="stood still for"):
            await soon(rig.drive(1, sender=sent(0.2)))


async def test_a_stall_counts_that_ends_with_the_loss_of_the_link() -> None:
    watch = StallWatch(MotionTiming)
    watch.start()
    hold_up()
    watch.stop()
    assert watch.is_from_before(time.monotonic())


async def test_a_stall_while_the_link_is_lost_counts() -> None:
    """The link may be ready before the middleware delivers the commands of that time."""
    async with gated(link={"backoff_min": 1.0, "backoff_max": 1.0}, settle=NEVER) as rig:
        rig.wire.abort()
        await eventually(lambda: rig.client.state.value == "waiting")
        hold_up()
        await rig.second_wire()
        with pytest.raises(SupersededError, match="stood still for"):
            await soon(rig.drive(1, sender=sent(0.0)))
