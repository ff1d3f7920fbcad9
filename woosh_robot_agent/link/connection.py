"""One connection to a chassis, used once: reader, writer, requests and liveness."""

from __future__ import annotations

import asyncio
import logging
import math
import time
from collections import OrderedDict
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from google.protobuf.message import Message

from woosh_robot_agent.link.body import Body
from woosh_robot_agent.link.codecs.frames import SUBSCRIPTION_TYPE, Codec, Envelope, FrameError
from woosh_robot_agent.link.config import LinkConfig
from woosh_robot_agent.link.drop_log import Losses
from woosh_robot_agent.link.errors import (
    ConnectionLostError,
    LinkError,
    NotConnectedError,
    RequestTimeoutError,
    SupersededError,
    TooManyRequestsError,
)
from woosh_robot_agent.link.liveness import Liveness
from woosh_robot_agent.link.log_once import LogOnce
from woosh_robot_agent.link.stats import LinkStats
from woosh_robot_agent.link.timeouts import drop
from woosh_robot_agent.link.transports import Transport, TransportClosedError
from woosh_robot_agent.pb.robot.robot_pb2 import RobotState
from woosh_robot_agent.pb.util.commu_pack_pb2 import Subscription
from woosh_robot_agent.protos import full_name

_LOG = logging.getLogger(__name__)
_MAX_SN = 2**31 - 1
_TURN = 0.005
"""s after which the reader lets others work, so that a flood does not starve them."""


@dataclass(frozen=True)
class Answer:
    """What the chassis answered.

    Attributes:
        ok: whether the chassis accepted the request.
        msg: the chassis's text, untouched.
        raw: the answer's body, not read yet.
    """

    ok: bool
    msg: str
    raw: Body

    @property
    def type(self) -> str:
        """Protobuf full name of the body, as the chassis gives it."""
        return self.raw.type

    @property
    def body(self) -> Message | None:
        """The answer's message; None where it has an unknown type or cannot be read."""
        try:
            return self.raw.message()  # type: ignore[no-any-return]
        except FrameError:
            return None

    @property
    def defect(self) -> str:
        """Why `body` is None, else empty."""
        try:
            self.raw.message()
        except FrameError as error:
            return f"the answer cannot be read: {error}"
        return ""


class Connection:
    """Runs over one open transport until it ends or is closed; never used again after that.

    Args:
        transport: open, and from now on owned by the connection.
        codec: encoding of all frames.
        config: timeouts and limits; those that are read each time may be changed.
        stats: counters to add to.
        log: for what is told once.
        losses: for what is dropped.
        on_push: gets each push; must not block.
    """

    def __init__(
        self,
        transport: Transport,
        codec: Codec,
        config: LinkConfig,
        stats: LinkStats,
        log: LogOnce,
        losses: Losses,
        on_push: Callable[[Envelope], None],
    ) -> None:
        self._transport = transport
        self._codec = codec
        self.config = config
        self._stats = stats
        self._log = log
        self._losses = losses
        self._on_push = on_push
        self._loop = asyncio.get_running_loop()
        self._pending: dict[int, asyncio.Future[Answer]] = {}
        self._urgent: set[int] = set()
        self._taps: dict[int, Callable[[Answer], None]] = {}
        self._outbox: OrderedDict[int, tuple[str | bytes, float]] = OrderedDict()
        """Frames to send, and the loop time until when, by sn; subscriptions have negative keys."""
        self._requests: dict[int, Message] = {}
        """Those that wait for their answers, by sn."""
        self._outbox_filled = asyncio.Event()
        self._next_sn = 1
        self._subscribes = 0
        self._sent = 0
        self._liveness = Liveness(
            transport, config.liveness_timeout, self._probe, lambda: self._sent
        )
        self._cause: LinkError | None = None
        self.ended: asyncio.Future[LinkError] = self._loop.create_future()
        """Done with the cause when the connection has ended."""
        self._tasks = [
            self._loop.create_task(self._guard(work), name=f"link {work.__name__}")
            for work in (self._read, self._write, self._liveness.watch)
        ]

    async def request(
        self,
        message: Message,
        timeout: float | None = None,
        *,
        urgent: bool = False,
        first: bool = False,
        fresh: float = math.inf,
        tap: Callable[[Answer], None] | None = None,
    ) -> Answer:
        """Send a request and wait for its answer, a refusal included.

        Args:
            message: the request; its full name is the frame's type.
            timeout: s to wait, the configured `request_timeout` by default.
            urgent: send it even when too many requests wait already; it keeps no other out.
            first: send it before everything that has not been sent yet.
            fresh: s after which it is too old to be sent, if the connection is that busy.
            tap: gets the answer the moment it is read, in order with the pushes.

        Raises:
            NotConnectedError: the connection has ended; nothing was sent.
            TooManyRequestsError: nothing was sent.
            SupersededError: it was not fresh any more; it was not sent.
            RequestTimeoutError: no answer in time.
            ConnectionLostError: the connection ended first.
        """
        name = full_name(message)
        if self._cause is not None:
            raise NotConnectedError(f"{name} was not sent: {self._cause}") from self._cause
        waiting = len(self._pending) - len(self._urgent)
        if waiting >= self.config.max_in_flight and not urgent:
            text = (
                f"{name} was not sent: {waiting} requests wait for the chassis's answer "
                "already; call more slowly, or raise max_in_flight"
            )
            self._stats.refused_requests[name] += 1
            self._losses.count("requests were refused because too many waited", text)
            raise TooManyRequestsError(text)
        waited = self.config.request_timeout if timeout is None else timeout
        sn = self._take_sn()
        data = self._codec.encode(name, message, sn=sn, timestamp=time.time_ns() // 1_000_000)
        future: asyncio.Future[Answer] = self._loop.create_future()
        self._pending[sn] = future
        self._requests[sn] = message
        if urgent:
            self._urgent.add(sn)
        if tap is not None:
            self._taps[sn] = tap
        started = self._loop.time()
        timer = self._loop.call_later(waited, self._expire, future, name, waited)
        try:
            self._put(sn, data, self._loop.time() + fresh)
            if first:
                self._outbox.move_to_end(sn, last=False)
            answer = await future
            self._stats.round_trip = self._loop.time() - started
            return answer
        finally:
            timer.cancel()
            self._outbox.pop(sn, None)  # nobody waits for it any more: not to be sent late
            self._pending.pop(sn, None)
            self._requests.pop(sn, None)
            self._urgent.discard(sn)
            self._taps.pop(sn, None)

    def withdraw(self, which: Callable[[Message], bool], reason: str) -> None:
        """Do not send those requests for which `which` is true, if they have not been sent yet.

        Those who wait for their answers get a SupersededError with `reason`.
        """
        waiting = [sn for sn in self._outbox if sn in self._requests]
        for sn in [sn for sn in waiting if which(self._requests[sn])]:
            del self._outbox[sn]
            future = self._pending[sn]
            if not future.done():
                future.set_exception(SupersededError(f"not sent: {reason}"))

    def subscribe(self, topics: list[str], *, on: bool) -> None:
        """Ask for pushes of these types, or no more of them; the chassis does not answer this."""
        if topics and self._cause is None:
            data = self._codec.encode(SUBSCRIPTION_TYPE, Subscription(topics=topics, sub=on))
            self._subscribes += 1
            self._put(-self._subscribes, data, math.inf)

    async def close(self, cause: LinkError) -> None:
        """End the connection: fail what waits with the first cause, close within the bound."""
        self._fail(cause)
        try:
            await drop(*self._tasks)
            await self._transport.close(self.config.close_timeout)
        finally:
            self._transport.abort()

    def _fail(self, cause: LinkError) -> None:
        if self._cause is not None:
            return
        self._cause = cause
        for future in self._pending.values():
            if not future.done():  # each its own error: a raised one holds on to its callers
                future.set_exception(type(cause)(str(cause)))
        self._outbox.clear()
        if not self.ended.done():
            self.ended.set_result(cause)

    async def _guard(self, work: Callable[[], Awaitable[None]]) -> None:
        """Let one of the connection's tasks end the whole connection, whatever ended the task."""
        try:
            await work()
        except asyncio.CancelledError:
            raise
        except TransportClosedError as error:
            self._fail(ConnectionLostError(str(error)))
        except LinkError as error:
            self._fail(error)
        except Exception as error:
            _LOG.exception("the link to %s failed", self._transport.peer)
            self._fail(ConnectionLostError(f"internal error: {error!r}"))

    # Sending

    def _take_sn(self) -> int:
        while True:
            sn = self._next_sn
            self._next_sn = sn % _MAX_SN + 1
            if sn not in self._pending:
                return sn

    def _put(self, key: int, data: str | bytes, until: float) -> None:
        self._outbox[key] = data, until
        self._outbox_filled.set()

    async def _write(self) -> None:
        while True:
            while self._outbox:
                key, (data, until) = self._outbox.popitem(last=False)
                if self._loop.time() > until:
                    self._outdated(self._pending.get(key))
                    continue
                await self._transport.send(data)
                self._sent += 1
                self._stats.tx += 1
            self._outbox_filled.clear()
            await self._outbox_filled.wait()

    @staticmethod
    def _outdated(future: asyncio.Future[Answer] | None) -> None:
        if future is not None and not future.done():
            future.set_exception(
                SupersededError("not sent: the connection was busy until it was too old")
            )

    def _expire(self, future: asyncio.Future[Answer], name: str, waited: float) -> None:
        if not future.done():
            self._stats.timeouts[name] += 1
            future.set_exception(
                RequestTimeoutError(
                    f"the chassis did not answer {name} within {waited:g} s; whether it took "
                    "effect is not known"
                )
            )

    # Receiving

    async def _read(self) -> None:
        turn = self._loop.time()
        while True:
            try:
                envelope = self._codec.decode(await self._transport.recv())
            except FrameError as error:
                self._count_bad(error)
            else:
                self._stats.rx += 1
                self._liveness.heard()
                if envelope.sn:
                    self._answer(envelope)
                else:
                    self._on_push(envelope)
            if self._loop.time() - turn > _TURN:
                await asyncio.sleep(0)
                turn = self._loop.time()

    def _answer(self, envelope: Envelope) -> None:
        future = self._pending.get(envelope.sn)
        if future is None or future.done():
            self._stats.late_answers += 1
            _LOG.debug("nobody waits for answer %d (%s)", envelope.sn, envelope.type)
            return
        body = Body(self._codec, envelope, self._count_bad)
        answer = Answer(bool(envelope.ok), envelope.msg, body)
        future.set_result(answer)
        if tap := self._taps.get(envelope.sn):
            tap(answer)

    def _count_bad(self, error: FrameError) -> None:
        self._stats.bad_frames[error.kind] += 1
        self._log.warn(f"bad frame: {error.kind}", f"skipped a bad frame ({error.kind}): {error}")

    async def _probe(self) -> None:
        started = self._loop.time()
        if await self._transport.ping():
            self._stats.round_trip = self._loop.time() - started
        else:
            ask = RobotState(robot_id=self.config.robot_id or None)
            await self.request(ask, self.config.liveness_timeout, urgent=True)
