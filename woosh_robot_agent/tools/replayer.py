"""A chassis that does again what a recording says."""

from __future__ import annotations

import asyncio
import json
import logging
from collections import Counter
from functools import partial

from woosh_robot_agent.link.codecs.frames import Codec, Envelope, FrameError
from woosh_robot_agent.link.config import MIB
from woosh_robot_agent.link.transports import (
    Listener,
    Transport,
    TransportClosedError,
    serve_tcp,
    serve_websocket,
)
from woosh_robot_agent.pb.util.commu_pack_pb2 import MessagePackJson
from woosh_robot_agent.protos import message_types
from woosh_robot_agent.simulator.serving.client import JSON, Client, codec_of
from woosh_robot_agent.tools.playback import (
    Kind,
    Playback,
    Step,
    is_subscription,
    subscribe,
)

_LOG = logging.getLogger(__name__)
_MAX_FRAME = 64 * MIB
_MAX_OUTBOX = 10_000
_CLOSE_TIMEOUT = 0.3
_FLUSH_TIMEOUT = 1.0
_FLUSH_LOOK = 0.01


class ReplayedChassis:
    """Answers as recorded and pushes at the recorded times, once a client has subscribed.

    Time stands still until there is a client that listens, at the start and after each recorded
    loss of the connection; so nothing is missed by one that comes later than the recorded one did.

    Args:
        playback: what to replay.
        host: address to listen at.
        port: WebSocket port, 0 for a free one.
        tcp_port: port of delimited protobuf, 0 for a free one.
        speed: how much faster than recorded.
        loop: begin again at the end, with a loss of the connection.
        wait_for_commands: also stand still at each recorded command until a client sends one of
            its type.

    Attributes:
        port: the WebSocket port, once started.
        tcp_port: the TCP port, once started.
        rounds: how often the recording was played to its end.
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
        self._repeat = loop
        self._wait_for_commands = wait_for_commands
        self._listeners: list[Listener] = []
        self._clients: dict[Client, Codec] = {}
        self._commands: Counter[str] = Counter()
        self._unknown: set[str] = set()
        self._changed = asyncio.Event()
        self._always = asyncio.Event()
        self._always.set()
        self._base: tuple[float, float] | None = None
        """Loop time, and time in the recording, of the same moment."""
        self._player: asyncio.Task[None] | None = None

    async def __aenter__(self) -> ReplayedChassis:
        await self.start()
        return self

    async def __aexit__(self, *exc_info: object) -> None:
        await self.stop()

    async def start(self) -> None:
        """Take clients.

        Raises:
            OSError: a port is taken.
        """
        await self._listen()
        self._player = asyncio.get_running_loop().create_task(self._play())

    async def stop(self) -> None:
        """Hang up and listen no more."""
        if self._player is not None:
            self._player.cancel()
        await self._hang_up()

    # The timeline

    async def _play(self) -> None:
        loop = asyncio.get_running_loop()
        while True:
            needed: Counter[str] = Counter()
            self._commands.clear()
            self._playback.answers.rewind()
            await self._until_client(subscribed=False)
            for step in self._playback.steps:
                if self._base is not None:
                    due = self._base[0] + (step.t - self._base[1]) / self._speed
                    await asyncio.sleep(max(0.0, due - loop.time()))
                needed[step.type] += step.kind is Kind.COMMAND
                await self._do(step, needed[step.type])
            self.rounds += 1
            _LOG.info("the recording is over%s", ": again" if self._repeat else "")
            if not self._repeat:
                return
            self._base = None
            await self._flush()
            self._drop()

    async def _do(self, step: Step, commands: int) -> None:
        if step.kind is Kind.PUSH:
            self._push(step)
        elif step.kind is Kind.OPEN:
            await self._listen()
        elif step.kind is Kind.LOST:
            _LOG.info("%.3f s: the connection is lost, as recorded", step.t)
            await self._flush()
            await self._hang_up()
        elif step.kind is Kind.SUBSCRIBED:
            await self._until_client(subscribed=True)
            self._stand_still_until_now(step)
        elif step.kind is Kind.COMMAND and self._wait_for_commands:
            if self._commands[step.type] < commands:
                _LOG.info("%.3f s: waiting for %s; recorded: %.500s", step.t, step.type, step.frame)
            while self._commands[step.type] < commands:
                await self._change()
            self._stand_still_until_now(step)

    def _stand_still_until_now(self, step: Step) -> None:
        self._base = (asyncio.get_running_loop().time(), step.t)

    async def _until_client(self, *, subscribed: bool) -> None:
        while not any(client.topics or not subscribed for client in self._clients):
            await self._change()

    async def _change(self) -> None:
        self._changed.clear()
        await self._changed.wait()

    def _push(self, step: Step) -> None:
        for client, codec in list(self._clients.items()):
            if step.wanted:
                wanted = client.topics.get(step.type)
                if wanted is None:
                    continue
                codec = wanted
            client.send(_in(codec, step.frame, None))

    # Clients

    async def _listen(self) -> None:
        if self._listeners:
            return
        for serve, port in ((serve_websocket, self.port), (serve_tcp, self.tcp_port)):
            try:
                listener = await serve(self._serve, self._host, port, max_size=_MAX_FRAME)
            except OSError:
                await self._hang_up()
                raise
            self._listeners.append(listener)
        self.port, self.tcp_port = (listener.port for listener in self._listeners)

    async def _flush(self) -> None:
        """Wait, not for long, until everybody has got what was recorded before the loss."""
        loop = asyncio.get_running_loop()
        deadline = loop.time() + _FLUSH_TIMEOUT
        while any(client.unsent for client in self._clients) and loop.time() < deadline:
            await asyncio.sleep(_FLUSH_LOOK)

    async def _hang_up(self) -> None:
        """Drop every client and take no new ones, as if out of reach."""
        self._drop()
        listeners, self._listeners = self._listeners, []
        await asyncio.gather(*(listener.close() for listener in listeners))

    def _drop(self) -> None:
        for client in self._clients:
            client.drop()
        self._clients.clear()

    async def _serve(self, transport: Transport) -> None:
        if not self._listeners:  # it was on its way when the connection was lost
            transport.abort()
            return
        client = Client(transport, _MAX_OUTBOX)
        self._clients[client] = JSON
        self._changed.set()
        writer = asyncio.ensure_future(client.write(self._always))
        _LOG.info("%s connected", transport.peer)
        try:
            while True:
                try:
                    self._receive(client, await transport.recv())
                except FrameError as error:
                    _LOG.warning("%s sent a frame that cannot be read: %s", transport.peer, error)
        except TransportClosedError as error:
            _LOG.info("%s left: %s", transport.peer, error)
        finally:
            self._clients.pop(client, None)
            writer.cancel()
            await transport.close(_CLOSE_TIMEOUT)

    def _receive(self, client: Client, data: str | bytes) -> None:
        codec = codec_of(data)
        envelope = codec.decode(data)
        if client in self._clients:
            self._clients[client] = codec
        if is_subscription(envelope):
            topics = set(client.topics)
            subscribe(topics, envelope, data)
            client.topics = {name: client.topics.get(name, codec) for name in topics}
        elif envelope.sn:
            self._commands[envelope.type] += 1
            self._answer(client, codec, envelope, data)
        self._changed.set()

    def _answer(self, client: Client, codec: Codec, envelope: Envelope, data: str | bytes) -> None:
        exchange = self._playback.answers.find(envelope, data)
        if exchange is None:
            text = f"the recording has no request of type {envelope.type}"
            if envelope.type not in self._unknown:
                self._unknown.add(envelope.type)
                types = ", ".join(self._playback.answers.types) or "none at all"
                _LOG.warning("refused: %s; it has %s", text, types)
            client.send(codec.encode("error", None, sn=envelope.sn, ok=False, msg=text))
        elif exchange.answer is None:
            _LOG.info("%s gets no answer, as recorded at %.3f s", envelope.type, exchange.t)
        else:
            frame = _in(codec, exchange.answer.data, envelope.sn)
            send = partial(client.send, frame)
            asyncio.get_running_loop().call_later(exchange.delay / self._speed, send)


def _in(codec: Codec, frame: str | bytes, sn: int | None) -> str | bytes:
    """A recorded frame as a client that uses `codec` can read it.

    Args:
        codec: the client's encoding.
        frame: as recorded; it stays as it is where nothing has to be changed.
        sn: serial number to put in, None for a push.
    """
    recorded = codec_of(frame)
    if recorded is not codec:
        return _transcoded(recorded, codec, frame, sn)
    if sn is None:
        return frame
    if isinstance(frame, str):
        return json.dumps({**json.loads(frame), "sn": sn}, ensure_ascii=False)
    pack = MessagePackJson.FromString(frame)
    pack.sn = sn
    return pack.SerializeToString()


def _transcoded(recorded: Codec, codec: Codec, frame: str | bytes, sn: int | None) -> str | bytes:
    try:
        envelope = recorded.decode(frame)
        cls = message_types().get(envelope.type)
        body = None if cls is None else recorded.body(envelope, cls)
    except FrameError:
        return frame  # what could not be read then cannot be read now
    return codec.encode(
        envelope.type,
        body,
        sn=sn or 0,
        ok=envelope.ok,
        msg=envelope.msg,
        timestamp=envelope.timestamp,
    )
