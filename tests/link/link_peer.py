"""A scripted chassis for the link's tests.

It does not use the transports and codecs of the link.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any

from tests.asynchronous import TIMEOUT, eventually, others
from woosh_robot_agent.link import Answer, ChassisClient, LinkConfig, LinkState
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Speak
from woosh_robot_agent.pb.util.commu_pack_pb2 import MessagePackJson

try:
    from websockets.asyncio.server import serve
except ImportError:
    from websockets.legacy.server import serve

LOAD = "x" * 16_000_000
"""Text that fills all buffers on the way to a chassis that reads nothing.

It is longer than what Linux buffers by default for the two ends of a connection: at most 4 MiB for
the sender and 6 MiB for the receiver. The rest of the text, and every later request, waits in the
client.
"""
INFO = "woosh.robot.RobotInfo"
Frame = dict[str, Any]


async def soon(work: Awaitable[Any], timeout: float = TIMEOUT / 2) -> Any:
    return await asyncio.wait_for(work, timeout)


async def turns(count: int = 20) -> None:
    """Yield to the event loop, so that all tasks that are ready run."""
    for _ in range(count):
        await asyncio.sleep(0)


def config(port: int, **changes: Any) -> LinkConfig:
    """Return a configuration with short timeouts."""
    values: dict[str, Any] = {
        "ip": "127.0.0.1",
        "port": port,
        "request_timeout": 15.0,
        "connect_timeout": 10.0,
        "handshake_timeout": 10.0,
        "close_timeout": 0.3,
        "liveness_timeout": 10.0,
        "backoff_min": 0.01,
        "backoff_max": 0.05,
        "stable_after": 0.0,
    }
    return LinkConfig(**{**values, **changes})


def varint(value: int) -> bytes:
    """Return a number as a protobuf varint."""
    out = b""
    while value > 127:
        out += bytes([value % 128 + 128])
        value //= 128
    return out + bytes([value])


def packed(frame: Frame) -> bytes:
    """Return a frame in the protobuf encoding; `body` is a serialized message or empty."""
    fields = {name: value for name, value in frame.items() if name != "body" and value}
    pack = MessagePackJson(**fields)
    if (body := frame.get("body")) is not None:
        pack.body.type_url = f"type.googleapis.com/{frame['type']}"
        pack.body.value = body or b""
    return pack.SerializeToString()


def delimited(frame: Frame) -> bytes:
    """Return a frame as TCP carries it."""
    data = packed(frame)
    return varint(len(data)) + data


def from_text(data: str | bytes) -> Frame:
    assert isinstance(data, str), "JSON goes in text frames"
    frame: Frame = json.loads(data)
    return frame


def unpacked(data: str | bytes) -> Frame:
    """Return a frame in the protobuf encoding, with the fields that are set."""
    assert isinstance(data, bytes), "protobuf goes in binary frames"
    pack = MessagePackJson.FromString(data)
    frame: Frame = {field.name: value for field, value in pack.ListFields()}
    return {**frame, "url": pack.body.type_url, "body": pack.body.value}


CODECS: dict[str, tuple[Callable[[Frame], str | bytes], Callable[[str | bytes], Frame]]] = {
    "json": (json.dumps, from_text),
    "protobuf": (packed, unpacked),
    "tcp": (delimited, unpacked),
}
"""Encoder and decoder of a frame, by kind of the `Peer`."""
KINDS = list(CODECS)


class Wire:
    """The chassis's end of one connection.

    Args:
        peer: the chassis.
        transport: the transport of asyncio under the connection.
        raw: writes data as they are.
    """

    def __init__(
        self, peer: Peer, transport: Any, raw: Callable[[str | bytes], Awaitable[None]]
    ) -> None:
        self.peer = peer
        self.transport = transport
        self.raw = raw
        self._encode, self._decode = CODECS[peer.kind]
        self.frames: asyncio.Queue[Frame] = asyncio.Queue()
        self.seen: list[Frame] = []
        self.gone = asyncio.Event()

    async def send(self, frame: Frame) -> None:
        await self.raw(self._encode(frame))

    async def next(self, type_name: str | None = None) -> Frame:
        """Wait for the next frame from the client, or the next one of the given type."""
        while True:
            frame = await soon(self.frames.get())
            if type_name in (None, frame["type"]):
                return frame

    async def answer(
        self, frame: Frame, body: Any = None, ok: Any = True, msg: str = "", **changes: Any
    ) -> None:
        reply = {"type": frame["type"], "body": {} if body is None else body, "ok": ok, "msg": msg}
        reply["sn"] = frame["sn"]
        await self.send({**reply, **changes})

    async def push(self, type_name: str, body: Any = None) -> None:
        await self.send({"type": type_name, "body": {} if body is None else body})

    async def serve(self, receive: Callable[[], Awaitable[Any]], ended: Any) -> None:
        """Receive frames until the connection ends."""
        self.peer.joined(self)
        try:
            while True:
                frame = self._decode(await receive())
                self.seen.append(frame)
                if self.peer.script is not None and await self.peer.script(self, frame):
                    continue
                if frame["type"] == INFO and self.peer.auto:
                    await self.answer(frame, self.peer.info)
                else:
                    self.frames.put_nowait(frame)
        except ended:
            pass
        finally:
            self.gone.set()

    def freeze(self) -> None:
        """Stop reading: the client gets neither answers nor pongs."""
        self.transport.pause_reading()

    def thaw(self) -> None:
        self.transport.resume_reading()

    def abort(self) -> None:
        self.transport.abort()


class Peer:
    """A chassis that does what the test says.

    Args:
        kind: `json`, `protobuf` (both on WebSocket) or `tcp`.
        info: body of the RobotInfo answer.
        auto: True to answer RobotInfo automatically.
        script: called with each frame first; returns True if it has handled the frame.
        port: 0 takes a free one.
    """

    def __init__(
        self,
        kind: str = "json",
        *,
        info: Any = None,
        auto: bool = True,
        script: Callable[[Wire, Frame], Awaitable[bool]] | None = None,
        port: int = 0,
    ) -> None:
        self.kind = kind
        self.info = info
        self.auto = auto
        self.script = script
        self.port = port
        self.wires: list[Wire] = []
        self.handlers: set[Any] = set()
        self._server: Any = None
        self._joined = asyncio.Event()

    def config(self, **changes: Any) -> LinkConfig:
        if self.kind != "json":
            changes.setdefault("encoding", "protobuf")
        if self.kind == "tcp":
            changes.setdefault("transport", "tcp")
        return config(self.port, **changes)

    def client(self, **changes: Any) -> ChassisClient:
        return ChassisClient(config=self.config(**changes))

    def joined(self, wire: Wire) -> None:
        self.wires.append(wire)
        self._joined.set()

    async def wire(self, number: int = 1) -> Wire:
        """Wait for the connection with this number, counted from 1."""
        while len(self.wires) < number:
            self._joined.clear()
            await soon(self._joined.wait())
        return self.wires[number - 1]

    async def __aenter__(self) -> Peer:
        if self.kind == "tcp":
            self._server = await asyncio.start_server(self._tcp, "127.0.0.1", self.port)
        else:
            self._server = await serve(
                self._websocket,
                "127.0.0.1",
                self.port,
                max_size=None,
                compression=None,
                ping_interval=None,
                close_timeout=0.2,
            )
        self.port = self._server.sockets[0].getsockname()[1]
        return self

    async def __aexit__(self, *_: object) -> None:
        self._server.close()
        for wire in self.wires:
            wire.abort()
        if self.handlers:
            await asyncio.wait(self.handlers, timeout=10)
        await soon(self._server.wait_closed())

    async def _websocket(self, socket: Any, _path: str = "") -> None:
        from websockets.exceptions import ConnectionClosed

        await Wire(self, socket.transport, socket.send).serve(socket.recv, ConnectionClosed)

    async def _tcp(self, reader: asyncio.StreamReader, writer: Any) -> None:
        task = asyncio.current_task()
        self.handlers.add(task)

        async def write(data: str | bytes) -> None:
            writer.write(data)
            await writer.drain()

        async def receive() -> bytes:
            size = shift = 0
            while True:
                byte = (await reader.readexactly(1))[0]
                size |= (byte & 127) << shift
                shift += 7
                if byte < 128:
                    return await reader.readexactly(size)

        wire = Wire(self, writer.transport, write)
        try:
            await wire.serve(receive, (OSError, asyncio.IncompleteReadError))
        finally:
            self.handlers.discard(task)
            writer.transport.abort()


@asynccontextmanager
async def linked(
    kind: str = "json",
    *,
    script: Callable[[Wire, Frame], Awaitable[bool]] | None = None,
    **changes: Any,
) -> AsyncIterator[tuple[Peer, ChassisClient, Wire]]:
    """Connect a client to a peer; the arguments are those of `Peer` and `Peer.client`."""
    async with Peer(kind, script=script) as peer, peer.client(**changes) as client:
        yield peer, client, await peer.wire()


def ask(client: ChassisClient, message: Any, **options: Any) -> asyncio.Task[Answer]:
    """Send a request."""
    return asyncio.ensure_future(client.request(message, **options))


async def answered(request: Awaitable[Any], wire: Wire, body: Any = None, **changes: Any) -> Any:
    """Let the chassis answer the next request, which `request` sends; return its result."""
    task = asyncio.ensure_future(request)
    while "sn" not in (frame := await wire.next()):
        pass  # a subscription, for example
    await wire.answer(frame, body, **changes)
    return await soon(task)


class RawServer:
    """A TCP server that calls `handle` for each connection."""

    def __init__(self, handle: Callable[[Any, Any], Awaitable[None]]) -> None:
        self.handle = handle
        self.open: list[Any] = []

    async def __aenter__(self) -> RawServer:
        self.server = await asyncio.start_server(self._handle, "127.0.0.1", 0)
        self.port = self.server.sockets[0].getsockname()[1]
        return self

    async def _handle(self, reader: Any, writer: Any) -> None:
        self.open.append(writer)
        try:
            await self.handle(reader, writer)
        except (OSError, asyncio.IncompleteReadError):
            pass
        finally:
            writer.transport.abort()

    async def __aexit__(self, *_: object) -> None:
        self.server.close()
        for writer in self.open:
            writer.transport.abort()
        await soon(self.server.wait_closed())


async def block(client: ChassisClient, wire: Wire) -> asyncio.Task[Answer]:
    """Freeze the chassis and fill all buffers up to it, so that later requests wait in the client.

    Returns:
        The request that fills the buffers. The chassis receives it once it is thawed.
    """
    wire.freeze()
    load = asyncio.ensure_future(client.request(Speak(text=LOAD)))
    await turns()
    await eventually(
        lambda: client.debug()["outbox"] == 0, "the load, which is encoded in the thread"
    )
    await turns()
    return load


def states(client: ChassisClient) -> list[LinkState]:
    """Return a list to which each new state of the client is added."""
    seen: list[LinkState] = []
    client.on_state(seen.append)
    return seen


def ours() -> list[str]:
    """Return the names of the link's tasks."""
    return [task.get_name() for task in others() if task.get_name().startswith("link")]


async def error_of(client: ChassisClient) -> Any:
    """Start the client and return the error of its first attempt."""
    client.start()
    try:
        return await eventually(lambda: client.last_error)
    finally:
        await client.close()


async def drops(_reader: Any, _writer: Any) -> None:
    """Accept a connection, then drop it."""


async def silent(reader: Any, _writer: Any) -> None:
    """Accept a connection, then send nothing."""
    await reader.read()
