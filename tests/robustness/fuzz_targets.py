"""What is fuzzed: the codecs and the framing alone, the client and the simulator by sockets.

A target takes the inputs that its seed makes, one by one or some at a time, and raises what must
not happen: any error but the documented ones, and whatever it finds wrong afterwards.
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

from tests.link.link_peer import Frame, Packed, Peer, Wire
from tests.robustness import fuzz_inputs as inputs
from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.link.codecs.frames import FrameError
from woosh_robot_agent.link.codecs.json_codec import JsonCodec
from woosh_robot_agent.link.codecs.protobuf_codec import ProtobufCodec
from woosh_robot_agent.link.transports import TcpTransport, TransportClosedError, open_transport
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Speak
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo
from woosh_robot_agent.protos import full_name, message_types
from woosh_robot_agent.simulator import SimulatedChassis, SimulatorConfig
from woosh_robot_agent.simulator.protocol.pushes import TOPICS

try:
    from tests.table import PAIRS
    from woosh_robot_agent.convert import BadFieldError, converter
except ImportError:  # where there is no ROS
    PAIRS = {}

_OLD = int(websockets.__version__.split(".")[0]) < 14
"""Whether a text frame that is not UTF-8 ends the connection, before the link has seen it."""
_ANSWER_LIMIT = 60.0
_SURE_SN = 1_500_000_000
"""Serial number of the requests that have to be answered; no input has it."""
ACCEPTED = "accepted"


class Target(ABC):
    """One thing to fuzz.

    Attributes:
        name: for the table and the command line.
        batch: how many inputs `feed` takes at a time.
        share: of all inputs, how many are for this target.
    """

    name: str
    batch = 1
    share: float

    @abstractmethod
    def make(self, rng: random.Random) -> Any:
        """One input."""

    @abstractmethod
    def feed(self, batch: Sequence[Any]) -> Counter[str]:
        """Take some inputs.

        Returns:
            How many were accepted, and how many refused of each kind.

        Raises:
            Exception: it did what it must not.
        """

    def close(self) -> None:  # noqa: B027
        """Give everything back."""


class _Codec(Target):
    """A codec: the envelope, the body as its type says and as another one, and on to ROS."""

    codec: Any

    def feed(self, batch: Sequence[Any]) -> Counter[str]:
        (data,) = batch
        try:
            envelope = self.codec.decode(data)
            envelope.msg.encode()  # can be logged
            envelope.type.encode()
            classes = [message_types().get(envelope.type), _other_class(data)]
            for cls in classes:
                if cls is not None:
                    _to_ros(self.codec.body(envelope, cls))
        except FrameError as error:
            if len(str(error).encode()) > 2000:
                raise ValueError("no text for people") from error
            return Counter([error.kind])
        return Counter([ACCEPTED])


def _other_class(data: str | bytes) -> type[Message] | None:
    """For one of eight frames a class that they are not of, the same each time."""
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
    except BadFieldError as error:  # the robot must not get it, but it may say so
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
    """A target that works in an event loop."""

    def __init__(self) -> None:
        self.loop = asyncio.new_event_loop()
        self.troubles: list[str] = []
        self.loop.set_exception_handler(
            lambda _, context: self.troubles.append(str(context.get("exception") or context))
        )
        self._handler = logging.Handler(logging.ERROR)
        self._handler.emit = self._logged  # type: ignore[method-assign]
        logging.getLogger("woosh_robot_agent").addHandler(self._handler)

    def _logged(self, record: logging.LogRecord) -> None:
        if record.levelno >= logging.ERROR:
            self.troubles.append(logging.Formatter().format(record))

    def feed(self, batch: Sequence[Any]) -> Counter[str]:
        found = self.loop.run_until_complete(self.take(batch))
        if self.troubles:
            troubles, self.troubles = self.troubles, []
            raise AssertionError("\n".join(troubles))
        return found

    @abstractmethod
    async def take(self, batch: Sequence[Any]) -> Counter[str]: ...

    def close(self) -> None:
        logging.getLogger("woosh_robot_agent").removeHandler(self._handler)
        self.loop.run_until_complete(asyncio.sleep(0.01))
        self.loop.close()


class TcpFraming(_Loop):
    """The delimited format: a stream of whole, damaged and badly measured frames."""

    name = "TCP framing"
    share = 0.1
    max_size = 4000

    def make(self, rng: random.Random) -> bytes:
        out = b""
        for _ in range(rng.choice((1, 1, 2, 4))):
            frame = inputs.blob(rng)
            size = len(frame) if rng.random() < 0.8 else rng.choice((0, 1, 127, 2**20, 2**63))
            out += Packed.varint(size) + frame
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
                said = str(error).partition(":")[0]
                return found or Counter([re.sub(r"\d+", "so many", said)])
            found = found or Counter([kind])


class _Writer:
    """What a transport asks of the side that writes."""

    def __init__(self) -> None:
        self.transport: Any = self

    def get_extra_info(self, name: str) -> None:
        return None


class _Client(_Loop):
    """The client of a peer that babbles: it counts each frame, and goes on."""

    batch = 100
    share = 0.04
    kind: str

    def __init__(self) -> None:
        super().__init__()
        self._stack = contextlib.AsyncExitStack()
        self.loop.run_until_complete(self._open())

    async def _open(self) -> None:
        async def script(wire: Wire, frame: Frame) -> bool:
            sure = bool(frame.get("sn", 0) >= _SURE_SN)
            if sure:
                await wire.answer(frame, {} if self.kind == "json" else b"")
            return sure

        self._peer = await self._stack.enter_async_context(Peer(self.kind))
        limits = {"liveness_timeout": 600.0, "max_in_flight": 1000}
        self._client = await self._stack.enter_async_context(self._peer.client(**limits))
        self._peer.script = script
        self._peer.auto = False
        self._wire = await self._peer.wire()
        for name in sorted(TOPICS):
            self._client.subscribe(message_types()[name], lambda push: None)

    def make(self, rng: random.Random) -> bytes:
        return inputs.text(rng).encode(errors="replace" if _OLD else "surrogatepass")

    async def take(self, batch: Sequence[Any]) -> Counter[str]:
        client, connection = self._client, self._client._connection
        assert connection is not None, client.last_error
        stats = client.stats
        before, rx = Counter(stats.bad_frames), stats.rx
        connection._next_sn = 1
        open_ = [asyncio.ensure_future(client.request(RobotInfo())) for _ in range(8)]
        await asyncio.sleep(0)
        connection._next_sn = _SURE_SN
        for data in batch:
            self._wire.transport.write(self.packed(data))
        answer = await client.request(Speak(), _ANSWER_LIMIT)
        assert answer.ok
        for task in open_:
            task.cancel()
        await asyncio.gather(*open_, return_exceptions=True)
        assert stats.connects == 1, f"the link was lost: {client.last_error}"
        bad = Counter(stats.bad_frames) - before
        read = stats.rx - rx - 1  # besides the answer
        skipped = sum(number for kind, number in bad.items() if kind != "body")
        assert read + skipped == len(batch), f"{read} read and {skipped} skipped of {len(batch)}"
        bad.pop("body", None)  # of a frame that was read: an answer or a push, told as such
        return bad + Counter({ACCEPTED: read})

    def packed(self, data: bytes) -> bytes:
        opcode = 0x81 if self.kind == "json" else 0x82
        if len(data) < 126:
            return bytes([opcode, len(data)]) + data
        return bytes([opcode, 127]) + len(data).to_bytes(8, "big") + data

    def close(self) -> None:
        self.loop.run_until_complete(self._stack.aclose())
        super().close()


class JsonClient(_Client):
    name = "client, JSON over WebSocket"
    kind = "json"


class TcpClient(_Client):
    name = "client, protobuf over TCP"
    kind = "tcp"
    share = 0.02

    def make(self, rng: random.Random) -> bytes:
        return inputs.blob(rng)

    def packed(self, data: bytes) -> bytes:
        return Packed.varint(len(data)) + data


class _Simulator(_Loop):
    """The simulated chassis, which has to serve the next client well."""

    batch = 50

    def __init__(self) -> None:
        super().__init__()
        self._simulator = SimulatedChassis(
            SimulatorConfig(port=0, tcp_port=0, speed=100, seed=1, max_frame=4 * 1024 * 1024)
        )
        self.loop.run_until_complete(self._simulator.start())

    async def open(self, transport: str = "websocket") -> Any:
        port = self._simulator.port if transport == "websocket" else self._simulator.tcp_port
        where = LinkConfig(ip="127.0.0.1", port=port, transport=transport, connect_timeout=30)
        return await open_transport(where)

    async def check(self) -> None:
        """A new client is answered, and nothing of the state is out of this world."""
        transport = await self.open()
        try:
            await transport.send(JsonCodec().encode("woosh.robot.RobotInfo", None, sn=_SURE_SN))
            answer = JsonCodec().decode(await self._within(transport.recv()))
            assert (answer.sn, answer.ok) == (_SURE_SN, True), answer.msg
            JsonCodec().body(answer, RobotInfo)
        finally:
            await transport.close()
        state = self._simulator.state
        for part in (state, state.pose, state.velocity):
            for field in fields(part):
                value = getattr(part, field.name)
                assert not isinstance(value, float) or math.isfinite(value), (field.name, value)
        assert state.elapsed > 0

    @staticmethod
    async def _within(work: Any) -> Any:
        return await asyncio.wait_for(work, _ANSWER_LIMIT)

    def close(self) -> None:
        self.loop.run_until_complete(self._simulator.stop())
        super().close()


class Requests(_Simulator):
    """Requests of every type with extreme values, and damaged ones, over all three encodings."""

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
        if isinstance(data, str):  # this client cannot send what is no text
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
                # of the encoding that the transport has by default
                codec: Any = JsonCodec() if where == "websocket" else ProtobufCodec()
                await transport.send(codec.encode("woosh.robot.Mode", None, sn=_SURE_SN))
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
            if answer.sn == _SURE_SN:
                return
            if answer.ok is None:
                continue  # a push
            assert "internal error" not in answer.msg, answer
            found[ACCEPTED if answer.ok else "refused with a text"] += 1
            assert answer.ok or answer.msg


class RawBytes(_Simulator):
    """Bytes into the ports that are no handshake, or a damaged one, or no frames after one."""

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
                shake = rng.choice(_DAMAGES)(rng, shake)
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
        port = self._simulator.tcp_port if tcp else self._simulator.port
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        with contextlib.suppress(OSError):  # it may end the connection before it has read all
            writer.write(data)
            writer.write_eof()
            while await reader.read(65536):
                pass
        writer.transport.abort()


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
"""By the name on the command line."""


def batches(
    target: Target, seed: int, count: int, first: int = 0
) -> Iterator[tuple[int, list[Any]]]:
    """The inputs of a target in the portions that it takes, each with the number of its first.

    The same seed and number give the same input, whatever came before it.
    """
    for start in range(first, first + count, target.batch):
        numbers = range(start, min(start + target.batch, first + count))
        yield start, [target.make(random.Random(f"{seed}:{target.name}:{n}")) for n in numbers]
