"""The client of a chassis: requests, subscriptions and the state of the link."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Coroutine, Mapping
from dataclasses import replace
from typing import Any, TypeVar

from google.protobuf.message import Message

from woosh_robot_agent.link.config import (
    LinkConfig,
    LinkError,
    NotConnectedError,
    NotPermittedError,
)
from woosh_robot_agent.link.connection import NAMED_NOT_SENT, Connection, Sending, Traffic
from woosh_robot_agent.link.frames import Answer, Body
from woosh_robot_agent.link.protos import full_name, message_types
from woosh_robot_agent.link.reconnect import LinkState, ReconnectLoop
from woosh_robot_agent.link.reports import LinkRecord
from woosh_robot_agent.link.subscriptions import Consumer, Subscriptions
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo

_LOG = logging.getLogger(__name__)
M = TypeVar("M", bound=Message)
T = TypeVar("T")


def _unchanged(value: T) -> T:
    return value


class ChassisClient:
    """A link to one chassis that reconnects by itself.

    Use it in one asyncio event loop; docs/link_protocol.md has an example.

    After a reconnect, subscriptions are renewed, and no request is sent again. The client belongs
    to the first robot that answers. If a robot with another id or serial number answers later, it
    is refused: the link does not become ready, and `last_error` is an `OtherRobotError`.

    Args:
        ip: address of the chassis; None takes the one of `config`.
        config: configuration of the link; None takes the defaults.
        minimum_timeouts: minimum timeouts of slow requests, in seconds, by protobuf full name; used
            instead of a shorter `request_timeout` of the configuration.
    """

    def __init__(
        self,
        ip: str | None = None,
        config: LinkConfig | None = None,
        minimum_timeouts: Mapping[str, float] | None = None,
    ) -> None:
        base = config or LinkConfig()
        config = base if ip is None else replace(base, ip=ip)
        self._record = LinkRecord(_LOG)
        self.stats = self._record.stats
        self._subscriptions = Subscriptions(config.push_queue, self._record)
        self._reconnect = ReconnectLoop(config, self._subscriptions, self._record)
        self._delivery: asyncio.Task[None] | None = None
        self._accepted_callbacks: dict[str, list[Callable[[], None]]] = {}
        """Callbacks of `on_accepted`, by protobuf full name of the request."""
        self._minimum_timeouts = minimum_timeouts or {}
        self._refused_callbacks: list[Callable[[Message], None]] = []
        self._reserved: Callable[[Message], bool] | None = None
        """Selects the requests that only the caller of `reserve` may send; None for no request."""
        self._permitted: Callable[[Message], bool] | None = None
        """Selects the requests that may be sent; None for all of them."""
        self._refusal_reason = ""
        """Reason why requests that are not permitted are refused, and what to do."""

    @property
    def config(self) -> LinkConfig:
        """Current configuration."""
        return self._reconnect.config

    @property
    def state(self) -> LinkState:
        """State of the link."""
        return self._reconnect.state

    @property
    def since(self) -> float:
        """Unix time at which the link last became ready or was lost, in seconds.

        Before that, the time at which the client was created.
        """
        return self._reconnect.since

    @property
    def last_error(self) -> LinkError | None:
        """Error that ended the last attempt or the last link.

        None if the link is ready, or if no attempt has ended since the start.
        """
        return self._reconnect.last_error

    def debug(self) -> dict[str, int]:
        """Return the sizes of everything that may grow while the client runs.

        Call it in the event loop. The keys are:

        - `requests`: requests in flight, up to `max_in_flight`, and urgent ones.
        - `outbox`: frames that wait to be sent: the unsent ones of the requests in flight, and
          subscribe frames.
        - `pushes`: pushes and answers that wait for their consumers, up to a limit for each type.
        - `tasks`: asyncio tasks that have not ended: 5 while the link is ready, 0 after `close`.
        """
        sizes = {"requests": 0, "outbox": 0, "tasks": 0}
        if self._connection is not None:
            sizes.update(self._connection.debug())
        sizes["tasks"] += self._reconnect.task_count
        if self._delivery is not None and not self._delivery.done():
            sizes["tasks"] += 1
        return {**sizes, "pushes": self._subscriptions.queued}

    def traffic(self) -> Traffic:
        """Return how much the connection has received and has yet to send; zeros without one."""
        return Traffic() if self._connection is None else self._connection.traffic()

    # Starting and closing

    async def __aenter__(self) -> ChassisClient:
        """Start, and wait until the link is ready.

        Raises:
            NotConnectedError: the link is not ready in time.
        """
        self.start()
        limit = self.config.connect_timeout + self.config.handshake_timeout
        try:
            await self.wait_ready(limit)
        except BaseException:
            await self.close()
            raise
        return self

    async def __aexit__(self, *exc_info: object) -> None:
        await self.close()

    def start(self) -> None:
        """Start connecting, and reconnect until closed. Call it in the event loop."""
        if self._reconnect.running:
            return
        self._reconnect.start()
        deliver = self._subscriptions.deliver()
        self._delivery = asyncio.get_running_loop().create_task(deliver, name="link pushes")

    async def close(self) -> None:
        """Stop connecting and close the link, within `close_timeout`."""
        delivery = self._delivery
        if delivery is not None:
            delivery.cancel()
        await self._reconnect.stop()
        if delivery is not None and not delivery.done():
            await asyncio.wait({delivery})

    async def wait_ready(self, timeout: float) -> None:
        """Wait until the link is ready.

        Raises:
            NotConnectedError: the link was closed, or not ready within `timeout` seconds; the text
                gives the reason.
        """
        await self._reconnect.wait_ready(timeout)

    async def reconfigure(self, config: LinkConfig) -> None:
        """Apply a new configuration; reconnect if a changed value requires it.

        The robot must stay the same: if another one answers at a new address, it is refused.
        """
        await self._reconnect.reconfigure(config)

    # Requests

    async def request(
        self,
        message: Message,
        timeout: float | None = None,
        *,
        first: bool = False,
        tap: Callable[[Answer], None] | None = None,
    ) -> Answer:
        """Send a request and wait for the answer. A refusal is an answer too, with `ok` False.

        Each call sends its own request. To drive the robot with velocities (woosh.robot.Twist), use
        `woosh_robot_agent.motion.MotionGate` around the client: it sends only the newest one while
        the chassis does not answer.

        Args:
            timeout: time to wait for the answer, in seconds; by default the configured
                `request_timeout`, or the minimum timeout of the request if that is longer.
            first: True to send it ahead of all other waiting requests, and even if `max_in_flight`
                requests are in flight.
            tap: callback that gets the answer in order with the pushes: after those that arrived
                before it, and before those that arrived after it. Large pushes, and those of the
                same type behind them, may come later, and a large answer, too. `request` itself
                may return before earlier pushes are delivered.

        Raises:
            NotConnectedError: there is no link; nothing was sent.
            TooManyRequestsError: `max_in_flight` requests are in flight; nothing was sent.
            SupersededError: the request was withdrawn or waited too long; it was not sent.
            RequestTimeoutError: no answer arrived in time.
            ConnectionLostError: the link went down before the answer arrived.
            NotPermittedError: `permit_only` excludes the request; nothing was sent.
            RuntimeError: another object has reserved the request with `reserve`.
        """
        return await self.send(message, Sending(timeout, first=first, tap=tap))

    async def send(self, message: Message, how: Sending) -> Answer:
        """Send a request as `request` does, with all options; raise the same errors."""
        if self._reserved is not None and self._reserved(message):
            raise RuntimeError(
                f"{full_name(message)} is reserved; send it through the object that reserved it"
            )
        return await self._send(message, how)

    def reserve(
        self, which: Callable[[Message], bool]
    ) -> Callable[[Message, Sending], Coroutine[Any, Any, Answer]]:
        """Let only the caller send the requests that `which` selects, e.g. to enforce its rules.

        From now on, `request` and `send` raise a RuntimeError for these requests.

        Returns:
            A function that sends requests as `send` does, these included.

        Raises:
            RuntimeError: requests of this client are reserved already.
        """
        if self._reserved is not None:
            raise RuntimeError("requests of this client are reserved already")
        self._reserved = which
        return self._send

    def timeout_of(self, name: str) -> float:
        """Return the default timeout of a request, by its protobuf full name, in seconds."""
        return max(self.config.request_timeout, self._minimum_timeouts.get(name, 0.0))

    def permit_only(self, which: Callable[[Message], bool] | None, reason: str = "") -> None:
        """Limit which requests are sent; withdraw others that wait to be sent.

        The link's own requests, for RobotInfo and RobotState, only read and are always sent.

        Args:
            which: selects the requests that may be sent; None permits all of them.
            reason: why others are refused, and what to do, for error texts.
        """
        self._permitted, self._refusal_reason = which, reason
        if which is not None:
            self.withdraw(lambda message: not which(message), reason)

    def refusal(self, message: Message) -> str:
        """Return the reason why a request may not be sent; empty if it may. Thread-safe."""
        permitted = self._permitted
        if permitted is None or permitted(message):
            return ""
        return self._refusal_reason

    def check_permitted(self, message: Message) -> None:
        """Raise an error if a request may not be sent.

        Raises:
            NotPermittedError: `permit_only` excludes the request.
        """
        if reason := self.refusal(message):
            raise NotPermittedError(NAMED_NOT_SENT(name=full_name(message), reason=reason))

    def withdraw(self, which: Callable[[Message], bool], reason: str) -> None:
        """Withdraw the requests that `which` selects, as far as they still wait to be sent.

        The caller of a withdrawn request gets a SupersededError.

        Args:
            reason: the text of the error, after "not sent: ".
        """
        if self._connection is not None:
            self._connection.withdraw(which, reason)

    def on_accepted(self, cls: type[Message], callback: Callable[[], None]) -> None:
        """Call `callback` in the event loop whenever the chassis accepts a request of `cls`.

        The calls are in order with the pushes, like those of `tap` in `request`.
        """
        self._accepted_callbacks.setdefault(full_name(cls), []).append(callback)

    def on_refused(self, callback: Callable[[Message], None]) -> None:
        """Call `callback` in the event loop with each request that the chassis refuses.

        The calls are in order with the pushes, like those of `tap` in `request`. The callback is
        called before the `tap` of the same request.
        """
        self._refused_callbacks.append(callback)

    # Subscriptions

    def subscribe(self, cls: type[M], callback: Callable[[M], None]) -> Callable[[], None]:
        """Call `callback` in the event loop with each push of `cls`; it must not block.

        Returns:
            A function that ends the subscription.

        Raises:
            ValueError: the chassis has no such message.
        """
        return self.subscribe_raw(cls, callback, Body.message)

    def subscribe_raw(
        self,
        cls: type[Message],
        callback: Callable[[Any], None],
        prepare: Callable[[Body], Any] = _unchanged,
    ) -> Callable[[], None]:
        """Call `callback` in the event loop with each push of `cls`, as a `Body`.

        If `prepare` or `callback` cannot read the body, and so raises a FrameError, the subscribers
        after it do not get that push.

        Args:
            callback: called with what `prepare` returns; must not block.
            prepare: converts the `Body` of a push for the callback; by default it stays as it is.
                A large push is converted in another thread, so that it does not hold up the event
                loop.

        Returns:
            A function that ends the subscription.

        Raises:
            ValueError: the chassis has no such message.
        """
        name = full_name(cls)
        if name not in message_types():
            raise ValueError(f"{name} is not a message of the chassis")
        consumer = Consumer(callback, prepare)
        is_first = self._subscriptions.add(name, consumer)
        if is_first and self._connection is not None:
            self._connection.subscribe([name], on=True)
        ended = False

        def unsubscribe() -> None:
            nonlocal ended
            if ended:
                return
            ended = True
            was_last = self._subscriptions.remove(name, consumer)
            if was_last and self._connection is not None:
                self._connection.subscribe([name], on=False)

        return unsubscribe

    def count_bad_value(self, cls: type[Message], reason: str) -> None:
        """Count a message with a value that a consumer cannot use, e.g. an infinite number.

        The first one of each class and kind on a link is logged. Call it in the event loop.

        Args:
            reason: the defect, e.g. `x is not finite: inf`; what precedes its first colon is the
                kind.
        """
        name, kind = full_name(cls), reason.partition(":")[0]
        self.stats.bad_frames["value"] += 1
        self._record.log.warn(
            f"bad value: {kind}: {name}", f"skipped a bad value in {name}: {reason}"
        )

    def on_state(self, callback: Callable[[LinkState], None]) -> None:
        """Call `callback` in the event loop with each new state of the link."""
        self._reconnect.on_change(callback)

    def on_snapshot(
        self, callback: Callable[[Any], None], prepare: Callable[[RobotInfo], Any] = _unchanged
    ) -> None:
        """Call `callback` in the event loop with the first RobotInfo of each connection.

        The calls are in order with the pushes: pushes before the call are older than the RobotInfo,
        and pushes after it are newer.

        Args:
            callback: called with what `prepare` returns; must not block.
            prepare: converts the RobotInfo for the callback, as in `subscribe_raw`.
        """
        self._subscriptions.on_snapshot(Consumer(callback, prepare))

    @property
    def _connection(self) -> Connection | None:
        return self._reconnect.connection

    async def _send(self, message: Message, how: Sending) -> Answer:
        """Send a request, also a reserved one, if it is permitted and the link is ready."""
        if not how.always:
            self.check_permitted(message)
        connection = self._connection
        if connection is None or self.state is not LinkState.READY:
            raise self._reconnect.not_connected()
        timeout = self.timeout_of(full_name(message)) if how.timeout is None else how.timeout
        tap = self._queueing_tap(message, how.tap)
        try:
            return await connection.request(message, how._replace(timeout=timeout, tap=tap))
        except NotConnectedError as error:  # the connection has just ended
            self._reconnect.note_lost(error.__cause__)
            raise self._reconnect.not_connected() from None

    def _queueing_tap(
        self, message: Message, tap: Callable[[Answer], None] | None
    ) -> Callable[[Answer], None]:
        """Return a function that queues the answer to `message` behind the pushes received before.

        From the queue, the answer goes to the callbacks of `on_accepted` or `on_refused`, then to
        `tap`, so that they get answers and pushes in order of arrival. An answer for which there is
        neither a callback nor a `tap` is not queued.
        """
        on_accepted = self._accepted_callbacks.get(full_name(message), ())

        def call_all(answer: Answer) -> None:
            if answer.ok:
                for accepted in on_accepted:
                    accepted()
            else:
                for refused in self._refused_callbacks:
                    refused(message)
            if tap is not None:
                tap(answer)

        def put(answer: Answer) -> None:
            callbacks = on_accepted if answer.ok else self._refused_callbacks
            if callbacks or tap is not None:
                self._subscriptions.put_answer(call_all, answer)

        return put
