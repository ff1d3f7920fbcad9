"""Messages of clients and pushes to clients, and the hooks by which faults change them."""

from __future__ import annotations

import asyncio
import logging
from collections import Counter, deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, TypeVar

from google.protobuf.message import Message

from woosh_robot_agent.link.codecs import server_codec
from woosh_robot_agent.link.frames import SUBSCRIPTION_TYPE, SUBSCRIPTION_TYPES, Codec, FrameError
from woosh_robot_agent.link.protos import message_type
from woosh_robot_agent.link.server import ConnectedClient, Encoded, ServerTransport
from woosh_robot_agent.pb.util.commu_pack_pb2 import Subscription
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.config import SimulatorConfig
from woosh_robot_agent.simulator.protocol.handlers import (
    HANDLERS,
    QUERIES,
    Answer,
    dispatch,
    refusal_answer,
)
from woosh_robot_agent.simulator.protocol.reports import TOPICS, StateWatch

Damage = Callable[[Codec, str | bytes], Encoded]
"""Returns the damaged form of an encoded frame."""

Release = Callable[[], None]
"""Sends a frame that was held back; called once."""


@dataclass(frozen=True, slots=True)
class Outgoing:
    """A frame before it is encoded.

    Attributes:
        type: type of the body in the frame's envelope.
        body: body, None for an empty body.
        sn: serial number of the answered request; 0 for a push.
        ok: True if the request was executed, False if it was refused; None for a push.
        msg: text of an answer.
        request: type of the answered request; empty for a push.
        delay: real time to delay the frame, in seconds.
        hold: called with the client and a send function instead of sending the frame; None to send
            it. The delay starts when the send function is called.
        damage: applied to the encoded frame; None to leave it intact.
    """

    type: str
    body: Message | None
    sn: int = 0
    ok: bool | None = None
    msg: str = ""
    request: str = ""
    delay: float = 0.0
    hold: Callable[[object, Release], None] | None = None
    damage: Damage | None = None

    @property
    def is_answer(self) -> bool:
        """True for an answer, False for a push."""
        return self.ok is not None


Interceptor = Callable[[Outgoing], Iterable[Outgoing]]
"""Returns the frames to send instead of a frame: the same frame, other frames, or none."""

_T = TypeVar("_T")


class Hooks:
    """Functions by which faults and tests intervene; `add_hook` adds one.

    Attributes:
        admissions: called for each new connection; return False to drop it.
        refusals: called with the type of each request before it is executed; return the reason to
            refuse it, or None. If several refuse it, the one that was added last gives the reason.
        faults: interceptors of faults. All outgoing frames pass through these first.
        interceptors: interceptors of tests. All outgoing frames pass through these afterwards.
    """

    def __init__(self) -> None:
        self.admissions: list[Callable[[], bool]] = []
        self.refusals: list[Callable[[str], str | None]] = []
        self.faults: list[Interceptor] = []
        self.interceptors: list[Interceptor] = []

    def admit(self) -> bool:
        """Call the hooks for a new connection. Return False if it must be dropped."""
        return all(admit() for admit in list(self.admissions))

    def refusal(self, type_name: str) -> str | None:
        """Call the hooks for a request. Return the reason to refuse it, or None."""
        reasons = (refuse(type_name) for refuse in reversed(list(self.refusals)))
        return next((reason for reason in reasons if reason is not None), None)

    def outgoing(self, frame: Outgoing) -> list[Outgoing]:
        """Pass a frame through all interceptors. Return the frames to send instead."""
        frames = [frame]
        for interceptor in [*self.faults, *self.interceptors]:
            frames = [out for each in frames for out in interceptor(each)]
        return frames


def add_hook(hooks: list[_T], hook: _T) -> Callable[[], None]:
    """Add a function to one of the lists of `Hooks`, and return a function that removes it."""
    hooks.append(hook)

    def remove() -> None:
        if hook in hooks:  # a second call does nothing
            hooks.remove(hook)

    return remove


class _Delayed(NamedTuple):
    """A frame whose delay has not passed, with its encoded form."""

    timer: asyncio.TimerHandle
    frame: Outgoing
    data: Encoded


class Client(ConnectedClient):
    """The simulator's end of one connection.

    Args:
        max_outbox: maximum number of frames that wait. A client that exceeds it is dropped.

    Attributes:
        waiting: number of requests that wait to be executed or answered, and of their answers that
            a fault holds back or delays.
    """

    def __init__(self, transport: ServerTransport, max_outbox: int) -> None:
        super().__init__(transport, max_outbox)
        self.waiting = 0
        self._delayed: dict[object, _Delayed] = {}
        """Delayed frames, each by a unique key."""
        self._held = 0
        """Number of frames whose `hold` has not released them."""

    def send_outgoing(self, frame: Outgoing, data: Encoded) -> None:
        """Queue the encoded `frame` once its `hold` releases it and then its `delay` has passed."""
        if not frame.hold:
            self._send_after(frame, data)
        elif self._ensure_room():
            self._held += 1
            self.waiting += frame.is_answer
            frame.hold(self, partial(self._release, frame, data))

    def send_delayed(self) -> None:
        """Queue all delayed frames now, in the order in which they are due."""
        for key in sorted(self._delayed, key=lambda key: self._delayed[key].timer.when()):
            self._delayed[key].timer.cancel()
            self._queue_delayed(key)

    def forget(self) -> None:
        super().forget()
        for delayed in self._delayed.values():
            delayed.timer.cancel()
        self._delayed.clear()

    def _waiting_frames(self) -> int:
        return super()._waiting_frames() + self._held + len(self._delayed)

    def _release(self, frame: Outgoing, data: Encoded) -> None:
        """Send a frame that was held back."""
        self._held -= 1
        self.waiting -= frame.is_answer
        self._send_after(frame, data)

    def _send_after(self, frame: Outgoing, data: Encoded) -> None:
        """Send a frame after its delay; at once if it has none."""
        if not frame.delay:
            self.send(data)
        elif self._ensure_room():
            self.waiting += frame.is_answer
            key = object()
            timer = asyncio.get_running_loop().call_later(frame.delay, self._queue_delayed, key)
            self._delayed[key] = _Delayed(timer, frame, data)

    def _queue_delayed(self, key: object) -> None:
        delayed = self._delayed.pop(key)
        self.waiting -= delayed.frame.is_answer
        self.send(delayed.data)


_LOG = logging.getLogger(__name__)

_MAX_RECEIVED = 10_000
"""Maximum number of messages from clients that are kept."""

_MAX_RECEIVED_BYTES = 64 * 1024 * 1024
"""Maximum size of all kept messages together, in bytes."""


class Received(NamedTuple):
    """A message from a client, and its full name; a subscription has `woosh.Subscription`."""

    type: str
    message: Message


@dataclass(frozen=True, slots=True)
class Request:
    """A decoded request of a client, or its subscription.

    Attributes:
        codec: codec of the frame and of its answer.
        type: type of the body in the frame's envelope; `SUBSCRIPTION_TYPE` for a subscription.
        sn: serial number; 0 if there is none, as in subscriptions and over HTTP.
        message: body; None if it could not be decoded, or its type is unknown.
        refusal_reason: reason to refuse the request without executing it; empty if there is none.
    """

    client: Client
    codec: Codec
    type: str
    sn: int
    message: Message | None
    refusal_reason: str = ""


class MessageHandler:
    """Executes the requests of the clients, and pushes messages to them.

    Args:
        max_waiting: maximum of `Client.waiting`. Further requests are refused.

    Attributes:
        clients: connected clients.
        hooks: hooks of faults and tests.
        received: the last messages from clients, oldest first: at most 10,000 and 64 MiB.
        counts: number of readable messages from clients since the start, by type.
        bad_frames: number of frames from clients that could not be decoded.
        client_left: set when a client has disconnected.
        before_request: called for each request, before it is executed.
        frozen: True if requests are queued instead of executed.
    """

    def __init__(self, chassis: Chassis, max_waiting: int = SimulatorConfig.max_waiting) -> None:
        self.clients: set[Client] = set()
        self.client_left = asyncio.Event()
        self.hooks = Hooks()
        self.received: deque[Received] = deque()
        self.counts: Counter[str] = Counter()
        self.bad_frames = 0
        self.before_request: Callable[[], object] = lambda: None
        self.frozen = False
        self._chassis = chassis
        self._max_waiting = max_waiting
        self._received_bytes = 0
        """Size of all messages in `received`, in bytes."""
        self._watch = StateWatch(chassis)
        """Detects changes of the states to which clients have subscribed."""
        self._arrival = asyncio.Event()
        """Set, and replaced by a new event, when a message of a client arrives."""
        self._queue: deque[Request] = deque()
        """Queued requests, oldest first."""
        chassis.on_change = partial(self.report_changes, while_moving=True)

    def join(self, client: Client) -> None:
        """Add a client."""
        self.clients.add(client)

    def leave(self, client: Client) -> None:
        """Remove a client and its subscriptions."""
        client.forget()
        self.clients.discard(client)
        self.client_left.set()
        self._watch_subscribed()

    def receive(self, client: Client, data: str | bytes) -> None:
        """Handle a frame from a client. The answer has the same encoding."""
        codec = server_codec(data)
        try:
            request = self._read(client, codec, data)
        except FrameError as error:
            self.skip(client, error)
            return
        self.submit(request)

    def submit(self, request: Request) -> None:
        """Execute a request. Queue it while the chassis is frozen; refuse it if too many wait."""
        client = request.client
        self.before_request()
        if request.message is not None:
            self._record(request.type, request.message)
        # A subscription takes no time, unless it has to wait for a frozen chassis.
        may_wait = self.frozen or request.type != SUBSCRIPTION_TYPE
        if may_wait and client.waiting >= self._max_waiting:
            self._refuse_excess(request)
        elif self.frozen:
            client.waiting += 1
            self._queue.append(request)
        else:
            self._execute(request)

    def skip(self, client: Client, error: FrameError) -> None:
        """Count an unreadable frame. It gets no answer, because its serial number is unknown."""
        self.bad_frames += 1
        _LOG.debug("%s: unreadable frame: %s", client.transport.peer, error)

    def set_frozen(self, frozen: bool) -> None:
        """Queue requests from now on (True), or execute all queued ones and continue (False)."""
        self.frozen = frozen
        while self._queue and not self.frozen:
            request = self._queue.popleft()
            request.client.waiting -= 1
            try:
                self._execute(request)
            except Exception:  # from a test's interceptor, for example
                _LOG.exception("cannot handle a frame of %s", request.client.transport.peer)

    def push(self, message: Message) -> None:
        """Push a message to all subscribers of its type."""
        name = message.DESCRIPTOR.full_name
        for client in list(self.clients):
            codec = client.topics.get(name)
            if codec:
                self._send(client, codec, Outgoing(name, message))

    def report_changes(self, *, while_moving: bool) -> None:
        """Push all new events, the reports that are due, and the states that have changed.

        Args:
            while_moving: False to leave out PoseSpeed, which a moving robot would push after each
                request.
        """
        self._push_events()
        for message in self._watch.take_changes(while_moving=while_moving):
            self.push(message)

    async def wait_received(self, type_name: str, count: int) -> None:
        """Wait until clients have sent `count` messages of a type since the start of the run."""
        while self.counts[type_name] < count:
            await self._arrival.wait()

    def _read(self, client: Client, codec: Codec, data: str | bytes) -> Request:
        """Decode a frame. A request that cannot be executed gets a `refusal_reason`.

        Raises:
            FrameError: the envelope, or the body of a subscription, cannot be read.
        """
        envelope = codec.decode(data)
        name = envelope.type
        if name in SUBSCRIPTION_TYPES:
            subscription = codec.body(envelope, Subscription)
            return Request(client, codec, SUBSCRIPTION_TYPE, 0, subscription)
        if not name:
            return Request(client, codec, name, envelope.sn, None, "the request has no type")
        message, refusal_reason = None, ""
        if name not in HANDLERS:  # its message, if there is one, is decoded for `received`
            refusal_reason = f"unknown message type {name}"
        try:
            message = codec.body(envelope, message_type(name))
        except KeyError:
            pass  # no message has this type, so there is no handler either
        except FrameError as error:
            self.bad_frames += 1
            refusal_reason = f"unreadable body: {error}"
        return Request(client, codec, name, envelope.sn, message, refusal_reason)

    def _execute(self, request: Request) -> None:
        """Execute a request, and send its answer, at once or after a delay."""
        if isinstance(request.message, Subscription):
            self._subscribe(request.client, request.codec, request.message)
            return
        chassis = self._chassis
        chassis.begin_request(request.type)
        if request.type in QUERIES:
            # Execute a query when its answer is due: an older value must not follow a newer push.
            self._after_delay(request, lambda: self._send_answer(request, self._answer(request)))
            return
        answer = self._answer(request)
        # Events are pushed before the answer to the request that caused them. Changed states are
        # pushed after the answer, or before it if `state_first` is set.
        if chassis.state_first:
            self.report_changes(while_moving=False)
        else:
            self._push_events()
        self._after_delay(request, lambda: self._send_answer(request, answer))

    def _after_delay(self, request: Request, send: Callable[[], None]) -> None:
        """Call `send`, which answers a request, after the delay that the chassis has chosen.

        A client that has left meanwhile gets no answer. Changed states are reported afterwards; for
        a delayed call, `chassis.on_change` does that.
        """
        delay = self._chassis.answer_delay
        if delay <= 0.0:
            send()
            self.report_changes(while_moving=False)
            return
        request.client.waiting += 1

        def send_late() -> None:
            request.client.waiting -= 1
            if request.client in self.clients:
                send()

        self._chassis.after(delay, send_late)

    def _send_answer(self, request: Request, answer: Answer) -> None:
        """Send an answer, and report its status code if it has one."""
        out = Outgoing(
            answer.type, answer.body, request.sn, answer.ok, answer.msg, request=request.type
        )
        self._send(request.client, request.codec, out)
        if answer.code:
            self._chassis.codes.report(answer.code)

    def _answer(self, request: Request) -> Answer:
        """Execute or refuse a request, and return the answer."""
        name = request.type
        if request.message is None or request.refusal_reason:
            return refusal_answer(name, request.refusal_reason)
        reason = self.hooks.refusal(name)
        if reason is not None:
            return refusal_answer(name, reason)
        try:
            return dispatch(self._chassis, request.message)
        except Exception:  # a bug in a handler must not end the client's connection
            _LOG.exception("cannot execute %s", name)
            return refusal_answer(name, "internal error of the simulator: see its log")

    def _refuse_excess(self, request: Request) -> None:
        """Refuse a request beyond the limit at once. Faults do not affect this answer."""
        text = (
            f"{self._max_waiting} requests of this connection are waiting: "
            "wait for their answers first"
        )
        if request.type == SUBSCRIPTION_TYPE:  # it has no answer that could refuse it
            _LOG.warning("%s is dropped: %s", request.client.transport.peer, text)
            request.client.drop()
            return
        answer = refusal_answer(request.type, text)
        frame = Outgoing(answer.type, None, request.sn, answer.ok, answer.msg)
        request.client.send(self._encoded(request.codec, frame))

    def _subscribe(self, client: Client, codec: Codec, subscription: Subscription) -> None:
        """Add or remove subscriptions; pushes have the encoding of the subscription."""
        # A new subscriber must not get changes from before its subscription.
        self.report_changes(while_moving=False)
        for topic in subscription.topics:
            if topic in TOPICS and subscription.sub:
                client.topics[topic] = codec
            else:
                client.topics.pop(topic, None)
        self._watch_subscribed()

    def _watch_subscribed(self) -> None:
        self._watch.watch({topic for client in self.clients for topic in client.topics})

    def _record(self, type_name: str, message: Message) -> None:
        """Count and keep a message of a client, and wake every `wait_received`."""
        self.counts[type_name] += 1
        self.received.append(Received(type_name, message))
        self._received_bytes += message.ByteSize()
        while len(self.received) > _MAX_RECEIVED or self._received_bytes > _MAX_RECEIVED_BYTES:
            self._received_bytes -= self.received.popleft().message.ByteSize()
        self._arrival.set()
        self._arrival = asyncio.Event()

    def _push_events(self) -> None:
        for message in self._chassis.take_events():
            self.push(message)

    def _send(self, client: Client, codec: Codec, frame: Outgoing) -> None:
        """Send a frame, after the hooks of faults and tests have replaced or damaged it."""
        for out in self.hooks.outgoing(frame):
            data = self._encoded(codec, out)
            client.send_outgoing(out, out.damage(codec, data) if out.damage else data)

    def _encoded(self, codec: Codec, out: Outgoing) -> str | bytes:
        """Return an encoded frame with the time of the robot's clock."""
        timestamp = round(self._chassis.time * 1000)
        return codec.encode(
            out.type, out.body, sn=out.sn, ok=out.ok, msg=out.msg, timestamp=timestamp
        )
