"""The conversation with all clients: requests in, answers and pushes out. No sockets, no clock."""

from __future__ import annotations

import asyncio
import logging
from collections import Counter, deque
from typing import NamedTuple

from google.protobuf.message import Message

from woosh_robot_agent.link.frames import SUBSCRIPTION_TYPE, Codec, Envelope, FrameError
from woosh_robot_agent.pb.util.commu_pack_pb2 import Subscription
from woosh_robot_agent.protos import message_type
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.client import Client, codec_of
from woosh_robot_agent.simulator.dispatch import HANDLERS, Answer, dispatch, refusal
from woosh_robot_agent.simulator.hooks import Hooks, Outgoing
from woosh_robot_agent.simulator.pushes import TOPICS, StateWatch

_log = logging.getLogger(__name__)

_RECEIVED_KEPT = 10_000
_SUBSCRIPTIONS = (SUBSCRIPTION_TYPE, Subscription.DESCRIPTOR.full_name)


class Received(NamedTuple):
    """A message that a client sent; the type of a subscription is `woosh.Subscription`."""

    type: str
    message: Message


class Exchange:
    """What goes between a chassis and its clients.

    Attributes:
        clients: Those that are connected.
        hooks: What is to go otherwise than usual.
        received: What clients sent, oldest first; the last ten thousand.
        counts: How many messages of each type they sent since the start.
        bad_frames: How many frames could not be read.
    """

    def __init__(self, chassis: Chassis) -> None:
        self.clients: set[Client] = set()
        self.hooks = Hooks()
        self.received: deque[Received] = deque(maxlen=_RECEIVED_KEPT)
        self.counts: Counter[str] = Counter()
        self.bad_frames = 0
        self._chassis = chassis
        self._watch = StateWatch(chassis)
        self._arrival = asyncio.Event()

    def join(self, client: Client) -> None:
        """Talk to a new client."""
        self.clients.add(client)

    def leave(self, client: Client) -> None:
        """Forget a client and its subscriptions."""
        self.clients.discard(client)
        self._watch_subscribed()

    def receive(self, client: Client, data: str | bytes) -> None:
        """Deal with a frame, in the encoding in which it came."""
        codec = codec_of(data)
        try:
            envelope = codec.decode(data)
            if envelope.type in _SUBSCRIPTIONS:
                self._subscribe(client, codec, codec.body(envelope, Subscription))
                return
        except FrameError as error:
            self.skip(client, error)
            return
        answer = self._answer(codec, envelope)
        # What a request ended is said before its answer, what it changed after it.
        self._push_events()
        self._send(
            client,
            codec,
            Outgoing(
                answer.type, answer.body, envelope.sn, answer.ok, answer.msg, request=envelope.type
            ),
        )
        self.report_changes(while_moving=False)

    def skip(self, client: Client, error: FrameError) -> None:
        """Count a frame that nobody can read; there is nothing that an answer could refer to."""
        self.bad_frames += 1
        _log.debug("%s: unreadable frame: %s", client.transport.peer, error)

    def push(self, message: Message) -> None:
        """Push a message to everybody who subscribed to its type."""
        name = message.DESCRIPTOR.full_name
        for client in list(self.clients):
            codec = client.topics.get(name)
            if codec:
                self._send(client, codec, Outgoing(name, message))

    def report_changes(self, *, while_moving: bool) -> None:
        """Push what happened and what changed since the last time.

        Args:
            while_moving: Include the pose, which changes with every step of a moving robot.
        """
        self._push_events()
        for message in self._watch.changed(while_moving=while_moving):
            self.push(message)

    async def arrived(self, type_name: str, count: int) -> None:
        """Wait until clients have sent `count` messages of a type since the start."""
        while self.counts[type_name] < count:
            await self._arrival.wait()

    def _answer(self, codec: Codec, envelope: Envelope) -> Answer:
        name = envelope.type
        if not name:
            return refusal(name, "the request has no type")
        try:
            request = codec.body(envelope, message_type(name))
        except KeyError:
            return refusal(name, f"unknown message type {name}")
        except FrameError as error:
            self.bad_frames += 1
            return refusal(name, f"unreadable body: {error}")
        self._record(name, request)
        if name not in HANDLERS:
            return refusal(name, f"unknown message type {name}")
        reason = self.hooks.refusal(name)
        if reason is not None:
            return refusal(name, reason)
        try:
            return dispatch(self._chassis, request)
        except Exception:  # a fault of ours must not end the client's connection
            _log.exception("%s failed", name)
            return refusal(name, "internal error of the simulator: see its log")

    def _subscribe(self, client: Client, codec: Codec, subscription: Subscription) -> None:
        self._record(SUBSCRIPTION_TYPE, subscription)
        # What changed before is not for the new subscriber.
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
        self.counts[type_name] += 1
        self.received.append(Received(type_name, message))
        self._arrival.set()
        self._arrival = asyncio.Event()

    def _push_events(self) -> None:
        for message in self._chassis.take_events():
            self.push(message)

    def _send(self, client: Client, codec: Codec, frame: Outgoing) -> None:
        timestamp = round(self._chassis.time * 1000)
        for out in self.hooks.outgoing(frame):
            data = codec.encode(
                out.type, out.body, sn=out.sn, ok=out.ok, msg=out.msg, timestamp=timestamp
            )
            if out.delay:
                asyncio.get_running_loop().call_later(out.delay, client.send, data)
            else:
                client.send(data)
