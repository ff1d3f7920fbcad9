"""Reads the frames in a stream of bytes that somebody else takes part in; it never answers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple, Protocol

from websockets.frames import Opcode

_wire: Any
try:  # websockets 11 and later
    import websockets.protocol as _wire
except ImportError:  # as Ubuntu 24.04 has it
    import websockets.connection as _wire
_Protocol: Any = getattr(_wire, "Protocol", None) or _wire.Connection

_END_OF_HEAD = b"\r\n\r\n"
_MOST_HEAD = 64 * 1024
_LONGEST_VARINT = 10


class Heard(NamedTuple):
    """What was read.

    Attributes:
        data: a whole frame's payload; for a close, its code and reason.
        text: whether the frame is a text frame.
        close: whether it is the announcement of the end.
    """

    data: bytes
    text: bool = False
    close: bool = False


class UnreadableError(Exception):
    """The stream is not of the expected kind, from here on; the text says how."""


class Ear(Protocol):
    """Listens to one direction of one connection."""

    def feed(self, data: bytes) -> Iterator[Heard]:
        """What has become complete with these further bytes.

        Raises:
            UnreadableError: nothing more can be read.
        """


class WebSocketEar:
    """Listens to one direction of a WebSocket.

    Args:
        masked: whether it is the client's, whose frames are masked.
        max_size: bytes of the largest frame that is read.
    """

    def __init__(self, *, masked: bool, max_size: int) -> None:
        self._head: bytes | None = b""
        side = _wire.Side.SERVER if masked else _wire.Side.CLIENT
        self._protocol = _Protocol(side, state=_wire.State.OPEN, max_size=max_size)
        self._parts: list[bytes] = []
        self._text = False

    def feed(self, data: bytes) -> Iterator[Heard]:
        """See `Ear.feed`."""
        if self._head is not None:
            head, end, data = (self._head + data).partition(_END_OF_HEAD)
            if not end:
                if len(head) > _MOST_HEAD:
                    raise UnreadableError("no WebSocket: it does not begin as one")
                self._head = head
                return
            self._head = None
        if not data:
            return
        self._protocol.receive_data(data)
        self._protocol.data_to_send()  # pongs and the like, which are not ours to send
        for frame in self._protocol.events_received():
            yield from self._frame(frame)
        error = self._protocol.parser_exc
        if error is not None:
            raise UnreadableError(f"no WebSocket any more: {error or type(error).__name__}")

    def _frame(self, frame: Any) -> Iterator[Heard]:
        if frame.opcode is Opcode.CLOSE:
            yield Heard(_close_text(frame.data), close=True)
        if frame.opcode not in (Opcode.TEXT, Opcode.BINARY, Opcode.CONT):
            return
        if frame.opcode is not Opcode.CONT:
            self._text = frame.opcode is Opcode.TEXT
        self._parts.append(bytes(frame.data))
        if frame.fin:
            data, self._parts = b"".join(self._parts), []
            yield Heard(data, text=self._text)


class DelimitedEar:
    """Listens to one direction of protobuf's delimited format.

    Args:
        max_size: bytes of the largest frame that is read.
    """

    def __init__(self, max_size: int) -> None:
        self._max_size = max_size
        self._buffer = bytearray()

    def feed(self, data: bytes) -> Iterator[Heard]:
        """See `Ear.feed`."""
        self._buffer += data
        while (head := self._size()) is not None:
            size, begin = head
            if size > self._max_size:
                raise UnreadableError(f"a frame of {size} bytes, over {self._max_size}")
            if len(self._buffer) < begin + size:
                return
            frame = bytes(self._buffer[begin : begin + size])
            del self._buffer[: begin + size]
            yield Heard(frame)

    def _size(self) -> tuple[int, int] | None:
        """The next frame's size and where it begins; None while that is not complete."""
        size = 0
        for index, byte in enumerate(self._buffer[:_LONGEST_VARINT]):
            size |= (byte & 0x7F) << 7 * index
            if byte < 0x80:
                return size, index + 1
        if len(self._buffer) >= _LONGEST_VARINT:
            raise UnreadableError("a length that is no varint")
        return None


def _close_text(data: bytes) -> bytes:
    if len(data) < 2:
        return b"without a code"
    return f"code {int.from_bytes(data[:2], 'big')} ".encode() + data[2:]
