"""Small clients of the chassis.

They are written from the protocol's description, independently of `woosh_robot_agent.link`.
"""

from __future__ import annotations

import asyncio
import json
import socket
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from typing import Any

import websockets
from google.protobuf.message import Message

from woosh_robot_agent.link.protos import message_type
from woosh_robot_agent.pb.util.commu_pack_pb2 import MessagePackJson, Subscription
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.testing import running_chassis

TIMEOUT = 60.0

Json = dict[str, Any]


class AskingClient(ABC):
    """Methods that clients share, whether they wait for the chassis or step it by hand.

    Attributes:
        pushes: pushes that have not been asked for yet.
    """

    def __init__(self) -> None:
        self.pushes: deque[Json] = deque()

    @abstractmethod
    def request(self, type_name: str, body: Json | None = None) -> Json:
        """Return the whole answer. Pushes that arrive before it are kept in `pushes`."""

    @abstractmethod
    def receive(self) -> Json:
        """Return the next frame that is not in `pushes`."""

    def ask(self, type_name: str, body: Json | None = None) -> Json:
        """Return the body of the answer, which must be ok."""
        answer = self.request(type_name, body)
        assert answer["ok"] is True, answer
        found: Json = answer["body"]
        return found

    def refusal(self, type_name: str, body: Json | None = None) -> str:
        """Return the text of the answer, which must not be ok."""
        answer = self.request(type_name, body)
        assert answer["ok"] is False, answer
        assert answer["body"] == {}
        text: str = answer["msg"]
        return text

    def next_push(
        self, type_name: str, matches: Callable[[Json], bool] = lambda body: True
    ) -> Json:
        """Return the body of the next matching push. Earlier frames are dropped."""
        deadline = time.monotonic() + TIMEOUT
        while True:
            frame = self.pushes.popleft() if self.pushes else self.receive()
            if frame["type"] == type_name and matches(frame["body"]):
                body: Json = frame["body"]
                return body
            assert time.monotonic() < deadline, f"no {type_name} that matches"

    def take_pushes(self, type_name: str) -> list[Json]:
        """Return the bodies of all pushes of a type so far. The other pushes are dropped."""
        self.ask("woosh.robot.Mode")
        found = [frame["body"] for frame in self.pushes if frame["type"] == type_name]
        self.pushes.clear()
        return found


class JsonClient(AskingClient):
    """Blocking client for JSON text frames over a WebSocket.

    Attributes:
        simulator: the simulated chassis, unless it runs as a program.
    """

    def __init__(self, port: int, simulator: SimulatorThread | None = None) -> None:
        super().__init__()
        self.simulator: Any = simulator
        self._loop = asyncio.new_event_loop()
        self._sn = 0
        try:
            self.socket: Any = self.complete(_connect(f"ws://127.0.0.1:{port}"))
        except BaseException:
            self._loop.close()
            raise

    def close(self) -> None:
        try:
            self.complete(self.socket.close())
        finally:
            self._loop.close()

    def send(self, frame: Json | str | bytes) -> None:
        data = json.dumps(frame) if isinstance(frame, dict) else frame
        self.complete(self.socket.send(data))

    def receive(self, timeout: float = TIMEOUT) -> Json:
        frame: Json = json.loads(self.complete(self.socket.recv(), timeout))
        return frame

    def assert_silent(self, seconds: float) -> None:
        """Check that no frame arrives for this long. No event could tell that none will come."""
        try:
            frame = self.receive(timeout=seconds)
        except asyncio.TimeoutError:
            return
        raise AssertionError(f"received {frame}")

    def request(self, type_name: str, body: Json | None = None) -> Json:
        self._sn += 1
        self.send({"type": type_name, "body": body or {}, "sn": self._sn})
        while True:
            frame = self.receive()
            if frame.get("sn") == self._sn:
                return frame
            self.pushes.append(frame)

    def subscribe(self, *topics: str, sub: bool = True) -> None:
        """Subscribe, and return once the chassis has processed it."""
        self.send({"type": "woosh.Subscription", "body": {"topics": list(topics), "sub": sub}})
        self.ask("woosh.robot.Mode")

    def complete(self, awaitable: Any, timeout: float = TIMEOUT) -> Any:
        """Wait for an awaitable of `socket`, and return its result."""

        async def bounded() -> Any:
            return await asyncio.wait_for(awaitable, timeout)

        return self._loop.run_until_complete(bounded())


async def _connect(address: str) -> Any:
    # Unread frames must not delay closing.
    return await websockets.connect(address, max_size=None, max_queue=None, ping_interval=None)


@contextmanager
def connected(**options: Any) -> Iterator[JsonClient]:
    """Run a simulated chassis, by default in real time, and connect a client to it.

    Args:
        options: options of `running_chassis`.
    """
    chassis = running_chassis(**{"speed": 1.0, **options})
    with chassis as simulator, closing(JsonClient(simulator.port, simulator)) as client:
        yield client


def pass_time(simulator: SimulatorThread, seconds: float) -> None:
    """Return once `seconds` of simulated time have passed."""
    until = simulator.state.elapsed + seconds
    deadline = time.monotonic() + TIMEOUT
    while simulator.state.elapsed < until:
        assert time.monotonic() < deadline, "simulated time hardly moves"
        time.sleep(0.005)


def packed(type_name: str, body: Message | None = None, sn: int = 0) -> bytes:
    """Return a protobuf frame."""
    pack = MessagePackJson(type=type_name, sn=sn)
    if body is not None:
        pack.body.Pack(body)
    return pack.SerializeToString()


def subscription(*topics: str) -> bytes:
    return packed("woosh.Subscription", Subscription(topics=topics, sub=True))


def body_of(pack: MessagePackJson) -> Any:
    """Return the body of a protobuf frame, of the type named by the frame."""
    message = message_type(pack.type)()
    assert pack.body.Unpack(message)
    return message


class TcpClient:
    """Blocking client for protobuf frames over TCP, each with its length as a varint.

    Attributes:
        simulator: the simulated chassis, unless it runs as a program.
    """

    def __init__(self, port: int, simulator: SimulatorThread | None = None) -> None:
        self.simulator: Any = simulator
        self._socket = socket.create_connection(("127.0.0.1", port), TIMEOUT)
        self._file = self._socket.makefile("rb")

    def close(self) -> None:
        self._file.close()
        self._socket.close()

    def send(self, frame: bytes) -> None:
        size, length = bytearray(), len(frame)
        while length > 0x7F:
            size.append(length & 0x7F | 0x80)
            length >>= 7
        size.append(length)
        self._socket.sendall(bytes(size) + frame)

    def receive(self) -> MessagePackJson:
        return MessagePackJson.FromString(self.receive_bytes())

    def receive_bytes(self) -> bytes:
        """Return the next frame undecoded; raise ConnectionError if there is none."""
        length = shift = 0
        while True:
            byte = self._file.read(1)
            if not byte:
                raise ConnectionError("closed")
            length |= (byte[0] & 0x7F) << shift
            shift += 7
            if byte[0] < 0x80:
                break
        data = self._file.read(length)
        if len(data) < length:
            raise ConnectionError("closed in the middle of a frame")
        return data

    def request(self, type_name: str, body: Message | None = None, sn: int = 1) -> MessagePackJson:
        self.send(packed(type_name, body, sn))
        while True:
            pack = self.receive()
            if pack.sn == sn:
                return pack


Connect = Callable[[], JsonClient]
ConnectTcp = Callable[[], TcpClient]
