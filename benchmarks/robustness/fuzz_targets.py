"""Targets of fuzzing: codecs and framing alone, client and simulator over sockets.

A target makes its inputs from a seed and takes them in batches. It raises an exception if anything
but a documented error comes out of them, or if its state is wrong afterwards.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import random
import re
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields
from typing import Any

import websockets
from google.protobuf.message import Message

from tests.link import fuzz_inputs as inputs
from tests.link.link_peer import INFO, Frame, Peer, Wire, eventually, varint
from tests.quick_chassis import quick_config
from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.link.codecs.json_codec import JsonCodec
from woosh_robot_agent.link.codecs.protobuf_codec import ProtobufCodec
from woosh_robot_agent.link.frames import FrameError
from woosh_robot_agent.link.protos import full_name, message_types
from woosh_robot_agent.link.transport import TcpTransport, TransportClosedError, open_transport
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Speak
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed, RobotInfo
from woosh_robot_agent.simulator import SimulatedChassis
from woosh_robot_agent.simulator.protocol.reports import TOPICS

try:
    from tests.convert.type_pairs import PAIRS
    from woosh_robot_agent.convert import BadFieldError, converter
except ImportError:  # without ROS
    PAIRS = {}

_OLD = int(websockets.__version__.split(".")[0]) < 14
"""True if the websockets library closes a connection after a text frame that is not UTF-8."""
_READ = ("body", "timestamp")
"""Kinds of defects of frames that are read nevertheless."""
_ANSWER_TIMEOUT = 60.0
_UNIQUE = 1_500_000_000
"""A number that no input contains, e.g. as its serial number."""
ACCEPTED = "accepted"


class Target(ABC):
    """One target.

    Attributes:
        name: name in tables, and part of the seed.
        batch: number of inputs in a batch.
        share: share of all inputs that this target gets.
    """

    name: str
    batch = 1
    share: float

    @abstractmethod
    def make(self, rng: random.Random) -> Any:
        """Return an input."""

    @abstractmethod
    def feed(self, batch: Sequence[Any]) -> Counter[str]:
        """Process a batch of inputs.

        Returns:
            Number of accepted inputs, and of refused ones by kind.

        Raises:
            Exception: the target behaved incorrectly.
        """

    def close(self) -> None:  # noqa: B027
        """Release all resources."""


class _Codec(Target):
    """A codec. Decodes envelope and body, also into a wrong type, and converts the body to ROS."""

    codec: Any

    def feed(self, batch: Sequence[Any]) -> Counter[str]:
        (data,) = batch
        try:
            envelope = self.codec.decode(data)
            envelope.msg.encode()  # so that it can be logged
            envelope.type.encode()
            classes = [message_types().get(envelope.type), _other_class(data)]
            for cls in classes:
                if cls is not None:
                    _to_ros(self.codec.body(envelope, cls))
        except FrameError as error:
            if len(str(error).encode()) > 2000:
                raise ValueError("the text of the error is too long to be logged") from error
            return Counter([error.kind])
        return Counter([ACCEPTED])


def _other_class(data: str | bytes) -> type[Message] | None:
    """Return a wrong class for one in eight frames, always the same one for a frame."""
    names = inputs.type_names()
    number = len(data) * 2654435761 >> 3
    return message_types()[names[number % len(names)]] if number % 8 == 0 else None


def _to_ros(message: Message) -> None:
    pair = PAIRS.get(full_name(message))
    if pair is None:
        return
    convert = converter(*pair)
    try:
        convert.to_proto(convert.to_ros(message))
    except BadFieldError as error:  # documented: the value is out of range
        str(error).encode()


class JsonFrames(_Codec):
    name = "JSON codec"
    share = 0.45
    codec = JsonCodec()

    def make(self, rng: random.Random) -> str | bytes:
        text = inputs.text(rng)
        return text if rng.random() < 0.5 else text.encode(errors="surrogatepass")


class ProtobufFrames(_Codec):
    name = "protobuf codec"
    share = 0.35
    codec = ProtobufCodec()

    def make(self, rng: random.Random) -> bytes:
        return inputs.blob(rng)


class _Loop(Target):
    """Base class of the targets that run in an event loop."""

    def __init__(self) -> None:
        self.loop = asyncio.new_event_loop()
        self.errors: list[str] = []
        self.loop.set_exception_handler(
            lambda _, context: self.errors.append(str(context.get("exception") or context))
        )
        self._handler = logging.Handler(logging.ERROR)
        self._handler.emit = lambda record: self.errors.append(  # type: ignore[method-assign]
            logging.Formatter().format(record)
        )
        logging.getLogger("woosh_robot_agent").addHandler(self._handler)

    def feed(self, batch: Sequence[Any]) -> Counter[str]:
        found = self.loop.run_until_complete(self.take(batch))
        if self.errors:
            errors, self.errors = self.errors, []
            raise AssertionError("\n".join(errors))
        return found

    @abstractmethod
    async def take(self, batch: Sequence[Any]) -> Counter[str]: ...

    def close(self) -> None:
        logging.getLogger("woosh_robot_agent").removeHandler(self._handler)
        self.loop.run_until_complete(asyncio.sleep(0.01))
        self.loop.close()


class TcpFraming(_Loop):
    """The delimited TCP format: valid frames, mutated frames and frames with a wrong length."""

    name = "TCP framing"
    share = 0.1
    max_size = 4000

    def make(self, rng: random.Random) -> bytes:
        out = b""
        for _ in range(rng.choice((1, 1, 2, 4))):
            frame = inputs.blob(rng)
            size = len(frame) if rng.random() < 0.8 else rng.choice((0, 1, 127, 2**20, 2**63))
            out += varint(size) + frame
        return inputs.blob(rng) if rng.random() < 0.1 else out

    async def take(self, batch: Sequence[Any]) -> Counter[str]:
        reader = asyncio.StreamReader()
        transport = TcpTransport(reader, _Writer(), self.max_size)  # type: ignore[arg-type]
        reader.feed_data(batch[0])
        reader.feed_eof()
        found: Counter[str] = Counter()
        while True:
            try:
                assert len(await transport.recv()) <= self.max_size
                kind = ACCEPTED
            except FrameError as error:
                kind = error.kind
            except TransportClosedError as error:
                text = str(error).partition(":")[0]
                return found or Counter([re.sub(r"\d+", "N", text)])
            found = found or Counter([kind])


class _Writer:
    """The part of asyncio.StreamWriter that a transport needs for receiving."""

    def __init__(self) -> None:
        self.transport: Any = self

    def get_extra_info(self, name: str) -> None:
        return None


class _Client(_Loop):
    """The client, connected to a peer that sends the inputs.

    Each batch gets a new client with requests in flight whose serial numbers are in the inputs too.
    """

    batch = 100
    share = 0.04
    kind: str
    """Kind of the `Peer`."""
    marker: Any
    """Body of the push sent after a batch. When it arrives, all inputs have been read."""

    def __init__(self) -> None:
        super().__init__()
        self._stack = contextlib.AsyncExitStack()
        self._peer = Peer(self.kind, script=self._script)
        self.loop.run_until_complete(self._stack.enter_async_context(self._peer))

    async def _script(self, wire: Wire, frame: Frame) -> bool:
        """Answer the first RobotInfo of a connection and every Speak, and nothing else."""
        first_info = frame["type"] == INFO and frame.get("sn") == 1
        if first_info or frame["type"] == full_name(Speak):
            await wire.answer(frame, {} if self.kind == "json" else b"")
        return True

    def make(self, rng: random.Random) -> bytes:
        return inputs.text(rng).encode(errors="replace" if _OLD else "surrogatepass")

    async def take(self, batch: Sequence[Any]) -> Counter[str]:
        limits = {"liveness_timeout": 600.0, "max_in_flight": 1000}
        async with self._peer.client(**limits) as client:
            for name in sorted(TOPICS):
                client.subscribe(message_types()[name], lambda push: None)
            received = asyncio.Event()
            client.subscribe(PoseSpeed, lambda pose: _set_if(received, pose.mileage == _UNIQUE))
            in_flight = [asyncio.ensure_future(client.request(RobotInfo())) for _ in range(8)]
            await asyncio.sleep(0)
            wire = self._peer.wires.pop()
            before = client.stats.rx
            for data in batch:
                wire.transport.write(self.packed(data))
            await wire.push(full_name(PoseSpeed), self.marker)
            await asyncio.wait_for(received.wait(), _ANSWER_TIMEOUT)
            stats = client.stats

            def counts() -> tuple[int, int]:
                """Return the number of frames read, without the marker, and skipped."""
                bad = stats.bad_frames.items()
                return stats.rx - before - 1, sum(n for kind, n in bad if kind not in _READ)

            # large frames are decoded in another thread, some after the marker
            await eventually(lambda: sum(counts()) >= len(batch), "all frames")
            read, skipped = counts()
            bad = Counter(stats.bad_frames)
            answer = await client.request(Speak(), _ANSWER_TIMEOUT)
            assert answer.ok
            for task in in_flight:
                task.cancel()
            await asyncio.gather(*in_flight, return_exceptions=True)
            assert client.stats.connects == 1, f"the link was lost: {client.last_error}"
        assert read + skipped == len(batch), f"{read} read and {skipped} skipped of {len(batch)}"
        for kind in _READ:
            del bad[kind]
        return bad + Counter({ACCEPTED: read})

    def packed(self, data: bytes) -> bytes:
        opcode = 0x81 if self.kind == "json" else 0x82
        if len(data) < 126:
            return bytes([opcode, len(data)]) + data
        return bytes([opcode, 127]) + len(data).to_bytes(8, "big") + data

    def close(self) -> None:
        self.loop.run_until_complete(self._stack.aclose())
        super().close()


def _set_if(event: asyncio.Event, condition: bool) -> None:
    if condition:
        event.set()


class JsonClient(_Client):
    name = "client, JSON over WebSocket"
    kind = "json"
    marker = {"mileage": _UNIQUE}


class TcpClient(_Client):
    name = "client, protobuf over TCP"
    kind = "tcp"
    share = 0.02
    marker = PoseSpeed(mileage=_UNIQUE).SerializeToString()

    def make(self, rng: random.Random) -> bytes:
        return inputs.blob(rng)

    def packed(self, data: bytes) -> bytes:
        return varint(len(data)) + data


class _Simulator(_Loop):
    """The simulated chassis, which must serve the next client after any input."""

    batch = 50

    def __init__(self) -> None:
        super().__init__()
        self.simulator = SimulatedChassis(
            quick_config(port=0, tcp_port=0, speed=100, seed=1, max_frame=4 * 1024 * 1024)
        )
        self.loop.run_until_complete(self.simulator.start())

    async def open(self, transport: str = "websocket") -> Any:
        port = self.simulator.port if transport == "websocket" else self.simulator.tcp_port
        where = LinkConfig(ip="127.0.0.1", port=port, transport=transport, connect_timeout=30)
        return await open_transport(where)

    async def check(self) -> None:
        """Check that a client is answered, that time goes on, and that all numbers are finite."""
        transport = await self.open()
        try:
            await transport.send(JsonCodec().encode("woosh.robot.RobotInfo", None, sn=_UNIQUE))
            answer = JsonCodec().decode(await self._within(transport.recv()))
            assert (answer.sn, answer.ok) == (_UNIQUE, True), answer.msg
            JsonCodec().body(answer, RobotInfo)
        finally:
            await transport.close()
        await self._within(self._time_goes_on())
        state = self.simulator.state
        for part in (state, state.pose, state.velocity):
            for field in fields(part):
                value = getattr(part, field.name)
                assert not isinstance(value, float) or math.isfinite(value), (field.name, value)

    async def _time_goes_on(self) -> None:
        """Wait for the next step of the simulation."""
        chassis = self.simulator.chassis
        stepped = chassis.stepped
        while chassis.stepped == stepped:
            await asyncio.sleep(0.001)

    @staticmethod
    async def _within(work: Any) -> Any:
        return await asyncio.wait_for(work, _ANSWER_TIMEOUT)

    def close(self) -> None:
        self.loop.run_until_complete(self.simulator.stop())
        super().close()


class Requests(_Simulator):
    """Requests of every type with extreme values, and mutated ones, over all three encodings."""

    name = "simulator, requests"
    share = 0.03

    def make(self, rng: random.Random) -> tuple[str, str | bytes]:
        where = rng.choice(("websocket", "websocket", "tcp"))
        json_ = where == "websocket" and rng.random() < 0.7
        if rng.random() < 0.6:
            name, body = inputs.request(rng)
            data = (JsonCodec() if json_ else ProtobufCodec()).encode(name, body, sn=7)
        else:
            data = inputs.text(rng) if json_ else inputs.blob(rng)
        if isinstance(data, str):  # the client library sends valid UTF-8 only
            data = data.encode(errors="replace").decode()
        return where, data

    async def take(self, batch: Sequence[Any]) -> Counter[str]:
        found: Counter[str] = Counter()
        for where in ("websocket", "tcp"):
            transport = await self.open(where)
            reading = asyncio.ensure_future(self._read(transport, found))
            try:
                for to, data in batch:
                    if to == where:
                        await self._within(transport.send(data))
                # the default encoding of the transport
                codec: Any = JsonCodec() if where == "websocket" else ProtobufCodec()
                await transport.send(codec.encode("woosh.robot.Mode", None, sn=_UNIQUE))
                await self._within(asyncio.shield(reading))
            finally:
                reading.cancel()
                await transport.close()
        await self.check()
        found["not a frame"] += max(0, len(batch) - found.total())
        return found

    @staticmethod
    async def _read(transport: Any, found: Counter[str]) -> None:
        while True:
            data = await transport.recv()
            text = isinstance(data, str) or data[:1] == b"{"
            answer = (JsonCodec() if text else ProtobufCodec()).decode(data)
            if answer.sn == _UNIQUE:
                return
            if answer.ok is None:
                continue  # a push
            assert "internal error" not in answer.msg, answer
            found[ACCEPTED if answer.ok else "refused with a text"] += 1
            assert answer.ok or answer.msg


class RawBytes(_Simulator):
    """Raw bytes: no handshake, a mutated handshake, or a handshake followed by malformed frames."""

    name = "simulator, raw bytes"
    share = 0.01
    batch = 25

    _HANDSHAKE = (
        b"GET / HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
    )

    def make(self, rng: random.Random) -> tuple[bool, bytes]:
        if rng.random() < 0.3:
            return True, TcpFraming.make(self, rng)  # type: ignore[arg-type]
        shake = self._HANDSHAKE
        if rng.random() < 0.4:
            for _ in range(rng.choice((1, 2, 5))):
                shake = rng.choice(_DAMAGES)(rng, shake)[:_MAX_HANDSHAKE]
            return False, shake
        if rng.random() < 0.2:
            return False, inputs.blob(rng)
        frames = b""
        for _ in range(rng.choice((1, 3))):
            data = inputs.text(rng).encode(errors="surrogatepass")[:5000]
            head = rng.choice((0x81, 0x82, 0x01, 0x80, 0x89, 0x8A, 0x88, 0xF1, rng.randrange(256)))
            size = len(data) if rng.random() < 0.8 else rng.choice((0, 2**16, 2**63 - 1, 2**64 - 1))
            frames += bytes([head, 0xFF]) + size.to_bytes(8, "big") + bytes(4) + data
        return False, shake + frames

    async def take(self, batch: Sequence[Any]) -> Counter[str]:
        await self._within(asyncio.gather(*(self._send(*each) for each in batch)))
        await self.check()
        return Counter({"dropped or skipped": len(batch)})

    async def _send(self, tcp: bool, data: bytes) -> None:
        port = self.simulator.tcp_port if tcp else self.simulator.port
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        with contextlib.suppress(OSError):  # the simulator may close before it has read everything
            writer.write(data)
            writer.write_eof()
            while await reader.read(65536):
                pass
        writer.transport.abort()


_MAX_HANDSHAKE = 100_000
"""Maximum size of a damaged handshake, in bytes, as repeated damages multiply its line ends."""


def _flipped(rng: random.Random, data: bytes) -> bytes:
    at = rng.randrange(len(data) + 1)
    return data[:at] + bytes([rng.randrange(256)]) + data[at + 1 :]


_DAMAGES: tuple[Callable[[random.Random, bytes], bytes], ...] = (
    _flipped,
    lambda rng, data: data[: rng.randint(0, len(data))],
    lambda rng, data: data.replace(b"\r\n", rng.choice((b"\n", b"\r", b"\0", b"\r\nX: " * 300))),
    lambda rng, data: data.replace(b"Host", b"X" * rng.choice((1, 9000))),
    lambda rng, data: data + rng.randbytes(rng.choice((1, 100))),
)

TARGETS: dict[str, type[Target]] = {
    "json": JsonFrames,
    "protobuf": ProtobufFrames,
    "framing": TcpFraming,
    "json-client": JsonClient,
    "tcp-client": TcpClient,
    "requests": Requests,
    "raw": RawBytes,
}
"""Targets by their names on the command line."""


def batches(
    target: Target, seed: int, count: int, first: int = 0
) -> Iterator[tuple[int, list[Any]]]:
    """Yield the inputs of a target in batches, each with the number of its first input.

    An input depends on the seed and its number alone, not on the inputs before it.
    """
    for start in range(first, first + count, target.batch):
        numbers = range(start, min(start + target.batch, first + count))
        yield start, [target.make(random.Random(f"{seed}:{target.name}:{n}")) for n in numbers]
