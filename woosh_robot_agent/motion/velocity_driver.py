"""Rules for a stream of velocities, e.g. from a joystick: watchdog, rate, limits, priority."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import partial

from woosh_robot_agent.link import ChassisClient, LinkError, LinkState, SupersededError
from woosh_robot_agent.link.reports import LogOnce
from woosh_robot_agent.link.tasks import start_task
from woosh_robot_agent.motion.gate import AnsweredCommand, MotionGate, Sender
from woosh_robot_agent.motion.requests import may_move
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Twist
from woosh_robot_agent.sentences import Sentence, said_by

_LATE = 0.5
"""Maximum delay of a message that does not delay the next ones, in periods of the rate."""
_EARLY = 0.1
"""Time by which a message may be early and is still sent at once, in periods of the rate."""


class Pace:
    """The times at which the next message of a stream may be sent.

    On average, no more messages are sent than the rate allows. A message that comes a little late
    does not delay the next ones: at the maximum rate, all later ones would be as late. A message
    that comes a little early is sent at once, because the message before it may have been late.
    """

    def __init__(self) -> None:
        self._slot = -math.inf
        """Time at which the period of the last message began, in seconds."""

    def due(self, rate: float) -> float:
        """Return the time from which the next message may be sent, at a rate in Hz."""
        return self._slot + (1.0 - _EARLY) / rate

    def note_sent(self, now: float, rate: float) -> None:
        """Note that a message was sent."""
        slot = self._slot + 1.0 / rate
        is_much_later = now >= slot + _LATE / rate
        self._slot = now if is_much_later else slot


_LOG = logging.getLogger(__name__)
_UNUSABLE = Sentence("{field} is {value}, and must be from {least} to {greatest} m/s or rad/s")
_STOPPED = Sentence("the robot was stopped")()
NOT_PERMITTED = Sentence("velocities were not permitted until now")()
"""Reason of a `Silence` that a client begins while it may not send velocities."""
_SILENCED = Sentence("{reason}; send a zero velocity, or nothing for {seconds} s")
_OWNED = Sentence("{owner} is running: cancel it, or set the parameter cmd_vel_override")
_NO_LINK = Sentence("there is no link to the chassis")()
MAX_VELOCITY = 10.0
"""Largest plausible velocity, and largest value of a limit, in m/s and rad/s."""


class UnusableVelocityError(ValueError):
    """A velocity is NaN or beyond `MAX_VELOCITY`; the text begins with the name of its field."""


@dataclass(frozen=True)
class VelocityLimits:
    """Limits of velocities. Single commands obey `max_linear` and `max_angular`, streams obey all.

    Attributes:
        max_linear: maximum speed in the plane, in m/s.
        max_angular: maximum turning speed, in rad/s.
        rate: maximum rate of the velocities that are sent, in Hz.
        timeout: time without a velocity after which the robot is stopped, in seconds.
        override: True to drive even while a goal, a task or an action drives the robot.
        max_age: maximum age at which a velocity is sent, in seconds; the lowest of this, `timeout`
            and `MotionTiming.max_age` applies.
    """

    max_linear: float
    max_angular: float
    rate: float
    timeout: float
    override: bool = False
    max_age: float = math.inf

    def apply(self, velocity: Twist) -> Twist:
        """Return a velocity scaled down to the limits; unchanged if it is within the limits.

        The speed in the plane keeps its direction.

        Raises:
            UnusableVelocityError: a value is not a number, or beyond `MAX_VELOCITY`.
        """
        for field in ("linear", "linear_y", "angular"):
            value = getattr(velocity, field)
            if not abs(value) <= MAX_VELOCITY:  # true for NaN
                raise UnusableVelocityError(
                    _UNUSABLE(
                        field=field,
                        value=f"{value:g}",
                        least=f"{-MAX_VELOCITY:g}",
                        greatest=f"{MAX_VELOCITY:g}",
                    )
                )
        speed = math.hypot(velocity.linear, velocity.linear_y)
        if speed <= self.max_linear and abs(velocity.angular) <= self.max_angular:
            return velocity
        scale = self.max_linear / speed if speed > self.max_linear else 1.0
        angular = velocity.angular
        if abs(angular) > self.max_angular:
            angular = math.copysign(self.max_angular, angular)
        return Twist(
            linear=velocity.linear * scale, linear_y=velocity.linear_y * scale, angular=angular
        )


class Silence:
    """A refusal of velocities until their sender sends a zero, or nothing for `MotionTiming.pause`.

    A stop of the robot begins it; `begin` does so for any other reason.

    Attributes:
        reason: why velocities are refused; empty if they are not.
    """

    def __init__(self, gate: MotionGate) -> None:
        self.reason = ""
        self._gate = gate
        self._received = -math.inf
        """Loop time of the last velocity that was received, or is known to be lost."""
        self._begun = -math.inf
        """Loop time of the last call of `begin`."""
        gate.on_stop(partial(self.begin, _STOPPED))

    def begin(self, reason: str) -> None:
        """Refuse velocities for `reason` from now on."""
        self.reason, self._begun = reason, asyncio.get_running_loop().time()

    @property
    def objection(self) -> str:
        """The reason, and what ends the refusal; only while there is a reason."""
        return _SILENCED(reason=self.reason, seconds=f"{self._gate.timing.pause:g}")

    def note_received(self, moves: bool, published: float = math.inf) -> None:
        """Note that a velocity came, even one that is not used; it may end the refusal.

        Args:
            moves: True if it is not zero.
            published: loop time (monotonic) at which the sender published it; by default now.
        """
        now = asyncio.get_running_loop().time()
        # during a stall, this process received nothing, even if the sender went on
        silent_since, self._received = max(self._received, self._gate.stall_ended), now
        has_paused = min(published, now) - silent_since > self._gate.timing.pause
        # what was sent before the refusal began does not end it
        if published >= self._begun and (not moves or has_paused):
            self.reason = ""

    def note_lost(self) -> None:
        """Note that a velocity was lost, so that its sender has not paused."""
        self._received = asyncio.get_running_loop().time()


class VelocityDriver:
    """Drives the robot by a stream of velocities. Used in the event loop of the link.

    1. Velocities beyond `MAX_VELOCITY` are refused; those beyond the limits are scaled down.
    2. While a goal, a task or an action drives the robot, velocities are refused, unless the limits
       have `override` set.
    3. After a stop, or a call of `silence`, velocities are refused until their sender pauses or
       sends a zero.
    4. On average at most `rate` velocities per second are sent, the newest one each time. The first
       zero is sent at once.
    5. Each velocity is sent at most once, none is kept for after a reconnect, and none is sent when
       it is older than `max_age` allows, counted from when its sender published it.
    6. Without a new velocity within `timeout`, the robot is stopped.
    7. If the link is lost while a velocity drives the robot, the robot gets a zero when the link is
       back and the chassis has told what it executes, unless something drives the robot by then.
    8. A zero is sent only if this stream or another velocity command moved the robot.
    9. While the client may not send velocities, they are refused. When they are permitted again,
       rule 3 applies as after a stop.

    Args:
        gate: sends the velocities.
        chassis: the link.
        name: name of the stream in the log, e.g. "cmd_vel".
        limits: returns the current limits.
        on_refused: called with the reason why this refuses a velocity, instead of logging it.
        owner: returns what drives the robot besides this stream; by default `MotionGate.owner`.
    """

    def __init__(
        self,
        gate: MotionGate,
        chassis: ChassisClient,
        name: str,
        limits: Callable[[], VelocityLimits],
        on_refused: Callable[[str], None] | None = None,
        owner: Callable[[], str] | None = None,
    ) -> None:
        self._gate = gate
        self._chassis = chassis
        self._name = name
        self._limits = limits
        self._on_refused = on_refused
        self._other_owner = owner or (lambda: gate.owner)
        self._log = LogOnce(_LOG)
        """Logs why velocities are refused."""
        self._request_log = LogOnce(_LOG)
        """Logs why velocities are not answered."""
        self._driving = False
        """True from a velocity that moves the robot until a zero, a stop, the end of the link, or
        the timeout of the stream."""
        self._waiting: Twist | None = None
        """The velocity to send next."""
        self._number = 0
        """Number of the last velocity; 0 without one."""
        self._published = -math.inf
        """Loop time at which the sender published the last accepted velocity."""
        self._pace = Pace()
        """Loop times at which velocities may be sent."""
        self._refusal = Silence(gate)
        """Refuses velocities until the sender pauses or sends a zero (rule 3)."""
        self._needs_zero = False
        """True if the next link begins with a zero: the link was lost while a velocity drove the
        robot, or a zero was not answered. The answer to any velocity makes it False."""
        self._wake = asyncio.Event()
        self._wake_time = -math.inf
        """Loop time at which `run` wakes up by itself."""
        self._requests: set[asyncio.Task[None]] = set()
        gate.on_stop(self._drop)
        gate.on_answered(self._answered)
        chassis.on_state(self._link_changed)
        gate.wheel_owner.on_known(self._owner_known)

    async def run(self) -> None:
        """Send velocities when they are due, until cancelled."""
        loop = asyncio.get_running_loop()
        while True:
            due = self._due()
            if due <= loop.time():
                self._send_due()
                continue
            self._wake.clear()
            self._wake_time = due
            timer = loop.call_at(due, self._wake.set) if due < math.inf else None
            try:
                await self._wake.wait()
            finally:
                if timer is not None:
                    timer.cancel()

    def drive(
        self, linear: float, sideways: float, angular: float, published: float = math.inf
    ) -> None:
        """Process a velocity of the stream.

        Args:
            linear: speed ahead, in m/s.
            sideways: speed to the left, in m/s.
            angular: turning speed, counter-clockwise, in rad/s.
            published: loop time (monotonic) at which the sender published it; by default now.
        """
        moves = any((linear, sideways, angular))
        self.note_received(moves, published)
        limits = self._limits()
        try:
            limited = limits.apply(Twist(linear=linear, linear_y=sideways, angular=angular))
        except UnusableVelocityError as error:  # rule 1
            self._log_refusal("value", said_by(error))
            return
        now = asyncio.get_running_loop().time()
        published = min(published, now)
        if self._waiting is not None and self._owner:
            # rule 2. Dropped here, because for a waiting velocity, rule 8 would let a zero be sent,
            # which would stop what drives the robot
            self._waiting = None
        if reason := self._chassis.refusal(Twist()):  # rule 9
            if moves:
                self._silence(NOT_PERMITTED)
            self._log_refusal("not permitted", reason)
        elif moves and self._refusal.reason:  # rule 3
            kind = f"silenced: {self._refusal.reason}"
            self._log_refusal(kind, self._refusal.objection)
        elif moves and (owner := self._owner):  # rule 2
            self._log_refusal("owner", _OWNED(owner=owner))
        elif self._chassis.state is not LinkState.READY:  # rule 5
            self._log_refusal("link", _NO_LINK)
        elif moves and now - published > self._max_age:  # rule 5
            self._gate.count_superseded(
                f"{self._name}: a velocity was not sent: it was {now - published:.2f} s old, and "
                f"{self._max_age:g} s are allowed; check the load of this computer and the network "
                "to the sender, and synchronise the clocks if several computers send velocities"
            )
        elif may_move(limited) or self._has_to_stop():  # rule 8; the limits may make it a zero
            self._log.clear()  # later refusals are logged again
            self._published = published
            self._waiting = limited
            self._send_or_wait(now)

    def note_number(self, number: int | None) -> None:
        """Note the number of a velocity before it is processed: a gap shows that others were lost.

        Args:
            number: the number that its sender gave it, in ascending order; None without numbers.
        """
        number = number or 0
        if 0 < self._number < number - 1:
            self._refusal.note_lost()
        self._number = number

    def note_received(self, moves: bool, published: float = math.inf) -> None:
        """Note that a velocity of the stream came, as `Silence.note_received`.

        `drive` and `refuse` do so by themselves.
        """
        self._refusal.note_received(moves, published)

    def refuse(self, kind: str, reason: str, published: float = math.inf) -> None:
        """Refuse a velocity that would move the robot, for a reason of the caller.

        Args:
            kind: kind of the reason; reasons of one kind are logged once.
            reason: the reason, for the log or `on_refused`.
            published: as in `note_received`.
        """
        self.note_received(True, published)
        self._log_refusal(kind, reason)

    def silence(self, reason: str) -> None:
        """Stop the robot if the stream drives it, and refuse velocities as after a stop (rule 3).

        Args:
            reason: why velocities are refused, for the log or `on_refused`.
        """
        if self._driving and self._gate.driving:  # otherwise a task may have taken over
            self._send(Twist())
        self._silence(reason)

    async def end(self) -> None:
        """Stop the robot, but not what a start that is not answered yet begins.

        Sends nothing while rule 3 refuses velocities: the stream does not drive the robot then, and
        a zero would end the refusal.
        """
        self._waiting = None
        await self._gate.wait_for_starts()
        if not self._refusal.reason:
            self.drive(0.0, 0.0, 0.0)

    def _log_refusal(self, kind: str, reason: str) -> None:
        """Log or tell why a velocity is refused; reasons of one kind are logged once."""
        if self._on_refused is not None:
            self._on_refused(reason)
            return
        self._log.warn(kind, f"{self._name} is ignored: {reason}")

    @property
    def _owner(self) -> str:
        """Name of what drives the robot, so that velocities are refused; empty if nothing does."""
        return "" if self._limits().override else self._other_owner()

    @property
    def _max_age(self) -> float:
        """Maximum age at which a velocity is sent, in seconds."""
        limits = self._limits()
        return min(limits.max_age, limits.timeout, self._gate.timing.max_age)

    def _has_to_stop(self) -> bool:
        """Return True if a zero would stop something."""
        if self._gate.driving or self._waiting is not None:
            return True
        # the gate may hold back a velocity that will be sent later
        return self._driving and bool(self._requests)

    def _due(self) -> float:
        """Return the loop time at which to send next; infinite if there is nothing to send."""
        limits = self._limits()
        if self._waiting is not None:  # rule 4
            is_first_zero = self._driving and not may_move(self._waiting)
            return 0.0 if is_first_zero else self._pace.due(limits.rate)
        if self._driving and self._chassis.state is LinkState.READY:  # rule 6
            return self._published + limits.timeout
        return math.inf

    def _send_or_wait(self, now: float) -> None:
        """Send what is due at a loop time; wake `run` if the next is due before `_wake_time`."""
        if self._due() <= now:
            self._send_due()
        if self._due() < self._wake_time:
            self._wake.set()

    def _send_due(self) -> None:
        """Send the velocity that waits; without one, the zero of the watchdog."""
        if self._waiting is not None and may_move(self._waiting) and self._owner:
            self._waiting = None  # rule 2: something has begun to drive the robot meanwhile
        elif self._waiting is not None:
            self._send(self._waiting, self._published)
        elif self._gate.driving:
            self._send(Twist())
        else:  # rule 8: the robot stands, or a task or an action drives it
            self._driving = False

    def _send(self, velocity: Twist, published: float | None = None) -> None:
        """Send a velocity; `published` is None for a zero of the driver itself."""
        self._waiting = None
        self._pace.note_sent(asyncio.get_running_loop().time(), self._limits().rate)
        self._driving = may_move(velocity)
        task = start_task(self._request(velocity, published), self._name)
        self._requests.add(task)
        task.add_done_callback(self._requests.discard)

    async def _request(self, velocity: Twist, published: float | None) -> None:
        """Send a velocity through the gate; log why it failed."""
        try:
            sender = Sender(self._name, published, self._max_age)
            await self._gate.request(velocity, sender=sender)
            self._request_log.clear()
        except SupersededError as error:  # normal while the chassis is slow, but not for a zero
            level = logging.DEBUG if may_move(velocity) else logging.WARNING
            _LOG.log(level, "%s: %s", self._name, error)
        except LinkError as error:
            self._needs_zero = self._needs_zero or not may_move(velocity)
            self._request_log.warn("", f"{self._name} was not sent or not answered: {error}")

    def _silence(self, reason: str) -> None:
        """Drop the velocity that waits; refuse others until their sender pauses or sends a zero."""
        self._refusal.begin(reason)
        self._drop()

    def _drop(self) -> None:
        """Drop the velocity that waits; no velocity of this stream drives the robot any more."""
        self._waiting = None
        self._driving = False
        self._wake.set()

    def _answered(self, command: AnsweredCommand) -> None:
        if isinstance(command.message, Twist):
            self._needs_zero = False

    def _link_changed(self, state: LinkState) -> None:
        """Forget the velocities when the link is lost."""
        if state is not LinkState.READY:
            self._waiting = None
            # `_gate.driving` is also True because of velocities that do not come from this stream
            self._needs_zero = self._needs_zero or self._driving or self._gate.driving
            self._driving = False

    def _owner_known(self, _unknown: Collection[str]) -> None:
        """Send the zero of rule 7."""
        self._needs_zero = self._needs_zero and not self._driving and not self._other_owner()
        if self._needs_zero:
            self._send(Twist())
