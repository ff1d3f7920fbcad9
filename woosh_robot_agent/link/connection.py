"""One connection to a chassis, used once: reader, writer, requests, deadlines and liveness."""

from __future__ import annotations

import asyncio
import logging
import math
import time
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Collection, Coroutine
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

from google.protobuf.message import Message

from woosh_robot_agent.link.config import (
    ConnectionLostError,
    LinkConfig,
    LinkError,
    NotConnectedError,
    RequestTimeoutError,
    SupersededError,
    TooManyRequestsError,
)
from woosh_robot_agent.link.frames import (
    SUBSCRIPTION_TYPE,
    Answer,
    Body,
    Codec,
    Envelope,
    FrameError,
)
from woosh_robot_agent.link.protos import full_name, message_types
from woosh_robot_agent.link.reports import LinkRecord
from woosh_robot_agent.link.subscriptions import EVENT_PUSHES
from woosh_robot_agent.link.tasks import LARGE, cancel_and_wait, offload
from woosh_robot_agent.link.transport import Transport, TransportClosedError
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo, RobotState
from woosh_robot_agent.pb.util.commu_pack_pb2 import Subscription
from woosh_robot_agent.sentences import NOT_SENT, Sentence, said_by

_SILENT = Sentence(
    "nothing was heard for {seconds} s; check that the robot is on and that the network reaches it"
)
_READS_NOTHING = Sentence(
    "the chassis has read nothing for {seconds} s; bytes waiting to be sent: {bytes}"
)
NAMED_NOT_SENT = Sentence("{name} was not sent: {reason}")
"""Tells that a request was not sent, and why."""
_INTERNAL = Sentence("internal error: {error}")
_TOO_MANY = Sentence(
    "{name} was not sent because {count} requests are in flight; wait for their answers, or call "
    "less often"
)
_BUSY = Sentence("the connection was busy until the request was too old")()
_NO_ANSWER = Sentence(
    "the chassis did not answer {name} within {seconds} s; whether it took effect is not known"
)


class Expiry:
    """Timer that many requests share: calls a function when the earliest deadline has passed.

    The timer is set again only for an earlier deadline. This is cheaper than a timer per request.

    Args:
        expire: called with the loop time; fails the requests whose deadline has passed, and returns
            the next deadline, or infinity if there is none.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, expire: Callable[[float], float]) -> None:
        self._loop = loop
        self._expire = expire
        self._timer: asyncio.TimerHandle | None = None
        self._at = math.inf
        """Loop time of the timer; infinite without one."""

    def watch(self, deadline: float) -> None:
        """Add a deadline, in loop time."""
        if deadline < self._at:
            self.cancel()
            self._at = deadline
            self._timer = self._loop.call_at(deadline, self._due)

    def cancel(self) -> None:
        """Forget all deadlines."""
        if self._timer is not None:
            self._timer.cancel()
        self._timer, self._at = None, math.inf

    def _due(self) -> None:
        """Fail what is overdue, and set the timer for the deadline after it."""
        self._timer, self._at = None, math.inf
        self.watch(self._expire(self._loop.time()))


_IDLE_SHARE = 0.4
"""Share of the timeout that may pass in silence before the other end is probed."""
_MARGIN = 0.03
"""Share of the timeout kept for timers that fire late, so that the timeout is not exceeded."""
_STEP_SHARE = 0.02
"""Longest step in which the answer to a probe is awaited, as a share of the timeout.

A wait that ends late by no more than this counts in full.
"""


class Liveness:
    """Decides whether the other end of one connection is alive.

    Signs of life are valid frames. Bytes of unfinished frames in either direction count, too: a map
    of several MiB may take longer than the timeout.

    Time in which this program is busy does not count as silence, because what arrives meanwhile is
    still unread. The program was busy if a wait ends later than it should.

    Args:
        timeout: time without a sign of life after which the link counts as lost, in seconds.
        probe: asks for a sign of life and waits for it.
        sent: returns the number of frames that the transport has taken so far.
    """

    def __init__(
        self,
        transport: Transport,
        timeout: float,
        probe: Callable[[], Awaitable[None]],
        sent: Callable[[], int],
    ) -> None:
        self._transport = transport
        self._timeout = timeout
        self._usable_timeout = timeout * (1 - _MARGIN)
        """Silence after which the link counts as lost, in seconds."""
        self._probe = probe
        self._sent = sent
        self._loop_time = asyncio.get_running_loop().time
        self._wait_ends = self._loop_time()
        """Latest time at which the current wait should end; the time after it is not counted."""
        self._alive_at = self._loop_time()
        """Time of the last sign of life, plus the time since then that is not counted."""
        self._accepted_at = self._loop_time()
        """Time at which the other end last accepted bytes, or no bytes were waiting, plus the time
        since then that is not counted."""
        self._sent_before = sent()
        """Number of frames sent, at the last check."""
        self._backlog_before = 0
        """Number of bytes waiting to be sent, at the last check."""

    def note_alive(self) -> None:
        """Note a sign of life."""
        self._alive_at = self._loop_time()

    async def watch(self) -> None:
        """Watch the connection for as long as the other end is alive; probe it while it is silent.

        An answer to the probe is a sign of life, but so is any other frame. Each wait goes through
        `_spend`, so that time in which this program is busy does not count as silence.

        Raises:
            ConnectionLostError: the other end is no longer alive.
        """
        idle, step = self._timeout * _IDLE_SHARE, self._timeout * _STEP_SHARE
        while True:
            while (quiet := self._measure_silence()) < idle:
                await self._spend(idle - quiet, asyncio.sleep(idle - quiet))
            probe = asyncio.ensure_future(self._probe_once())
            try:
                while quiet >= idle and not probe.done():
                    if quiet >= self._usable_timeout:
                        raise ConnectionLostError(_SILENT(seconds=f"{self._timeout:g}"))
                    rest = min(step, self._usable_timeout - quiet)
                    await self._spend(rest, asyncio.wait({probe}, timeout=rest))
                    quiet = self._measure_silence()
                if probe.done():
                    probe.result()
            except (RequestTimeoutError, SupersededError):
                pass  # the probe was not answered or not even sent: only the silence decides
            finally:
                await cancel_and_wait(probe)

    async def _spend(self, seconds: float, wait: Awaitable[object]) -> None:
        """Await something that should take at most `seconds`; if longer, this program was busy."""
        self._wait_ends = self._loop_time() + seconds + self._timeout * _STEP_SHARE
        await wait

    async def _probe_once(self) -> None:
        """Probe the other end; its answer is a sign of life."""
        await self._probe()
        self.note_alive()

    def _measure_silence(self) -> float:
        """Look for signs of life at the transport; return the time since the last, in seconds.

        Raises:
            ConnectionLostError: the other end has stopped reading.
        """
        now = self._loop_time()
        busy = max(0.0, now - self._wait_ends)
        self._wait_ends = now
        self._alive_at = min(now, max(self._alive_at, self._transport.progress_at) + busy)
        self._accepted_at += busy
        sent, backlog = self._sent(), self._transport.backlog()
        has_sent, has_drained = sent != self._sent_before, backlog < self._backlog_before
        self._sent_before, self._backlog_before = sent, backlog
        if has_drained:  # the other end has read something
            self._alive_at = now
        if has_drained or has_sent or not backlog:
            self._accepted_at = now
        elif now - self._accepted_at >= self._timeout:
            seconds = f"{self._timeout:g}"
            raise ConnectionLostError(_READS_NOTHING(seconds=seconds, bytes=backlog))
        return now - self._alive_at


_LOG = logging.getLogger(__name__)
_ROBOT_INFO = full_name(RobotInfo)
_MAX_SN = 2**31 - 1
"""Largest serial number; the next one is 1."""
_SMALL_FRAME = 4096
"""Length up to which a frame is sent without the writer, in characters or bytes. Transports with an
empty buffer take frames of this size at once."""
_TIME_SLICE = 0.005
"""Time after which the reader lets other tasks run, in seconds, so that a flood does not starve
them."""

_MAX_BURST = 25
"""Number of frames after which the reader lets other tasks run, so that the pushes among them are
delivered before their queue overflows."""
_MAX_DECODING = 2
"""Maximum number of large frames that are being decoded or wait for it. One more stops the reader
until one is decoded, so that the chassis has to wait, too."""


class Sending(NamedTuple):
    """How a request is sent, and what happens with its answer.

    Attributes:
        timeout: time to wait for the answer, in seconds; None for the default of the request.
        first: True to send it ahead of all other waiting frames, and even if `max_in_flight`
            requests are in flight.
        urgent: True to send it even if `max_in_flight` requests are in flight, and not to count it
            as one of them.
        within: maximum time for which the request may wait to be sent, in seconds.
        always: True to send it even if `ChassisClient.permit_only` excludes it.
        tap: callback that gets the answer in order with the pushes before and after it.
    """

    timeout: float | None = None
    first: bool = False
    urgent: bool = False
    within: float = math.inf
    always: bool = False
    tap: Callable[[Answer], None] | None = None


class Traffic(NamedTuple):
    """Amount of data that a connection has received, and has yet to send.

    Attributes:
        received: number of bytes received so far, those of an unfinished frame included.
        waiting: number of bytes that wait to be sent.
    """

    received: int = 0
    waiting: int = 0


@dataclass(slots=True)
class _Pending:
    """A request that is waiting for its answer.

    Attributes:
        name: protobuf full name of the request.
        future: gets the answer.
        timeout: time to wait for the answer, in seconds.
        deadline: loop time at which the waiting ends.
        tap: called with the answer as soon as it is read; None without a `tap`.
    """

    message: Message
    name: str
    future: asyncio.Future[Answer]
    timeout: float
    deadline: float
    tap: Callable[[Answer], None] | None


@dataclass(slots=True)
class _Outgoing:
    """A frame that waits to be sent.

    Attributes:
        data: the frame; None while the thread for large messages encodes it.
        deadline: loop time until which it may be sent.
        urgent: True if it may overtake frames that are not encoded yet.
    """

    data: str | bytes | None
    deadline: float
    urgent: bool


def _not_connected(name: str, cause: LinkError) -> NotConnectedError:
    """Return the error of a request that was not sent before `cause` ended the connection."""
    error = NotConnectedError(NAMED_NOT_SENT(name=name, reason=said_by(cause)))
    error.__cause__ = cause
    return error


class Connection:
    """One connection over an open transport; cannot be reused after its end.

    Large frames are encoded and decoded in the thread for large messages, see `offload`.

    Args:
        transport: an open transport; the connection closes it.
        config: timeouts and limits.
        on_push: called with each push, and with True if the push arrived alone: no other frame was
            waiting to be read. Must not block.

    Attributes:
        config: timeouts and limits. Timeouts in a new configuration take effect at once.
        reads_ahead: True if frames that come after a large one may overtake it. It is False during
            the handshake, so that no push overtakes the RobotInfo, which would then replace newer
            values.
        ended: future that gets the cause when the connection has ended.
    """

    def __init__(
        self,
        transport: Transport,
        codec: Codec,
        config: LinkConfig,
        record: LinkRecord,
        on_push: Callable[[Envelope, bool], None],
    ) -> None:
        self.config = config
        self.reads_ahead = False
        self._transport = transport
        self._codec = codec
        self._stats = record.stats
        self._log = record.log
        self._drops = record.drops
        self._on_push = on_push
        record.stats.clock_offset = None  # until the chassis has told its time again
        self._loop = asyncio.get_running_loop()
        self.ended: asyncio.Future[LinkError] = self._loop.create_future()
        self._cause: LinkError | None = None
        """The error that ended the connection."""
        self._pending: dict[int, _Pending] = {}
        """Requests that wait for their answers, by serial number."""
        self._urgent_pending = 0
        """Number of pending requests that are urgent."""
        self._expiry = Expiry(self._loop, self._expire)
        self._outbox: OrderedDict[int, _Outgoing] = OrderedDict()
        """Frames that wait to be sent, by serial number; subscribe frames have negative keys."""
        self._outbox_changed = asyncio.Event()
        self._writing = False
        """True while the writer waits for the transport to take a frame."""
        self._next_sn = 1
        """Serial number of the next request."""
        self._subscribe_frames = 0
        """Number of subscribe frames so far."""
        self._sent = 0
        """Number of frames that the transport has taken."""
        self._liveness = Liveness(
            transport, config.liveness_timeout, self._probe, lambda: self._sent
        )
        self._decoding_slots = asyncio.Semaphore(_MAX_DECODING)
        self._large_tasks: set[asyncio.Task[None]] = set()
        """Tasks that wait for large frames to be decoded or encoded."""
        self._newer: list[set[str]] = []
        """For each large frame that is being decoded, the types of the pushes read after it."""
        transport.take_at_once(self._take)
        self._tasks = [
            self._loop.create_task(self._guard(work), name=f"link {work.__name__}")
            for work in (self._read, self._write, self._liveness.watch)
        ]

    async def request(self, message: Message, how: Sending) -> Answer:
        """Send a request and wait for its answer, which may be a refusal.

        Raises:
            NotConnectedError: the connection has ended, and nothing was sent; has the cause.
            LinkError: no answer arrived; `ChassisClient.request` lists the classes.
        """
        name = full_name(message)
        if self._cause is not None:
            raise _not_connected(name, self._cause)
        urgent = how.urgent or how.first
        if not urgent:
            self._check_in_flight(name)
        wait = self.config.request_timeout if how.timeout is None else how.timeout
        sn = self._take_sn()
        started = self._loop.time()
        future: asyncio.Future[Answer] = self._loop.create_future()
        pending = _Pending(message, name, future, wait, started + wait, how.tap)
        self._pending[sn] = pending
        self._urgent_pending += urgent
        self._expiry.watch(pending.deadline)
        try:
            encode = partial(
                self._codec.encode, name, message, sn=sn, timestamp=time.time_ns() // 1_000_000
            )
            data = encode() if message.ByteSize() < LARGE else None
            # a request with `first` always goes into the outbox, so that a later one with `first`
            # can get ahead of it
            if data is not None and self._is_free_for(data) and not how.first:
                await self._guard(partial(self._send, data))
            else:
                self._put(sn, _Outgoing(data, started + how.within, urgent))
                if data is None:
                    self._start_large_task(self._encode_large(sn, pending, encode))
                if how.first:
                    self._outbox.move_to_end(sn, last=False)
            answer = await future
            self._stats.round_trip = self._loop.time() - started
            return answer
        finally:
            self._discard_unsent(sn)  # the caller no longer waits for it
            del self._pending[sn]
            self._urgent_pending -= urgent

    def withdraw(self, which: Callable[[Message], bool], reason: str) -> None:
        """Withdraw requests that wait to be sent: each fails with a SupersededError."""
        for sn, pending in self._pending.items():
            if which(pending.message) and self._discard_unsent(sn) and not pending.future.done():
                pending.future.set_exception(SupersededError(NOT_SENT(reason=reason)))

    def subscribe(self, topics: list[str], *, on: bool) -> None:
        """Subscribe to or unsubscribe from pushes of these types. The chassis does not answer.

        Does nothing without types, or if the connection has ended.
        """
        if topics and self._cause is None:
            data = self._codec.encode(SUBSCRIPTION_TYPE, Subscription(topics=topics, sub=on))
            self._subscribe_frames += 1
            self._put(-self._subscribe_frames, _Outgoing(data, math.inf, urgent=False))

    async def close(self, cause: LinkError) -> None:
        """End the connection within `close_timeout`; pending requests fail with the first cause."""
        self._fail(cause)
        self._expiry.cancel()
        try:
            await cancel_and_wait(*self._tasks, *self._large_tasks)
            await self._transport.close(self.config.close_timeout)
        finally:
            self._transport.abort()

    def traffic(self) -> Traffic:
        """Return how much the connection has received, and has yet to send."""
        return Traffic(self._transport.received, self._transport.backlog())

    def debug(self) -> dict[str, int]:
        """Return the numbers of pending requests, of frames to be sent, and of running tasks."""
        return {
            "requests": len(self._pending),
            "outbox": len(self._outbox),
            "tasks": sum(not task.done() for task in (*self._tasks, *self._large_tasks)),
        }

    def _fail(self, cause: LinkError) -> None:
        """End the connection; only the first cause counts.

        Requests that were not sent fail with a NotConnectedError, the others with the cause.
        """
        if self._cause is not None:
            return
        self._cause = cause
        for sn, pending in self._pending.items():
            if not pending.future.done():
                # one error each: its traceback keeps the variables of the caller alive
                pending.future.set_exception(
                    _not_connected(pending.name, cause)
                    if sn in self._outbox
                    else type(cause)(said_by(cause))
                )
        self._outbox.clear()
        self.ended.set_result(cause)

    async def _guard(self, work: Callable[[], Awaitable[None]]) -> None:
        """Run a part of the connection's work; an error in it ends the whole connection."""
        try:
            await work()
        except TransportClosedError as error:
            self._fail(ConnectionLostError(said_by(error)))
        except LinkError as error:
            self._fail(error)
        except Exception as error:
            self._fail_unexpectedly(error)

    def _fail_unexpectedly(self, error: Exception) -> None:
        """End the connection because of a defect of this program, which is logged."""
        _LOG.exception("the link to %s failed", self._transport.peer)
        self._fail(ConnectionLostError(_INTERNAL(error=repr(error))))

    # Sending

    def _check_in_flight(self, name: str) -> None:
        """Raise TooManyRequestsError if `max_in_flight` non-urgent requests are in flight."""
        in_flight = len(self._pending) - self._urgent_pending
        if in_flight >= self.config.max_in_flight:
            text = _TOO_MANY(name=name, count=in_flight)
            self._stats.refused_requests[name] += 1
            self._drops.warn("request", text)
            raise TooManyRequestsError(text)

    def _take_sn(self) -> int:
        """Return the next serial number that no pending request has."""
        while True:
            sn = self._next_sn
            self._next_sn = sn % _MAX_SN + 1
            if sn not in self._pending:
                return sn

    def _put(self, key: int, frame: _Outgoing) -> None:
        self._outbox[key] = frame
        self._outbox_changed.set()

    def _discard_unsent(self, sn: int) -> bool:
        """Remove a request from the outbox; return False if it is not there, e.g. was sent."""
        if self._outbox.pop(sn, None) is None:
            return False
        self._outbox_changed.set()  # another frame may be the first one now
        return True

    async def _write(self) -> None:
        """Send the frames in the outbox, until cancelled."""
        while True:
            while (key := self._next_to_send()) is not None:
                frame = self._outbox.pop(key)
                if self._loop.time() > frame.deadline:
                    self._fail_outdated(key)
                elif frame.data is not None:
                    self._writing = True
                    await self._send(frame.data)
                    self._writing = False
            self._outbox_changed.clear()
            await self._outbox_changed.wait()

    def _next_to_send(self) -> int | None:
        """Return the key of the frame to send next; None if no frame can be sent now.

        Frames keep their order: while the first one is being encoded, all others wait, except for
        urgent ones.
        """
        for key, frame in self._outbox.items():
            if frame.data is not None and (frame.urgent or key == next(iter(self._outbox))):
                return key
        return None

    async def _encode_large(
        self, sn: int, pending: _Pending, encode: Callable[[], str | bytes]
    ) -> None:
        """Have a large request encoded in the thread; then its frame in the outbox can be sent."""
        try:
            data = await offload(encode)
        except Exception as error:  # raised to the caller, as for a small request
            if not pending.future.done():
                pending.future.set_exception(error)
            return
        if (frame := self._outbox.get(sn)) is not None:  # it has not been withdrawn
            frame.data = data
            self._outbox_changed.set()

    def _is_free_for(self, data: str | bytes) -> bool:
        """Return True if nothing waits ahead of a frame and the transport takes it at once.

        Then it does not have to wait for the writer's turn in the event loop.
        """
        return (
            len(data) <= _SMALL_FRAME
            and not self._outbox
            and not self._writing
            and not self._transport.backlog()
        )

    async def _send(self, data: str | bytes) -> None:
        await self._transport.send(data)
        self._sent += 1
        self._stats.tx += 1

    def _fail_outdated(self, sn: int) -> None:
        """Fail a request that has waited too long to be sent."""
        pending = self._pending.get(sn)
        if pending is not None and not pending.future.done():
            pending.future.set_exception(SupersededError(NOT_SENT(reason=_BUSY)))

    def _expire(self, now: float) -> float:
        """Fail the requests whose deadline has passed; return the next deadline."""
        following = math.inf
        for sn, pending in self._pending.items():
            if pending.future.done():
                continue
            if pending.deadline > now:
                following = min(following, pending.deadline)
                continue
            if self._discard_unsent(sn):
                self._fail_outdated(sn)
                continue
            self._stats.timeouts[pending.name] += 1
            pending.future.set_exception(
                RequestTimeoutError(_NO_ANSWER(name=pending.name, seconds=f"{pending.timeout:g}"))
            )
        return following

    # Receiving

    async def _read(self) -> None:
        """Receive frames until the connection ends."""
        slice_started = self._loop.time()
        burst = 0
        while True:
            try:
                data = await self._transport.recv()
                if len(data) < LARGE:
                    self._receive(self._codec.decode(data), alone=self._transport.waited)
                else:
                    await self._receive_large(data)
                    if not self.reads_ahead:  # during the handshake
                        await asyncio.wait(self._large_tasks)
            except FrameError as error:
                self._count_bad(error)
            now = self._loop.time()
            burst += 1
            if self._transport.waited:  # other tasks have just had their turn
                slice_started, burst = now, 0
            elif burst >= _MAX_BURST or now - slice_started > _TIME_SLICE:
                await asyncio.sleep(0)
                slice_started, burst = self._loop.time(), 0

    def _take(self, data: bytes) -> None:
        """Receive a small frame that the transport passes on as soon as it has arrived."""
        try:
            self._receive(self._codec.decode(data), alone=True)
        except FrameError as error:
            self._count_bad(error)
        except Exception as error:
            self._fail_unexpectedly(error)

    def _receive(
        self, envelope: Envelope, *, alone: bool, overtaken_by: Collection[str] = frozenset()
    ) -> None:
        """Pass on a valid frame: an answer to its request, a push to `on_push`.

        Args:
            alone: True if it is known that no other frame was waiting to be read.
            overtaken_by: types of the pushes that were read after this frame, and are passed on
                already.
        """
        self._stats.rx += 1
        self._liveness.note_alive()
        if envelope.defect:
            self._count_bad(FrameError("timestamp", envelope.defect))
        # the time for decoding a large frame would count as a difference of the clocks
        if envelope.timestamp is not None and not envelope.is_large:
            self._stats.clock_offset = envelope.timestamp / 1000 - time.time()
        if envelope.sn:
            self._answer(envelope, overtaken_by)
            return
        if not envelope.is_large:  # large frames are decoded in order: none overtakes another
            for newer in self._newer:
                newer.add(envelope.type)
        self._on_push(envelope, alone)

    async def _receive_large(self, data: str | bytes) -> None:
        """Start the decoding of a large frame; first wait while `_MAX_DECODING` others wait."""
        await self._decoding_slots.acquire()
        newer: set[str] = set()
        self._newer.append(newer)
        self._start_large_task(self._guard(partial(self._decode_and_receive, data, newer)))

    def _start_large_task(self, work: Coroutine[Any, Any, None]) -> None:
        """Start a task that waits for a large frame; `close` cancels it."""
        task = self._loop.create_task(work)
        self._large_tasks.add(task)
        task.add_done_callback(self._large_tasks.discard)

    async def _decode_and_receive(self, data: str | bytes, newer: set[str]) -> None:
        """Have a large frame decoded; receive it, unless it is a push that a newer one replaces.

        A frame that cannot be decoded is counted. In each case, the slot that `_receive_large` has
        acquired is released.

        Args:
            newer: the entry of this frame in `_newer`: the types of the pushes read after it.
        """
        try:
            envelope = await offload(self._decode_large, data)
        except FrameError as error:
            self._count_bad(error)
            return
        finally:
            self._newer = [each for each in self._newer if each is not newer]
            self._decoding_slots.release()
        only_newest_matters = not envelope.sn and envelope.type not in EVENT_PUSHES
        if only_newest_matters and envelope.type in newer:
            self._stats.dropped_pushes[envelope.type] += 1
        elif self._cause is None:  # the connection has not ended meanwhile
            self._receive(envelope, alone=False, overtaken_by=newer)

    def _decode_large(self, data: str | bytes) -> Envelope:
        """Return the envelope of a large frame, with its body decoded; runs in the thread."""
        envelope = self._codec.decode(data)
        envelope.is_large = True
        if (cls := message_types().get(envelope.type)) is not None:
            try:
                envelope.message = self._codec.body(envelope, cls)
            except FrameError:  # raised again, and counted, when a consumer reads the body
                return envelope
            if not envelope.sn:  # a push; an answer may still be read as another type
                envelope.body = None  # frees the parsed value
        return envelope

    def _answer(self, envelope: Envelope, overtaken_by: Collection[str]) -> None:
        """Give an answer to the request that waits for it.

        Args:
            overtaken_by: types of the pushes that were read after this answer, and are passed on
                already.
        """
        pending = self._pending.get(envelope.sn)
        if pending is None or pending.future.done():
            self._stats.late_answers += 1
            _LOG.debug("no request is pending for answer %d (%s)", envelope.sn, envelope.type)
            return
        body = Body(self._codec, envelope, partial(self._count_bad, name=envelope.type))
        # RobotInfo has a part for nearly each type of push: any push may be newer than its part
        is_info = envelope.type == _ROBOT_INFO
        is_outdated = envelope.type in overtaken_by or (is_info and bool(overtaken_by))
        answer = Answer(bool(envelope.ok), envelope.msg, body, is_outdated)
        pending.future.set_result(answer)
        if pending.tap is not None:
            pending.tap(answer)

    def _count_bad(self, error: FrameError, name: str = "") -> None:
        """Count and log a frame that cannot be read; `name` is the type of its body, if known."""
        self._stats.bad_frames[error.kind] += 1
        skipped = "the timestamp of a frame" if error.kind == "timestamp" else "a bad frame"
        self._log.warn(
            f"bad frame: {error.kind} {name}", f"skipped {skipped} ({error.kind}): {error}"
        )

    async def _probe(self) -> None:
        """Ping the chassis; over a transport without ping, request its RobotState instead."""
        started = self._loop.time()
        if await self._transport.ping():
            self._stats.round_trip = self._loop.time() - started
        else:
            ask = RobotState(robot_id=self.config.robot_id or None)
            await self.request(ask, Sending(self.config.liveness_timeout, urgent=True))
