"""The chassis that `replay` simulates. It uses the encoding of each client."""

from __future__ import annotations

import asyncio
import json
import logging
from collections import Counter
from functools import partial

from woosh_robot_agent.link.codecs import JSON, server_codec
from woosh_robot_agent.link.config import MIB
from woosh_robot_agent.link.frames import SUBSCRIPTION_TYPES, Codec, Envelope, FrameError
from woosh_robot_agent.link.protos import message_types
from woosh_robot_agent.link.reports import LogOnce
from woosh_robot_agent.link.server import (
    ConnectedClient,
    Listener,
    ServerTransport,
    serve_tcp,
    serve_websocket,
)
from woosh_robot_agent.link.transport import TransportClosedError
from woosh_robot_agent.pb.util.commu_pack_pb2 import MessagePackJson
from woosh_robot_agent.tools.options import ToolError
from woosh_robot_agent.tools.recording.timeline import (
    Playback,
    Step,
    apply_subscription,
)


def transcode(frame: str | bytes, codec: Codec, sn: int | None = None) -> str | bytes:
    """Return a recorded frame in the encoding of a receiver, and with the receiver's serial number.

    A frame that has to be encoded anew, but cannot be read, is returned as it is.

    Args:
        frame: the recorded frame of the chassis: a push, or an answer with a valid envelope.
        codec: encoding of the receiver, from `server_codec`.
        sn: serial number of the receiver's request; None for a push.
    """
    recorded = server_codec(frame)
    if recorded is not codec:  # there is one codec for each encoding
        return _reencode(frame, recorded, codec, sn)
    if sn is None:
        return frame
    if isinstance(frame, str):
        # in ASCII: half of a surrogate pair, which a robot may send, has no other encoding
        return json.dumps({**json.loads(frame), "sn": sn})
    pack = MessagePackJson.FromString(frame)
    pack.sn = sn
    return pack.SerializeToString()


def _reencode(frame: str | bytes, recorded: Codec, codec: Codec, sn: int | None) -> str | bytes:
    """Convert a frame from the encoding `recorded` to that of the receiver, `codec`.

    A frame that cannot be read is returned as it is. A frame of an unknown type loses its body.
    """
    try:
        envelope = recorded.decode(frame)
        cls = message_types().get(envelope.type)
        body = None if cls is None else recorded.body(envelope, cls)
    except FrameError:
        return frame
    return codec.encode(
        envelope.type,
        body,
        sn=sn or 0,
        ok=envelope.ok,
        msg=envelope.msg,
        timestamp=envelope.timestamp,
    )


_LOG = logging.getLogger(__name__)
_MAX_FRAME_SIZE = 64 * MIB
_MAX_OUTBOX = 10_000
"""Number of frames waiting for a client above which the client is dropped."""
_CLOSE_TIMEOUT = 0.3
"""Timeout of the closing handshake with a client, in seconds."""
_FLUSH_TIMEOUT = 1.0
"""Time that clients get to receive all frames before they are dropped, in seconds."""
_FLUSH_CHECK_PERIOD = 0.01
"""Time between two checks of whether clients have received all frames, in seconds."""


class ReplayedChassis:
    """A chassis that gives the recorded answers and sends pushes at their recorded times.

    The playback pauses at the start and after each recorded loss of the connection until a client
    has subscribed. So a client misses nothing if it connects later than the recorded client did.
    After the end of the recording, clients still get answers.

    Args:
        port: port of the WebSocket transport; 0 for any free port.
        tcp_port: port of the TCP transport; 0 for any free port.
        loop: True to drop all clients and start again when the recording ends.
        wait_for_commands: True to pause also at each recorded command until a client sends a
            command of its type.

    Attributes:
        port: port of the WebSocket transport; the actual one after `start`.
        tcp_port: port of the TCP transport; the actual one after `start`.
        rounds: number of times that the recording was played to its end.
    """

    def __init__(
        self,
        playback: Playback,
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        tcp_port: int = 0,
        speed: float = 1.0,
        loop: bool = False,
        wait_for_commands: bool = False,
    ) -> None:
        self.port = port
        self.tcp_port = tcp_port
        self.rounds = 0
        self._playback = playback
        self._host = host
        self._speed = speed
        self._loop = loop
        self._wait_for_commands = wait_for_commands
        self._listeners: list[Listener] = []
        self._clients: dict[ConnectedClient, Codec] = {}
        """The clients, each with the encoding of its last frame; JSON before the first."""
        self._requests: Counter[str] = Counter()
        """Number of requests received in this round, by type."""
        self._log = LogOnce(_LOG)
        self._changed = asyncio.Event()
        """Set when a client connects or sends a frame."""
        self._base: tuple[float, float] | None = None
        """Loop time and recording time of the same moment, in seconds. None until a client has
        subscribed or sent an awaited command; until then, steps are not delayed."""
        self._player: asyncio.Task[None] | None = None

    async def __aenter__(self) -> ReplayedChassis:
        await self.start()
        return self

    async def __aexit__(self, *exc_info: object) -> None:
        await self.stop()

    async def start(self) -> None:
        """Listen for clients and start the playback.

        Raises:
            OSError: it cannot listen, e.g. because a port is in use.
        """
        await self._listen()
        self._player = asyncio.get_running_loop().create_task(self._play())

    async def wait(self, stop: asyncio.Event) -> None:
        """Wait until `stop` is set, also after the end of the recording.

        Raises:
            ToolError: the ports, closed during a recorded loss, cannot be opened again.
        """
        assert self._player is not None
        stopped = asyncio.ensure_future(stop.wait())
        await asyncio.wait({stopped, self._player}, return_when=asyncio.FIRST_COMPLETED)
        if self._player.done():
            try:
                self._player.result()
            except OSError as error:
                stopped.cancel()
                reason = error.strerror or error
                raise ToolError(f"cannot listen again on {self._host}: {reason}") from None
        await stopped

    async def stop(self) -> None:
        """End the playback, drop all clients and stop listening."""
        if self._player is not None:
            self._player.cancel()
        await self._go_offline()

    # Playback

    async def _play(self) -> None:
        """Play the recording once, or in a loop."""
        loop = asyncio.get_running_loop()
        while True:
            await self._listen()  # the recording may have ended while the ports were closed
            recorded: Counter[str] = Counter()  # commands so far, by type
            self._requests.clear()
            self._playback.answers.rewind()
            await self._wait_for_client(subscribed=False)
            for step in self._playback.steps:
                if self._base is not None:
                    resumed_at, recorded_at = self._base
                    due = resumed_at + (step.t - recorded_at) / self._speed
                    await asyncio.sleep(max(0.0, due - loop.time()))
                if step.kind == "command":
                    recorded[step.type] += 1
                    if self._wait_for_commands:
                        await self._wait_for_command(step, recorded[step.type])
                else:
                    await self._carry_out(step)
            self.rounds += 1
            _LOG.info("end of the recording%s", ", starting again" if self._loop else "")
            if not self._loop:
                return
            self._base = None
            await self._wait_until_sent()
            self._drop_clients()

    async def _carry_out(self, step: Step) -> None:
        """Carry out one step that is not a command."""
        if step.kind == "push":
            self._push(step)
        elif step.kind == "open":
            await self._listen()
        elif step.kind == "lost":
            _LOG.info("%.3f s: dropping the connection, as recorded", step.t)
            await self._wait_until_sent()
            await self._go_offline()
        elif step.kind == "subscribed":
            await self._wait_for_client(subscribed=True)
            self._resume_at(step)

    async def _wait_for_command(self, step: Step, count: int) -> None:
        """Pause until clients have sent `count` commands of the type of `step` in this round."""
        if self._requests[step.type] < count:
            _LOG.info(
                "%.3f s: paused until a client sends %s; recorded: %.500s",
                step.t,
                step.type,
                step.frame,
            )
        while self._requests[step.type] < count:
            await self._wait_for_change()
        self._resume_at(step)

    def _resume_at(self, step: Step) -> None:
        """Make now the moment of `step`, after a pause; later steps are due relative to it."""
        self._base = (asyncio.get_running_loop().time(), step.t)

    async def _wait_for_client(self, *, subscribed: bool) -> None:
        """Wait until there is a client, or if `subscribed`, one with a subscription."""
        while not any(client.topics or not subscribed for client in self._clients):
            await self._wait_for_change()

    async def _wait_for_change(self) -> None:
        """Wait until a client connects or sends a frame."""
        self._changed.clear()
        await self._changed.wait()

    def _push(self, step: Step) -> None:
        """Send a push to its subscribers, or to all if it came without a subscription."""
        for client, codec in list(self._clients.items()):
            if step.subscribed:
                if step.type not in client.topics:
                    continue
                codec = client.topics[step.type]  # that of the client's subscription
            client.send(transcode(step.frame, codec))

    # Clients

    async def _listen(self) -> None:
        """Listen on both ports, unless they are open already; raise OSError if one is in use."""
        if self._listeners:
            return
        for serve, port in ((serve_websocket, self.port), (serve_tcp, self.tcp_port)):
            try:
                listener = await serve(self._serve, self._host, port, max_size=_MAX_FRAME_SIZE)
            except OSError:
                await self._go_offline()
                raise
            self._listeners.append(listener)
        self.port, self.tcp_port = (listener.port for listener in self._listeners)

    async def _wait_until_sent(self) -> None:
        """Wait until all frames for the clients have been sent, with a timeout."""
        loop = asyncio.get_running_loop()
        deadline = loop.time() + _FLUSH_TIMEOUT
        while any(client.has_unsent for client in self._clients) and loop.time() < deadline:
            await asyncio.sleep(_FLUSH_CHECK_PERIOD)

    async def _go_offline(self) -> None:
        """Drop all clients and stop listening, like a chassis that is out of reach."""
        self._drop_clients()
        listeners, self._listeners = self._listeners, []
        await asyncio.gather(*(listener.close() for listener in listeners))

    def _drop_clients(self) -> None:
        for client in self._clients:
            client.drop()
        self._clients.clear()

    async def _serve(self, transport: ServerTransport) -> None:
        if not self._listeners:  # the client connected while the ports were being closed
            transport.abort()
            return
        client = ConnectedClient(transport, _MAX_OUTBOX)
        self._clients[client] = JSON
        self._changed.set()
        writer = asyncio.ensure_future(client.write())
        _LOG.info("%s connected", transport.peer)
        try:
            while True:
                try:
                    self._receive(client, await transport.recv())
                except FrameError as error:
                    _LOG.warning("invalid frame from %s: %s", transport.peer, error)
        except TransportClosedError as error:
            _LOG.info("%s disconnected: %s", transport.peer, error)
        finally:
            self._clients.pop(client, None)
            writer.cancel()
            await transport.close(_CLOSE_TIMEOUT)

    def _receive(self, client: ConnectedClient, data: str | bytes) -> None:
        """Change the client's subscriptions, or answer its request.

        Raises:
            FrameError: the frame cannot be read.
        """
        codec = server_codec(data)
        envelope = codec.decode(data)
        if client in self._clients:  # otherwise it has just been dropped
            self._clients[client] = codec
        if envelope.type in SUBSCRIPTION_TYPES:
            topics = set(client.topics)
            apply_subscription(topics, envelope, data)
            # a type that was subscribed before keeps the encoding of its own subscription
            client.topics = {name: client.topics.get(name, codec) for name in topics}
        elif envelope.sn:
            self._requests[envelope.type] += 1
            self._answer(client, codec, envelope, data)
        self._changed.set()

    def _answer(
        self, client: ConnectedClient, codec: Codec, envelope: Envelope, data: str | bytes
    ) -> None:
        """Send the recorded answer after the recorded delay, or none, or refuse the request."""
        exchange = self._playback.answers.take(envelope, data)
        if exchange is None:
            text = f"the recording has no request of type {envelope.type}"
            types = ", ".join(self._playback.answers.types) or "none"
            self._log.warn(envelope.type, f"request refused: {text}; recorded types: {types}")
            client.send(codec.encode("error", None, sn=envelope.sn, ok=False, msg=text))
        elif exchange.answer is None:
            _LOG.info("no answer to %s, as recorded at %.3f s", envelope.type, exchange.t)
        else:
            frame = transcode(exchange.answer.data, codec, envelope.sn)
            send = partial(client.send, frame)
            asyncio.get_running_loop().call_later(exchange.delay / self._speed, send)
