"""The motion gate: every request that moves the robot passes through it, by these rules.

1. Nothing bypasses the gate. It reserves all requests that command motion, so the chassis client
   refuses them from any other caller.
2. The latest velocity wins, and a stale one is not sent. Its age counts from when its sender
   published it. See `LatestWins`. One that is held back is discarded when a task or an action that
   drives the robot is started or reported.
3. Nothing is sent twice. The gate does not retry, and a request that was made without a link, or
   before the link was lost, is not sent after a reconnect.
4. A stop is sent ahead of all waiting requests. Waiting requests that move the robot, those that
   arrive shortly after the stop, and those that a client sent before it, are not sent. What was
   started from here just before the stop is cancelled again if it begins just after it. So is a
   task of another client that the chassis had accepted, and the next task of a set.
5. A closed gate sends nothing that moves the robot. On closing, it sends a zero velocity if the
   robot may still be driving at a velocity from this gate.
6. A zero velocity is not sent to a robot that a task or an action drives. Earlier velocities no
   longer drive the robot once the chassis accepts a task or action, or reports the start of one
   that another client commands. A velocity that is sent after the agent's own start request drives
   the robot, and so does one that is unanswered when the start by another client is reported,
   unless the chassis refuses it.
7. If the agent closes the link to use other settings, or only observes the robot from now on, the
   robot gets a zero velocity if it may still be driving at a velocity from this gate.
8. A command that may have been sent to the agent before the end of a stall of its process or event
   loop moves nothing. See `StallWatch`.

For a stream of velocities, use `VelocityDriver`, which adds rules for streams.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import re
import time
from collections.abc import Callable, Collection, Coroutine
from dataclasses import dataclass
from typing import Any, NamedTuple

from google.protobuf.message import Message

from woosh_robot_agent.link import (
    Answer,
    ChassisClient,
    LinkError,
    LinkState,
    NotConnectedError,
    Sending,
    SupersededError,
    TooManyRequestsError,
)
from woosh_robot_agent.link.reports import DROPS_QUIET, LogOnce
from woosh_robot_agent.link.subscriptions import call_logged
from woosh_robot_agent.link.tasks import start_task
from woosh_robot_agent.motion.requests import commands_motion, may_move, started_by, takes_wheels
from woosh_robot_agent.motion.timeliness import LatestWins, MotionTiming, StallWatch
from woosh_robot_agent.motion.wheel_owner import ACTIONS, FOLLOW, WheelOwner
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ActionOrder, ExecTask, Follow, Twist
from woosh_robot_agent.pb.ros.action_pb2 import kCancel as CANCEL_ACTION
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction
from woosh_robot_agent.pb.util.action_pb2 import kCancel as CANCEL_TASK
from woosh_robot_agent.sentences import NOT_SENT, THEN, Said, Sentence, joined, said_by


def cancel_orders() -> dict[str, Message]:
    """Return the requests that end the task, each action that can be cancelled, and a following.

    Their names are "task", those of the messages of the actions, e.g. "StepControl", and "Follow".
    """
    orders: dict[str, Message] = {"task": ActionOrder(order=CANCEL_TASK)}
    for field in CallAction.DESCRIPTOR.oneofs_by_name["action"].fields:
        if field.message_type is not None and field.message_type.full_name in ACTIONS:
            call: Any = CallAction()
            getattr(call, field.name).action = CANCEL_ACTION
            orders[field.message_type.name] = call
    orders[FOLLOW] = Follow()  # without `type`, it ends the following
    return orders


@dataclass(frozen=True)
class StopReport:
    """Answers of the chassis to the requests of a stop.

    Attributes:
        zero: the answer to the zero velocity, or the error if there is none.
        cancels: the answer or error of each cancel request, by the name of the task or action.
        running: names of what the chassis refused to cancel, and still reports as moving.
    """

    zero: Answer | LinkError
    cancels: dict[str, Answer | LinkError]
    running: tuple[str, ...] = ()

    @property
    def success(self) -> bool:
        """True if the chassis confirmed the zero velocity and answered each cancel request.

        The chassis refuses to cancel something that is not running, which is no failure.
        """
        return _is_ok(self.zero) and not self.running and not self._unanswered_cancels

    @property
    def message(self) -> str:
        """Human-readable result, with advice if the stop failed."""
        stopped = _is_ok(self.zero) and not self.running
        reason = self._failed(self.running[0]) if self.running else _reason(self.zero)
        parts = [_DONE() if stopped else _NOT_STOPPED(reason=reason)]
        # the chassis may accept the end of a following also if there was none
        cancelled = [
            name for name, answer in self.cancels.items() if _is_ok(answer) and name != FOLLOW
        ]
        parts += [_CANCELLED(what=_name(each)) for each in cancelled]
        if not self.success:
            if stopped:  # otherwise the first part has a reason already
                parts += self._unanswered_cancels[:1]  # one reason is enough
            parts.append(_ADVICE())
        return joined(THEN, parts)

    @property
    def _unanswered_cancels(self) -> list[Said]:
        """Texts about the cancel requests without an answer."""
        return [
            self._failed(name)
            for name, answer in self.cancels.items()
            if isinstance(answer, LinkError)
        ]

    def _failed(self, name: str) -> Said:
        """Return the text about a cancel request that failed."""
        return _CANCEL_FAILED(what=_name(name), reason=_reason(self.cancels[name]))


def _is_ok(answer: Answer | LinkError) -> bool:
    return isinstance(answer, Answer) and answer.ok


def _is_refused(answer: Answer | LinkError) -> bool:
    return isinstance(answer, Answer) and not answer.ok


def _reason(answer: Answer | LinkError) -> str:
    return answer.reason if isinstance(answer, Answer) else said_by(answer)


def _name(what: str) -> str:
    """Return what was cancelled, for the text of a report: a task, or the name of an action."""
    return _TASK() if what == "task" else what


_DONE = Sentence("stopped")
_NOT_STOPPED = Sentence("NOT STOPPED: {reason}")
_CANCELLED = Sentence("{what} cancelled")
_CANCEL_FAILED = Sentence("cancel of {what}: {reason}")
_ADVICE = Sentence("if the robot moves, press its emergency stop")
_TASK = Sentence("task")
_LOG = logging.getLogger(__name__)

_STOPPED = Sentence("cancelled by a stop of the robot")()
_CHECK_PERIOD = 0.02
"""Period of the checks whether the chassis has reported the end of what a stop cancels."""
_MAX_DELAY = 20.0
"""Maximum time that a command is expected to be on its way, in seconds. One that seems to be older
comes from a computer whose clock differs."""
_LONGEST_LOSS = 30.0
"""Maximum time from a stop to the return of a lost link, in seconds. If the link returns in time,
what has begun meanwhile is cancelled. Later, somebody else may have started it."""
_BEFORE_STOP = Sentence(
    "it was sent before the last stop of the robot: send it again, and if this repeats, "
    "synchronise the clocks of the two computers"
)()
_CLOSING = Sentence("the agent is stopping")()
_WHEELS_TAKEN = Sentence("a task or an action drives the robot")()
_STALLED = Sentence(
    "the agent stood still for {seconds} s, and this may have been sent before that ended; send it "
    "again, and find out what holds up this computer"
)
_GOAL = Said("a goal", "driver.a goal")


class Sender(NamedTuple):
    """The sender of a command, and the time at which the command was published.

    Attributes:
        name: name of the sender, for `MotionGate.on_answered`; empty for the agent itself.
        published: loop time (monotonic) at which a sender outside of this process published the
            command, as far as that is known; None for a command of this process.
        max_age: maximum age at which a velocity is sent, in seconds, if it is shorter than the
            gate's own limit, `MotionTiming.max_age`.
    """

    name: str = ""
    published: float | None = None
    max_age: float = math.inf


_SELF = Sender()
"""The agent itself."""


class AnsweredCommand(NamedTuple):
    """A command that the chassis has answered.

    Attributes:
        message: the command.
        source: name of the sender; empty for the agent itself.
        answer: the answer, which may be a refusal.
        requested: loop time at which the command was given to the gate.
    """

    message: Message
    source: str
    answer: Answer
    requested: float


@dataclass(eq=False)
class _Start:
    """A start of a task or an action that was sent from here.

    Attributes:
        name: "task", or the action that it starts, by its short name.
        sent: monotonic time at which it was sent.
        task_id: id of the single task that it starts; None for a set, an order or an action.
        answered: monotonic time at which its answer came, or its request failed; infinite before.
    """

    name: str
    sent: float
    task_id: int | None
    answered: float = math.inf


class MotionGate:
    """The only sender of requests that move the robot. Used in the event loop of the link.

    Args:
        chassis: the link.
        open_goals: returns the number of goals that the robot may be executing; by default none.
        on_late_stop: called when what began just after a stop has been cancelled, with the report
            on this cancel and the loop time at which it was requested.

    Attributes:
        superseded: number of velocities that were not sent because they were out of date.
        wheel_owner: which task or actions drive the robot, as the chassis reports.
        timing: times in the rules; may be replaced at any time.
    """

    def __init__(
        self,
        chassis: ChassisClient,
        open_goals: Callable[[], int] = lambda: 0,
        on_late_stop: Callable[[StopReport, float], None] = lambda report, given: None,
    ) -> None:
        self._chassis = chassis
        self._send = chassis.reserve(commands_motion)  # rule 1
        self._open_goals = open_goals
        self._on_late_stop = on_late_stop
        self.wheel_owner = WheelOwner(chassis, self._start_reported)
        self.timing = MotionTiming()
        self._velocities = LatestWins(lambda: self.timing)
        self._last_velocity = Twist()
        """The last velocity that was sent, zero included."""
        self._unanswered_at_start: Twist | None = None
        """The last velocity, if the chassis may have got it after the start of a task or action, or
        None. If the chassis refuses this velocity, none drives the robot."""
        self._drives_until = -math.inf
        """Monotonic time until which the robot may be driving at a velocity from this gate."""
        self._wheels_taken = -math.inf
        """Monotonic time at which the chassis last accepted a task or driving action from here."""
        self._starts: list[_Start] = []
        """The last starts, the oldest first, without those that have begun since."""
        self._forbidden = ""
        """Reason why requests that move the robot are refused until `_forbidden_until`."""
        self._forbidden_until = -math.inf
        """Monotonic time until which requests that move the robot are refused."""
        self._stop_called = -math.inf
        """Monotonic time at which the last stop was announced."""
        self._awaited_task = 0
        """Number (`WheelOwner.acceptances`) of the task that the robot had accepted, and not begun,
        at the last stop; 0 without one."""
        self._stopped_set = 0
        """Id of the set that the last stop or late cancel has ended; 0 without one."""
        self._stop_answered = -math.inf
        """Monotonic time at which the chassis had last answered all requests of a stop: what begins
        shortly after it is cancelled. Infinite during a stop; in the future while the link is lost
        soon after a stop."""
        self._stalls = StallWatch(lambda: self.timing)
        self._stop_callbacks: list[Callable[[], None]] = []
        self._answered_callbacks: list[Callable[[AnsweredCommand], None]] = []
        self._unanswered_starts = 0
        """Number of starts of tasks and driving actions that are not answered."""
        self._drops = LogOnce(_LOG, DROPS_QUIET)
        self.superseded = 0
        chassis.on_state(self._link_changed)
        self._link_changed(chassis.state)

    async def request(
        self,
        message: Message,
        timeout: float | None = None,
        *,
        urgent: bool = False,
        tap: Callable[[Answer], None] | None = None,
        sender: Sender = _SELF,
    ) -> Answer:
        """Send a command and wait for the answer. The rules apply only to motion commands.

        Args:
            message: the command.
            timeout: time to wait for the answer, in seconds; by default `ChassisClient.timeout_of`.
            urgent: True to send it even if `max_in_flight` requests are in flight.
            tap: callback that gets the answer in order with the pushes of the chassis.
            sender: who wants the command.

        Raises:
            SupersededError: the rules forbid sending it; nothing was sent.
            LinkError: no answer arrived; `ChassisClient.request` lists the classes.
        """
        how = Sending(timeout, urgent=urgent, tap=tap)
        requested = asyncio.get_running_loop().time()
        if commands_motion(message):
            answer = await self._request(message, how, sender)
        else:
            answer = await self._chassis.send(message, how)
        for callback in self._answered_callbacks:
            call_logged(callback, AnsweredCommand(message, sender.name, answer, requested))
        return answer

    def announce_stop(self) -> None:
        """Forbid all motion for `timing.hold`; `stop` must be called within this time.

        Thread-safe. Commands that wait for the event loop ahead of the call of `stop` are not sent.
        """
        self._stop_called = time.monotonic()

    async def stop(self, timeout: float) -> StopReport:
        """Send a zero velocity and cancel everything that moves the robot, ahead of other requests.

        A real robot refuses velocities during a task. A refused zero is sent once more when the
        cancels have been answered, and again when they have taken effect.

        Args:
            timeout: time to wait for each answer, in seconds.
        """
        self.announce_stop()
        for callback in self._stop_callbacks:
            try:
                callback()
            except Exception:  # the robot must be stopped, whatever else fails
                _LOG.exception(
                    "a part of the program failed to note a stop, which is sent all the same"
                )
        self._forbid(_STOPPED, self.timing.hold)  # rule 4
        owner = self.wheel_owner
        self._awaited_task = owner.acceptances if owner.awaits_task else 0
        self._stop_answered = math.inf
        try:
            return await self._send_stop(timeout)
        finally:
            self._stop_answered = time.monotonic()
            self._extend_stop_over_loss()

    async def _send_stop(self, timeout: float) -> StopReport:
        """Send a zero velocity and cancel everything that moves the robot."""
        self._stopped_set = self.wheel_owner.current_set(within=2 * self.timing.effect)
        orders = cancel_orders()
        # each goes to the front of the queue, so the first one to send, the zero, is queued last
        queued = [*reversed(orders.values()), Twist()]
        answers = await asyncio.gather(*(self._send_first(each, timeout) for each in queued))
        zero, *cancels = reversed(answers)
        if _is_refused(zero):
            zero = await self._send_first(Twist(), timeout)
        answered = dict(zip(orders, cancels, strict=True))
        refused = [name for name, answer in answered.items() if _is_refused(answer)]
        # The zero may be refused until the cancels take effect. If it was accepted, wait only for
        # what the chassis refused to cancel: an earlier cancel may be taking effect.
        await self._wait_for_end(orders if _is_refused(zero) else refused)
        # rule 6: no zero to what was started after the stop
        if _is_refused(zero) and not self.wheel_owner.name:
            zero = await self._send_first(Twist(), timeout)
        running = tuple(filter(self.wheel_owner.moves, refused))
        return StopReport(zero, answered, running)

    async def _wait_for_end(self, names: Collection[str]) -> None:
        """Wait until none of these is active, at most `timing.effect`."""
        clock = asyncio.get_running_loop().time
        until = clock() + self.timing.effect
        while any(map(self.wheel_owner.is_active, names)) and clock() <= until:
            await asyncio.sleep(_CHECK_PERIOD)

    async def close(self, timeout: float) -> None:
        """Refuse all further motion, and stop the robot if it may be driving at a velocity.

        Args:
            timeout: time to wait for the answer to the zero, in seconds.

        Raises:
            LinkError: the chassis refused the zero, or did not answer it.
        """
        self._forbid(_CLOSING, math.inf)  # rule 5
        if self.driving:
            await self._send_zero(timeout)

    async def stop_driving(self, reason: str, timeout: float) -> None:
        """Stop the robot if it may be driving at a velocity, and refuse motion meanwhile.

        Call it before the link is closed, or when commands have just been forbidden. If the robot
        cannot be stopped, this logs an error.

        Args:
            reason: why motion is refused.
            timeout: time to wait for the answer to the zero, in seconds.
        """
        self._velocities.withdraw(reason)
        if self.driving:
            self._forbid(reason, timeout)
            try:
                await self._send_zero(timeout)
            except LinkError as error:
                _LOG.error(
                    "the robot was not stopped; if it moves, press its emergency stop: %s", error
                )

    def count_superseded(self, reason: str) -> None:
        """Count a velocity that was not sent; log the first one of a series for each reason."""
        if self._forbidden_until < math.inf:  # after closing, refusals are expected
            self.superseded += 1
            kind = re.sub(r"\d", "", reason)  # the reason without its age, which varies
            self._drops.warn(kind, reason)

    def on_stop(self, callback: Callable[[], None]) -> None:
        """Call `callback` at the beginning of each stop."""
        self._stop_callbacks.append(callback)

    def on_answered(self, callback: Callable[[AnsweredCommand], None]) -> None:
        """Call `callback` with each command sent by `request`, once the chassis has answered it.

        The requests of a stop are not included.
        """
        self._answered_callbacks.append(callback)

    async def wait_for_starts(self) -> None:
        """Wait for the answers to starts of tasks and driving actions; at most `timing.unanswered`.

        Until then, it is not known whether a zero velocity would pause what such a start begins.
        """
        clock = asyncio.get_running_loop().time
        until = clock() + self.timing.unanswered
        while self._unanswered_starts and clock() < until:
            await asyncio.sleep(_CHECK_PERIOD)

    @property
    def driving(self) -> bool:
        """True if the robot may still be driving at a velocity from this gate."""
        return time.monotonic() < self._drives_until

    @property
    def is_answer_overdue(self) -> bool:
        """True if velocities are held back, because the chassis has not answered an earlier one."""
        return self._velocities.is_answer_overdue

    @property
    def stall_ended(self) -> float:
        """Monotonic time at which the end of the last stall was noticed; -inf before the first."""
        self._stalls.check()
        return self._stalls.ended

    @property
    def stall_duration(self) -> float:
        """Duration of the stall at `stall_ended`, in seconds; 0 before the first."""
        return self._stalls.duration

    @property
    def owner(self) -> str:
        """Name of what drives the robot: `wheel_owner.name`, or else "a goal"; empty if nothing."""
        return self.wheel_owner.name or (_GOAL if self._open_goals() else "")

    async def _request(self, message: Message, how: Sending, sender: Sender) -> Answer:
        """Send a motion command; hold a velocity back while the chassis does not answer."""
        if not isinstance(message, Twist):
            is_start = takes_wheels(message)
            self._unanswered_starts += is_start
            try:
                return await self._send_if_allowed(message, how, sender)
            finally:
                self._unanswered_starts -= is_start

        def send(within: float) -> Coroutine[Any, Any, Answer]:
            # urgent: it is sent even if many other requests are in flight
            return self._send_if_allowed(message, how._replace(urgent=True, within=within), sender)

        now = asyncio.get_running_loop().time()
        published = now if sender.published is None else sender.published
        try:  # rule 2
            return await self._velocities.request(message, send, published, sender.max_age)
        except SupersededError as error:
            self.count_superseded(str(error))
            raise

    async def _send_if_allowed(self, message: Message, how: Sending, sender: Sender) -> Answer:
        """Send a motion command, unless the rules forbid it; note whether it drives the robot.

        Raises:
            SupersededError: the rules forbid it now.
            LinkError: no answer arrived; `ChassisClient.request` lists the classes.
        """
        self._chassis.check_permitted(message)  # first: what is not sent must not count as driving
        if may_move(message) and (reason := self.refusal(sender.published)):
            raise SupersededError(reason)
        velocity_before = self._last_velocity
        start = self._note_request(message)
        try:
            answer = await self._send(message, how)  # rule 3: once
        except (NotConnectedError, SupersededError, TooManyRequestsError):  # nothing was sent
            self._forget_start(start)
            raise
        finally:
            start.answered = time.monotonic()
        if answer.ok:
            self._note_accepted(message, velocity_before)
        else:
            self._forget_start(start)
            self._note_refused(message)
        return answer

    def _note_request(self, message: Message) -> _Start:
        """Note what a motion command that is about to be sent may drive or start."""
        if isinstance(message, Twist):
            self._last_velocity = message
            if may_move(message) and self._chassis.state is LinkState.READY:
                self._drives_until = time.monotonic() + self.timing.driving
        if takes_wheels(message):
            self._velocities.withdraw(_WHEELS_TAKEN)
        task_id = message.task_id if isinstance(message, ExecTask) else None
        start = _Start(started_by(message), time.monotonic(), task_id)
        if start.name:  # now, because the answer may be lost, or come after the report
            self._starts = [*self._recent_starts(), start]
        return start

    def _note_accepted(self, message: Message, velocity_before: Twist) -> None:
        """Note whether a velocity still drives the robot after an accepted motion command.

        Args:
            message: the command.
            velocity_before: the last velocity that was sent before the command.
        """
        if takes_wheels(message):  # rule 6
            self._wheels_taken = time.monotonic()
            if self._last_velocity is velocity_before:
                self._drives_until = -math.inf
            else:  # the last velocity was sent after this command
                self._unanswered_at_start = self._last_velocity
        elif message is self._last_velocity and not may_move(message):  # a zero
            self._drives_until = -math.inf

    def _note_refused(self, message: Message) -> None:
        """Note whether a velocity still drives the robot after a refused motion command."""
        # rule 6: the start of a task or action has ended all velocities before this one, which was
        # refused. After any other refusal, an earlier velocity may still drive the robot
        if message is self._unanswered_at_start and message is self._last_velocity:
            self._drives_until = -math.inf

    def _recent_starts(self) -> list[_Start]:
        """Return those of `_starts` that may still matter after a stop.

        A stop may come up to `effect` after the answer to a start, and the report of the start up
        to `effect` after the answers to the stop.
        """
        oldest = time.monotonic() - 2 * self.timing.effect
        return [each for each in self._starts if each.answered > oldest or self._is_late(each)]

    def _forget_start(self, start: _Start) -> None:
        """Remove a command from `_starts`, because it starts nothing or has begun."""
        self._starts = [each for each in self._starts if each is not start]

    def refusal(self, published: float | None) -> str:
        """Return why a command may not move the robot now; empty if it may. Thread-safe.

        Args:
            published: loop time (monotonic) at which a sender outside of this process published the
                command; None for a command of this process.
        """
        now = time.monotonic()
        if now < self._forbidden_until:  # rules 4 and 5
            return NOT_SENT(reason=self._forbidden)
        # rule 4, also while the stop waits for its turn
        if now < self._stop_called + self.timing.hold:
            return NOT_SENT(reason=_STOPPED)
        if published is not None and 0.0 < self._stop_called - published < _MAX_DELAY:
            return NOT_SENT(reason=_BEFORE_STOP)
        self._stalls.check()  # a stall may have ended just now, before the next heartbeat
        if published is not None and self._stalls.is_from_before(published):  # rule 8
            return NOT_SENT(reason=_STALLED(seconds=f"{self._stalls.duration:.1f}"))
        return ""

    async def _send_zero(self, timeout: float) -> None:
        """Send a zero velocity ahead of all other requests, even if commands are not permitted.

        Raises:
            LinkError: the chassis refused the zero velocity, or did not answer.
        """
        answer = await self._send(Twist(), Sending(timeout, first=True, always=True))
        if not answer.ok:
            raise LinkError(f"the chassis refused the zero velocity: {answer.reason}")
        self._drives_until = -math.inf

    async def _send_first(self, message: Message, timeout: float) -> Answer | LinkError:
        """Send one request of a stop ahead of all others; return the error if it fails."""
        try:
            return await self._request(message, Sending(timeout, first=True), _SELF)
        except LinkError as error:
            return error

    def _forbid(self, reason: str, duration: float) -> None:
        """Withdraw waiting requests that move the robot; refuse new ones for `duration` seconds."""
        until = asyncio.get_running_loop().time() + duration
        if until > self._forbidden_until:
            self._forbidden, self._forbidden_until = reason, until
        self._velocities.withdraw(reason)
        self._chassis.withdraw(may_move, reason)

    def _start_reported(self, started: str, drives: bool) -> None:
        """Note that a task or action has begun; cancel it if a stop came too early to end it.

        Args:
            started: "task", or the action by its short name.
            drives: True if it drives the robot, so that no earlier velocity does.
        """
        starts = [each for each in self._recent_starts() if each.name == started]
        if starts:
            self._forget_start(starts[0])  # the oldest one has begun
        if self._has_escaped_stop(starts, is_task=started == "task"):
            start_task(self._cancel_late_start(), "cancel of a late start")  # rule 4
        if not drives:
            return
        self._velocities.withdraw(_WHEELS_TAKEN)
        was_started_here = time.monotonic() < self._wheels_taken + self.timing.driving
        if was_started_here:
            # `_note_accepted` has ended the velocities before the start; one that was sent between
            # the acceptance and this report drives the robot
            return
        if self._velocities.in_flight:  # the last one may have come before or after the start
            self._unanswered_at_start = self._last_velocity
        else:  # rule 6
            self._drives_until = -math.inf

    def _has_escaped_stop(self, starts: list[_Start], *, is_task: bool) -> bool:
        """Return True if the last stop came too early to end the task or action that begins now.

        Args:
            starts: the starts from here of which one may have begun it, the oldest first.
            is_task: True for a task, False for an action.
        """
        after_stop = [each for each in starts if each.sent > self._stop_called]
        if is_task:
            # a chassis answers a start before it reports the task
            ids = [each.task_id for each in after_stop if each.answered < math.inf]
            if self.wheel_owner.task_id in ids or ids[-1:] == [None]:
                self._stopped_set = 0  # the set, or a task with such an id, was started again
            if self._is_next_of_set():
                return True
        if after_stop:  # the last one may be what begins, and is wanted
            return False
        return any(map(self._is_late, starts)) or (is_task and self._is_awaited_task())

    def _is_late(self, start: _Start) -> bool:
        """Return True if what begins now may have been started before the last stop.

        The times count from the answers, because a busy chassis executes requests late.
        """
        effect, now = self.timing.effect, time.monotonic()
        may_begin_after_stop = self._stop_called < start.answered + effect
        return may_begin_after_stop and now < effect + max(
            self._stop_called, self._stop_answered, start.answered
        )

    def _is_awaited_task(self) -> bool:
        """Return True if what begins now is the task that was accepted before the last stop."""
        stopped = max(self._stop_called, self._stop_answered)
        is_same = self.wheel_owner.acceptances == self._awaited_task > 0
        return is_same and time.monotonic() < stopped + self.timing.effect

    def _is_next_of_set(self) -> bool:
        """Return True if the task that begins now goes on with the set that the last stop ended.

        The cancel of a task ends only this task: real robots begin the next one of its set, or the
        same one if the set is repeated, about a second after the end.
        """
        is_same = self.wheel_owner.current_set() == self._stopped_set > 0
        # once for the effect of the cancel, and once for the report of the next task
        return is_same and time.monotonic() < self._stop_answered + 2 * self.timing.effect

    async def _cancel_late_start(self) -> None:
        """Cancel what has begun after a stop that should have prevented it.

        The cancels of the stop came too early, and had no effect on it.
        """
        _LOG.warning("what the last stop should have prevented has begun: cancelling it")
        with contextlib.suppress(LinkError):  # the RobotInfo of a handshake comes before `READY`
            await self._chassis.wait_ready(self.timing.effect)
        given = asyncio.get_running_loop().time()
        report = await self._send_stop(self.timing.effect)
        self._stop_answered = time.monotonic()  # the next task of the set may begin from now on
        self._extend_stop_over_loss()
        if not report.success:
            _LOG.error("%s", report.message)
        self._on_late_stop(report, given)

    def _extend_stop_over_loss(self) -> None:
        """If the link is lost soon after a stop, count the times after the stop from its return.

        Without a link, the chassis cannot report what begins. Later than `_LONGEST_LOSS` after the
        stop, nothing is cancelled any more.
        """
        now = time.monotonic()
        if self._chassis.state is not LinkState.READY:
            if now < self._stop_answered + 2 * self.timing.effect:
                until = self._stop_called + _LONGEST_LOSS
                self._stop_answered = max(self._stop_answered, until)
        elif self._stop_answered < math.inf:  # no stop goes on
            self._stop_answered = min(self._stop_answered, now)

    def _link_changed(self, state: LinkState) -> None:
        """Watch for stalls until the link is closed, also while it is lost.

        Commands that wait for the end of a stall may be read when the link is ready again.
        """
        self._extend_stop_over_loss()
        if state is LinkState.STOPPED:
            self._stalls.stop()
        else:
            self._stalls.start()
