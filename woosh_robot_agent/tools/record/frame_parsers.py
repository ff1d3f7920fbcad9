"""Parsers that find the frames in a stream of bytes without taking part in the connection."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple, Protocol

from websockets.frames import Opcode

_protocol: Any
try:  # websockets 11 and later
    import websockets.protocol as _protocol
except ImportError:
    import websockets.connection as _protocol
_Protocol: Any = getattr(_protocol, "Protocol", None) or _protocol.Connection

_END_OF_HEADER = b"\r\n\r\n"
_MAX_HEADER = 64 * 1024
"""Maximum size of the HTTP header before a WebSocket stream, in bytes."""
_MAX_VARINT = 10
"""Maximum size of a protobuf varint, in bytes."""


class ParsedFrame(NamedTuple):
    """One frame of a stream.

    Attributes:
        data: Payload of the frame; for a close frame, its code and reason as text.
        text: True for a text frame.
        close: True for a WebSocket close frame.
    """

    data: bytes
    text: bool = False
    close: bool = False


class UnreadableError(Exception):
    """The stream cannot be parsed from here on."""


class FrameParser(Protocol):
    """Parser of one direction of one connection."""

    def feed(self, data: bytes) -> Iterator[ParsedFrame]:
        """Yield the frames that are complete with these further bytes.

        Raises:
            UnreadableError: The stream cannot be parsed from here on.
        """


class WebSocketParser:
    """Parser of one direction of a WebSocket connection, beginning with the HTTP header.

    Args:
        masked: True for the client's direction, in which frames are masked.
        max_size: Maximum size of a frame, in bytes.
    """

    def __init__(self, *, masked: bool, max_size: int) -> None:
        self._header: bytes | None = b""
        """Beginning of the HTTP header; None after its end."""
        side = _protocol.Side.SERVER if masked else _protocol.Side.CLIENT
        self._protocol = _Protocol(side, state=_protocol.State.OPEN, max_size=max_size)
        self._fragments: list[bytes] = []
        self._is_text = False

    def feed(self, data: bytes) -> Iterator[ParsedFrame]:
        if self._header is not None:
            header, end, data = (self._header + data).partition(_END_OF_HEADER)
            if not end:
                if len(header) > _MAX_HEADER:
                    raise UnreadableError("not a WebSocket: the HTTP header has no end")
                self._header = header
                return
            self._header = None
        if not data:
            return
        self._protocol.receive_data(data)
        self._protocol.data_to_send()  # discards its answers, e.g. pongs
        for frame in self._protocol.events_received():
            yield from self._add(frame)
        error = self._protocol.parser_exc
        if error is not None:
            raise UnreadableError(f"invalid WebSocket frame: {error or type(error).__name__}")

    def _add(self, frame: Any) -> Iterator[ParsedFrame]:
        if frame.opcode is Opcode.CLOSE:
            yield ParsedFrame(_close_text(frame.data), close=True)
        if frame.opcode not in (Opcode.TEXT, Opcode.BINARY, Opcode.CONT):
            return
        if frame.opcode is not Opcode.CONT:
            self._is_text = frame.opcode is Opcode.TEXT
        self._fragments.append(bytes(frame.data))
        if frame.fin:
            data, self._fragments = b"".join(self._fragments), []
            yield ParsedFrame(data, text=self._is_text)


class DelimitedParser:
    """Parser of one direction of delimited protobuf: each frame follows its size as a varint.

    Args:
        max_size: Maximum size of a frame, in bytes.
    """

    def __init__(self, max_size: int) -> None:
        self._max_size = max_size
        self._buffer = bytearray()

    def feed(self, data: bytes) -> Iterator[ParsedFrame]:
        self._buffer += data
        while (prefix := self._parse_size()) is not None:
            size, begin = prefix
            if size > self._max_size:
                raise UnreadableError(f"frame of {size} bytes exceeds the limit {self._max_size}")
            if len(self._buffer) < begin + size:
                return
            frame = bytes(self._buffer[begin : begin + size])
            del self._buffer[: begin + size]
            yield ParsedFrame(frame)

    def _parse_size(self) -> tuple[int, int] | None:
        """Return the next frame's size and offset; None while the size is not complete."""
        size = 0
        for index, byte in enumerate(self._buffer[:_MAX_VARINT]):
            size |= (byte & 0x7F) << 7 * index
            if byte < 0x80:
                return size, index + 1
        if len(self._buffer) >= _MAX_VARINT:
            raise UnreadableError("invalid size of a frame: not a varint")
        return None


def _close_text(data: bytes) -> bytes:
    if len(data) < 2:
        return b"without a code"
    return f"code {int.from_bytes(data[:2], 'big')} ".encode() + data[2:]
