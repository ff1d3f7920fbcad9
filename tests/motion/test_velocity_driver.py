"""Rules for a stream of velocities, tested without ROS."""

from __future__ import annotations

import asyncio
import itertools
import logging
import math
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import replace

import pytest

from tests.link.link_peer import INFO, TIMEOUT, Frame, Wire, block, eventually, soon, turns
from tests.motion.gate_checks import (
    NEVER,
    RUNNING,
    TWIST,
    Rig,
    answer_all,
    feedback,
    gated,
    ok,
    speeds,
)
from woosh_robot_agent.link import LinkState
from woosh_robot_agent.link.tasks import cancel_and_wait
from woosh_robot_agent.motion import (
    MAX_VELOCITY,
    UnusableVelocityError,
    VelocityDriver,
    VelocityLimits,
)
from woosh_robot_agent.motion.velocity_driver import Pace
from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Follow, Speak, Twist

LIMITS = VelocityLimits(max_linear=1.0, max_angular=1.0, rate=100.0, timeout=NEVER)


class Stream:
    """A velocity driver, whose limits the test may replace."""

    def __init__(self, rig: Rig, limits: VelocityLimits) -> None:
        self.rig = rig
        self.gate = rig.gate
        self.limits = limits
        self.driver = VelocityDriver(rig.gate, rig.client, "joystick", lambda: self.limits)

    def drive(
        self, linear: float, sideways: float = 0.0, angular: float = 0.0, age: float = 0.0
    ) -> None:
        """Process a velocity that was published some seconds ago."""
        published = asyncio.get_running_loop().time() - age
        self.driver.drive(linear, sideways, angular, published)

    async def sent(self, *expected: float) -> None:
        """Wait until exactly these speeds ahead have reached the chassis."""
        await eventually(lambda: len(speeds(self.rig.wire)) >= len(expected))
        assert speeds(self.rig.wire) == pytest.approx(list(expected))

    async def settle(self) -> None:
        """Wait until everything that is due now has reached the chassis."""
        await turns()
        await ok(self.gate.request(Speak(), TIMEOUT))

    async def task_runs(self) -> None:
        """Let another client of the chassis start a task."""
        await self.rig.wire.push("woosh.robot.TaskProc", RUNNING)
        await eventually(lambda: self.gate.owner)


@asynccontextmanager
async def driving(
    script: Callable[[Wire, Frame], Awaitable[bool]] = answer_all,
    hold: float = NEVER,
    link: dict[str, float] | None = None,
    **limits: float,
) -> AsyncIterator[Stream]:
    async with gated(script, link, hold=hold) as rig:
        stream = Stream(rig, replace(LIMITS, **limits))  # type: ignore[arg-type]
        running = asyncio.ensure_future(stream.driver.run())
        try:
            yield stream
        finally:
            await cancel_and_wait(running)


async def test_a_velocity_that_no_robot_reaches_is_refused(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async with driving() as stream:
        for values in ((3e38,), (math.nan,), (0.1, math.inf), (1e308, 1e308), (0.1, 0.0, -10.5)):
            stream.drive(*values)
        stream.drive(-10.0)
        await stream.sent(-1.0)
    warned = [each.getMessage() for each in caplog.records if each.levelname == "WARNING"]
    (refused,) = [text for text in warned if "joystick is ignored" in text]
    assert "linear is 3e+38" in refused


SPEEDS = (0.0, 1e-45, -1e-3, 0.5, -0.7, MAX_VELOCITY, -MAX_VELOCITY, 3e38, -math.inf, math.nan)
"""Components of velocities, some of which no robot reaches."""


@pytest.mark.parametrize("linear", [0.0, 1e-3, 0.6, MAX_VELOCITY])
def test_each_velocity_is_within_the_limits_or_refused(linear: float) -> None:
    for x, y, turn, angular in itertools.product(SPEEDS, SPEEDS, SPEEDS, (0.0, 0.6, MAX_VELOCITY)):
        velocity = Twist(linear=x, linear_y=y, angular=turn)
        limits = replace(LIMITS, max_linear=linear, max_angular=angular)
        if not all(abs(value) <= MAX_VELOCITY for value in (x, y, turn)):
            with pytest.raises(UnusableVelocityError, match=r"^(linear|linear_y|angular) is "):
                limits.apply(velocity)
            continue
        limited = limits.apply(velocity)
        assert math.hypot(limited.linear, limited.linear_y) <= linear * (1 + 1e-6) + 1e-40
        assert abs(limited.angular) <= angular * (1 + 1e-6) + 1e-40
        if math.hypot(velocity.linear, velocity.linear_y) <= linear and abs(turn) <= angular:
            assert limited == velocity


async def test_a_velocity_that_the_limits_reduce_to_zero_stops_nothing_but_the_stream() -> None:
    """Zeros at the rate would stop a robot that another client drives."""
    async with driving(max_angular=0.0) as stream:
        for _ in range(3):
            stream.drive(0.0, angular=0.5)
            stream.drive(1e-50)  # zero as a float32
            await stream.settle()
        stream.drive(0.1)
        for _ in range(3):
            stream.drive(0.0, angular=0.5)
            await stream.settle()
        await stream.sent(0.1, 0.0)


async def test_only_the_newest_velocity_is_sent_at_the_rate() -> None:
    async with driving(rate=0.001) as stream:
        stream.drive(0.1)
        await stream.sent(0.1)
        for speed in (0.2, 0.3, 0.4):
            stream.drive(speed)
            await stream.settle()
        stream.limits = LIMITS  # their period is over already
        stream.drive(0.5)
        await stream.sent(0.1, 0.5)


async def test_the_first_zero_is_not_delayed_by_the_rate_and_not_repeated() -> None:
    async with driving(rate=0.001) as stream:
        stream.drive(0.1)
        await stream.sent(0.1)
        stream.drive(0.0)
        await stream.sent(0.1, 0.0)
        stream.drive(0.0)
        await stream.settle()
        await stream.sent(0.1, 0.0)


async def test_zeros_in_between_do_not_exceed_the_rate() -> None:
    async with driving(rate=20.0) as stream:
        loop = asyncio.get_running_loop()
        begun = loop.time()
        while loop.time() < begun + 0.5:
            for speed in (0.1, 0.0):
                stream.drive(speed)
                await asyncio.sleep(0.005)
        lasted = loop.time() - begun
        await stream.settle()
        assert len(speeds(stream.rig.wire)) < 3 * 20.0 * lasted, "zeros are sent at once"


async def test_only_the_first_of_the_unanswered_velocities_is_a_warning(
    caplog: pytest.LogCaptureFixture,
) -> None:
    answers = False

    async def chassis(wire: Wire, frame: Frame) -> bool:
        return (frame["type"] == TWIST and not answers) or await answer_all(wire, frame)

    def levels() -> list[str]:
        texts = "joystick was not sent or not answered"
        return [each.levelname for each in caplog.records if texts in each.getMessage()]

    caplog.set_level(logging.DEBUG)
    async with driving(chassis, link={"request_timeout": 0.5}, rate=1e9) as stream:
        stream.drive(0.1)
        await eventually(lambda: levels() == ["WARNING"])
        stream.drive(0.2)
        await eventually(lambda: levels() == ["WARNING", "DEBUG"])
        answers = True
        stream.drive(0.3)
        await stream.settle()
        answers = False
        stream.drive(0.4)
        await eventually(lambda: levels() == ["WARNING", "DEBUG", "WARNING"])


async def test_a_second_reason_to_wait_for_a_pause_is_logged_too(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async with driving() as stream:
        stream.drive(0.0)  # the first velocity of all comes after a pause
        for reason in ("one reason", "another reason"):
            stream.driver.silence(reason)
            stream.drive(0.1)
    warned = [each.getMessage() for each in caplog.records if each.levelname == "WARNING"]
    assert [text.partition(";")[0] for text in warned if "joystick" in text] == [
        "joystick is ignored: one reason",
        "joystick is ignored: another reason",
    ]


async def test_silence_stops_the_robot() -> None:
    async with driving(timeout=0.05) as stream:
        stream.drive(0.1)
        await stream.sent(0.1, 0.0)


async def test_silence_counts_from_when_the_last_velocity_was_published() -> None:
    async with driving(timeout=3600.0) as stream:
        stream.drive(0.1, age=3599.5)
        await stream.sent(0.1, 0.0)


@pytest.mark.parametrize("limits", [{}, {"timeout": 0.2}, {"max_age": 0.2}])
async def test_an_old_velocity_of_a_stream_does_not_drive(limits: dict[str, float]) -> None:
    async with driving(**limits) as stream:
        stream.gate.timing = replace(stream.gate.timing, max_age=0.5)
        stream.drive(0.1, age=0.3 if limits else 0.6)
        assert stream.gate.superseded == 1
        stream.drive(0.2, age=0.01)
        await eventually(lambda: speeds(stream.rig.wire))
        assert speeds(stream.rig.wire)[0] == pytest.approx(0.2)


@pytest.mark.parametrize("override", [False, True])
@pytest.mark.parametrize(
    ("type_", "runs", "ended"),
    [
        ("woosh.robot.TaskProc", RUNNING, {**RUNNING, "state": "kCompleted"}),
        (
            "woosh.ros.Feedbacks",
            feedback("MoveBase", "kRosExecuting"),
            feedback("MoveBase", "kRosSuccess"),
        ),
    ],
    ids=["task", "action"],
)
async def test_a_velocity_is_refused_while_a_task_or_action_owns_the_robot_unless_it_may_override(
    type_: str, runs: Frame, ended: Frame, override: bool
) -> None:
    async with driving(override=override) as stream:
        await stream.rig.wire.push(type_, runs)
        await eventually(lambda: stream.gate.owner)
        stream.drive(0.1)
        if override:
            await stream.sent(0.1)
        await stream.rig.wire.push(type_, ended)
        await eventually(lambda: not stream.gate.owner)
        stream.drive(0.2)
        await stream.sent(*([0.1] * override), 0.2)


async def test_a_velocity_that_waits_is_not_sent_once_something_owns_the_robot() -> None:
    async with driving(rate=1.0) as stream:
        stream.drive(0.1)
        stream.drive(0.2)  # waits for its period
        await stream.task_runs()
        due = asyncio.get_running_loop().time() + 1.0
        await eventually(lambda: asyncio.get_running_loop().time() > due)
        await stream.settle()
        await stream.sent(0.1)


@pytest.mark.parametrize("taken", ["by another client's task", "by a follow"])
async def test_no_zero_follows_what_takes_the_wheels(taken: str) -> None:
    """Neither the sender's zero nor the watchdog's."""
    async with driving(timeout=1.0) as stream:
        stream.drive(0.1)
        await stream.sent(0.1)
        await stream.settle()
        if taken == "by a follow":
            await ok(stream.gate.request(Follow(type=True)))
        else:
            await stream.task_runs()
        stream.drive(0.0)
        silent = asyncio.get_running_loop().time() + 1.2
        await eventually(lambda: asyncio.get_running_loop().time() > silent)
        await stream.settle()
        await stream.sent(0.1)


async def test_no_zero_takes_the_place_of_a_velocity_that_waited_when_a_task_began() -> None:
    async with driving(rate=0.001) as stream:
        stream.drive(0.1)
        stream.drive(0.2)  # waits for its turn
        await stream.settle()  # an unanswered velocity may drive the robot after the start
        await stream.task_runs()
        stream.drive(0.0)  # a zero would end the task
        await stream.settle()
        await stream.sent(0.1)


async def test_a_velocity_that_overrides_a_task_is_stopped_by_silence() -> None:
    async with driving(override=True, timeout=0.05) as stream:
        await stream.task_runs()
        stream.drive(0.1)
        await stream.sent(0.1, 0.0)


@pytest.mark.parametrize("until", ["a zero", "a pause"])
async def test_a_stop_silences_the_stream_until_a_zero_or_a_pause(until: str) -> None:
    async with driving(hold=0.0, rate=1e9) as stream:  # the gate itself permits motion again
        stream.gate.timing = replace(stream.gate.timing, pause=NEVER)
        stream.drive(0.1)
        await stream.sent(0.1)
        assert (await soon(stream.gate.stop(TIMEOUT))).success
        stream.drive(0.2)
        await stream.settle()
        if until == "a zero":
            stream.drive(0.0)
        else:
            stream.gate.timing = replace(stream.gate.timing, pause=0.0)
        stream.drive(0.3)
        await stream.sent(0.1, 0.0, 0.3)


@pytest.mark.parametrize("late", [0.0, 0.2])
async def test_what_was_sent_before_a_stop_does_not_end_the_refusal(late: float) -> None:
    """A sender that rested, began just before the stop, and goes on."""
    clock = asyncio.get_running_loop().time
    async with driving(hold=0.0, rate=1e9) as stream:
        published = clock()
        assert (await soon(stream.gate.stop(TIMEOUT))).success
        stream.drive(late, age=clock() - published)
        stream.drive(0.3)
        await stream.settle()
        await stream.sent(0.0)
        stream.drive(0.0)
        stream.drive(0.4)
        await stream.sent(0.0, 0.4)


async def test_velocities_that_no_robot_reaches_are_no_pause_of_the_sender() -> None:
    async with driving(hold=0.0, rate=1e9) as stream:
        stream.gate.timing = replace(stream.gate.timing, pause=NEVER)
        stream.drive(0.1)
        await stream.sent(0.1)
        assert (await soon(stream.gate.stop(TIMEOUT))).success
        await asyncio.sleep(0.3)
        stream.drive(math.nan)
        stream.gate.timing = replace(stream.gate.timing, pause=0.2)
        stream.drive(0.2)
        await stream.settle()
        await stream.sent(0.1, 0.0)


@pytest.mark.parametrize("missing", [0, 5], ids=["late", "lost"])
async def test_what_the_network_holds_up_is_no_pause_of_the_sender(missing: int) -> None:
    clock = asyncio.get_running_loop().time
    async with driving(hold=0.0, rate=1e9) as stream:
        stream.gate.timing = replace(stream.gate.timing, pause=0.5)
        stream.driver.note_number(1)
        stream.drive(0.1)
        published = clock()
        await stream.sent(0.1)
        assert (await soon(stream.gate.stop(TIMEOUT))).success
        await asyncio.sleep(0.6)
        stream.driver.note_number(2 + missing)
        stream.drive(0.2, age=0.0 if missing else clock() - published)
        stream.driver.note_number(3 + missing)
        stream.drive(0.2)
        await stream.settle()
        await stream.sent(0.1, 0.0)
        await asyncio.sleep(0.6)
        stream.driver.note_number(4 + missing)
        stream.drive(0.3)
        await stream.sent(0.1, 0.0, 0.3)


async def test_a_stall_of_the_agent_is_no_pause_of_the_sender() -> None:
    async with driving(hold=0.0, rate=1e9) as stream:
        stream.gate.timing = replace(stream.gate.timing, pause=0.7, settle=0.0)
        stream.drive(0.1)
        await stream.sent(0.1)
        assert (await soon(stream.gate.stop(TIMEOUT))).success
        stream.drive(0.2)
        time.sleep(0.8)  # the sender goes on, but nobody receives what it sends
        for _ in range(2):  # the first one may have been sent during the stall
            stream.drive(0.2)
            await stream.settle()
        await stream.sent(0.1, 0.0)


@pytest.mark.parametrize("meanwhile", ["nothing", "a task", "it stands"])
async def test_after_a_lost_link_the_robot_gets_a_zero_and_nothing_that_was_kept(
    meanwhile: str,
) -> None:
    """Neither a velocity that comes without a link, nor one that waits when the link is lost."""
    async with driving(rate=0.001) as stream:
        rig = stream.rig
        stream.drive(0.1)
        await stream.sent(0.1)
        if meanwhile == "it stands":
            stream.drive(0.0)
            await eventually(lambda: not stream.gate.driving)
        else:
            stream.drive(0.2)  # waits for its period
        if meanwhile == "a task":
            rig.peer.info = {"taskProc": RUNNING}
        rig.wire.abort()
        await eventually(lambda: rig.client.state is not LinkState.READY)
        stream.drive(0.3)
        await rig.second_wire()
        if meanwhile == "a task":
            stream.limits = replace(LIMITS, override=True)
            await eventually(lambda: stream.gate.owner)
            stream.drive(0.4)
            await stream.sent(0.4)
        else:
            zeros = [0.0] if meanwhile == "nothing" else []
            await stream.sent(*zeros)
            await stream.settle()
            await stream.sent(*zeros)


@pytest.mark.parametrize("lost", ["the zero of the sender", "the zero after the first loss"])
async def test_a_zero_that_is_lost_with_the_link_is_sent_when_the_link_is_back(lost: str) -> None:
    is_of_sender = lost == "the zero of the sender"
    losses = 0

    async def script(wire: Wire, frame: Frame) -> bool:
        nonlocal losses
        if frame["type"] == TWIST and not frame["body"].get("linear") and not losses:
            losses += 1
            wire.abort()
            return True
        return await answer_all(wire, frame)

    async with driving(script) as stream:
        stream.drive(0.1)
        await stream.sent(0.1)
        if is_of_sender:
            stream.drive(0.0)
        else:
            stream.rig.wire.abort()
        last = await stream.rig.peer.wire(2 if is_of_sender else 3)
        await eventually(lambda: speeds(last) == [0.0])
        await eventually(lambda: not stream.gate.driving)


async def test_after_a_lost_link_no_zero_ends_an_action_that_has_begun_meanwhile() -> None:
    async with driving() as stream:
        stream.drive(0.1)
        await stream.sent(0.1)
        stream.rig.actions = feedback("MoveBase", "kRosExecuting")
        stream.rig.wire.abort()
        await stream.rig.second_wire()
        await eventually(lambda: stream.gate.owner)
        await stream.settle()
        await stream.sent()


async def test_after_a_lost_link_no_zero_is_sent_before_it_is_known_what_drives_the_robot() -> None:
    """A robot may report much at the beginning of a link, ahead of its task."""

    async def script(wire: Wire, frame: Frame) -> bool:
        if frame["type"] != INFO or len(wire.peer.wires) == 1:
            return await answer_all(wire, frame)
        for code in range(50):
            await wire.push("woosh.robot.count.StatusCode", {"code": str(code)})
        await wire.answer(frame, {"taskProc": RUNNING})
        return True

    async with driving(script) as stream:
        rig = stream.rig
        rig.client.subscribe(StatusCode, lambda _: time.sleep(0.002))
        stream.drive(0.1)
        await stream.sent(0.1)
        rig.wire.abort()
        await rig.second_wire()
        await eventually(lambda: stream.gate.owner)
        await stream.settle()
        await stream.sent()


async def test_velocities_that_are_not_permitted_are_refused_and_silence_the_stream() -> None:
    async with driving() as stream:
        stream.rig.client.permit_only(
            lambda message: isinstance(message, Speak), "it only observes"
        )
        stream.drive(0.1)
        stream.drive(0.0)
        stream.drive(0.2)
        await stream.settle()
        assert not stream.gate.driving
        stream.rig.client.permit_only(None)
        stream.drive(0.3)
        await stream.settle()
        assert speeds(stream.rig.wire) == []
        stream.drive(0.0)
        stream.drive(0.4)
        await stream.sent(0.4)


async def test_a_zero_that_was_not_sent_is_a_warning(caplog: pytest.LogCaptureFixture) -> None:
    async with driving() as stream:
        client = stream.rig.client
        stream.drive(0.1)
        await stream.sent(0.1)
        load = await block(client, stream.rig.wire)
        await client.reconfigure(replace(client.config, request_timeout=0.02))
        stream.drive(0.0)
        await eventually(lambda: "joystick: not sent: the connection was busy" in caplog.text)
        load.cancel()


# The pace of a stream that has a maximum rate

RATE = 10.0


def paced(arrivals: list[float]) -> list[float]:
    """Send messages that arrive at some times, each when it is due; return the times."""
    times, pace = [], Pace()
    for arrival in arrivals:
        times.append(max(arrival, pace.due(RATE)))
        pace.note_sent(times[-1], RATE)
    return times


@pytest.mark.parametrize(
    ("arrivals", "sent"),
    [
        ([7.0], [7.0]),
        ([1.0, 1.1, 1.24, 1.3, 1.4], [1.0, 1.1, 1.24, 1.3, 1.4]),
        ([1.008, 1.1, 1.2, 1.3, 1.4], [1.008, 1.1, 1.2, 1.3, 1.4]),
        ([1.0, 1.7, 1.7, 1.7], [1.0, 1.7, 1.79, 1.89]),
    ],
    ids=["the first is due at once", "one is late", "the first is late", "no burst after a gap"],
)
def test_messages_are_delayed_only_as_far_as_the_rate_needs_it(
    arrivals: list[float], sent: list[float]
) -> None:
    assert paced(arrivals) == pytest.approx(sent)


def test_faster_and_late_messages_do_not_exceed_the_rate() -> None:
    fast = [1.0 + 0.01 * number for number in range(21)]
    assert paced(fast)[-1] == pytest.approx(2.99)  # a tenth of a period early
    late = [1.0 + 0.1 * number + 0.04 * (number % 2) for number in range(100)]
    times = paced([*late, *late[-1:] * 10])
    assert times[-1] - times[0] >= 0.1 * (len(times) - 1) - 0.05
