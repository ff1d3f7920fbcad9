"""Parse the bytes that the proxy forwards into frames, and record the frames in a thread."""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, NamedTuple

from websockets.frames import Opcode

from woosh_robot_agent.tools.recording.layout import EventKind, Side
from woosh_robot_agent.tools.recording.writer import RecordingWriter

_protocol: Any
try:
    import websockets.protocol as _protocol
except ImportError:  # before websockets 11, the module and its class had other names
    import websockets.connection as _protocol
_Protocol: Any = getattr(_protocol, "Protocol", None) or _protocol.Connection

_END_OF_HEADER = b"\r\n\r\n"
_MAX_HEADER = 64 * 1024
"""Maximum size of the HTTP header before the WebSocket frames, in bytes."""
_MAX_VARINT = 10
"""Maximum size of a protobuf varint, in bytes."""


class ParsedFrame(NamedTuple):
    """One frame of a stream.

    Attributes:
        data: payload of the frame; for a close frame, its code and reason as text.
        close: True for a WebSocket close frame.
    """

    data: bytes
    text: bool = False
    close: bool = False


class UnreadableError(Exception):
    """The stream cannot be parsed from here on."""


class WebSocketParser:
    """Parser of one direction of a WebSocket connection, beginning with the HTTP header.

    Args:
        masked: True for the client's direction, in which frames are masked.
        max_size: maximum size of a frame, in bytes.
    """

    def __init__(self, *, masked: bool, max_size: int) -> None:
        self._header: bytes | None = b""
        """Beginning of the HTTP header; None after its end."""
        # the library plays the receiver: the server expects masked frames
        side = _protocol.Side.SERVER if masked else _protocol.Side.CLIENT
        self._protocol = _Protocol(side, state=_protocol.State.OPEN, max_size=max_size)
        self._fragments: list[bytes] = []
        """Payloads of the fragments of the frame that is not complete yet."""
        self._is_text = False
        """True if that frame is a text frame."""

    def feed(self, data: bytes) -> Iterator[ParsedFrame]:
        """Yield the frames that these further bytes complete.

        Raises:
            UnreadableError: the stream cannot be parsed from here on.
        """
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
        self._protocol.data_to_send()  # discard the library's answers, e.g. pongs
        for frame in self._protocol.events_received():
            yield from self._reassemble(frame)
        error = self._protocol.parser_exc
        if error is not None:
            raise UnreadableError(f"invalid WebSocket frame: {str(error) or type(error).__name__}")

    def _reassemble(self, frame: Any) -> Iterator[ParsedFrame]:
        """Yield a close frame, or the data frame that a fragment completes, if any."""
        if frame.opcode is Opcode.CLOSE:
            yield ParsedFrame(_close_text(frame.data), close=True)
        if frame.opcode not in (Opcode.TEXT, Opcode.BINARY, Opcode.CONT):
            return
        if frame.opcode is not Opcode.CONT:  # the first fragment
            self._is_text = frame.opcode is Opcode.TEXT
        self._fragments.append(bytes(frame.data))
        if frame.fin:
            data, self._fragments = b"".join(self._fragments), []
            yield ParsedFrame(data, text=self._is_text)


class DelimitedParser:
    """Parser of one direction of delimited protobuf: before each frame comes its size, as a varint.

    `max_size` is the maximum size of a frame, in bytes.
    """

    def __init__(self, max_size: int) -> None:
        self._max_size = max_size
        self._buffer = bytearray()

    def feed(self, data: bytes) -> Iterator[ParsedFrame]:
        """Yield the frames that these further bytes complete, as `WebSocketParser.feed` does."""
        self._buffer += data
        while (prefix := self._parse_size()) is not None:
            size, begin = prefix
            end = begin + size
            if size > self._max_size:
                raise UnreadableError(f"frame of {size} bytes exceeds the limit {self._max_size}")
            if len(self._buffer) < end:
                return
            frame = bytes(self._buffer[begin:end])
            del self._buffer[:end]
            yield ParsedFrame(frame)

    def _parse_size(self) -> tuple[int, int] | None:
        """Return the next frame's size, and its offset in the buffer; None if bytes are missing."""
        size = 0
        for index, byte in enumerate(self._buffer[:_MAX_VARINT]):
            size |= (byte & 0x7F) << 7 * index
            if byte < 0x80:
                return size, index + 1
        if len(self._buffer) >= _MAX_VARINT:
            raise UnreadableError("invalid size of a frame: not a varint")
        return None


FrameParser = WebSocketParser | DelimitedParser


def _close_text(data: bytes) -> bytes:
    """Return code and reason of a close frame as text."""
    if len(data) < 2:
        return b"without a code"
    return f"code {int.from_bytes(data[:2], 'big')} ".encode() + data[2:]


_LOG = logging.getLogger(__name__)
_BATCH_PERIOD = 0.1
"""Maximum time for which bytes are collected before the frames in them are recorded, in seconds.

Recording a frame in a batch takes about a third of the time that it takes alone, because the
processor has the code and data in its caches.
"""
_MAX_COLLECTED = 1024 * 1024
"""Size of the collected bytes above which the frames in them are recorded at once, in bytes."""
_MAX_WAITING = 64 * 1024 * 1024
"""Total size of batches waiting for a slow disk above which the recording ends, in bytes."""


@dataclass(eq=False)
class Direction:
    """One direction of one connection.

    Attributes:
        parser: parser of the bytes; None once they cannot be parsed.
        on_close: called in the recorder's thread with code and reason of a close frame, and with
            its time of arrival, by `RecordingWriter.now`.
    """

    connection: int
    sender: Side
    parser: FrameParser | None
    on_close: Callable[[str, int], None]


class FrameRecorder:
    """Collects bytes, and records the frames in them in batches.

    The bytes are parsed, and the frames recorded, in a separate thread, so that a slow disk does
    not delay the forwarding. Everything is recorded in the order of the calls. The time of a frame
    is the time of the call of `add` with its last bytes.

    If the disk hangs, the recording ends when `_MAX_WAITING` is exceeded: a forwarded command may
    be a stop, which must not wait for the disk.

    Args:
        writer: writer of the recording. Until `close`, only the separate thread writes with it.
    """

    def __init__(self, writer: RecordingWriter) -> None:
        self._writer = writer
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="recording")
        self._collected: list[tuple[int, Direction, bytes]] = []
        """The current batch: time of arrival, by `RecordingWriter.now`, direction, and bytes."""
        self._collected_size = 0
        """Number of bytes in the current batch."""
        self._waiting: deque[tuple[Future[None], int]] = deque()
        """Work handed over to the thread, each with the number of its bytes, the oldest first."""
        self._timer: asyncio.TimerHandle | None = None
        """Timer that hands the current batch over; None while the batch is empty."""
        self._has_ended = False
        """True once too many bytes waited: nothing more is recorded."""

    def add(self, direction: Direction, data: bytes) -> None:
        """Add bytes to the current batch; record the batch if it is large."""
        if direction.parser is None or self._has_ended:
            return
        self._collected.append((self._writer.now(), direction, data))
        self._collected_size += len(data)
        if self._collected_size > _MAX_COLLECTED:
            self.record()
        elif self._timer is None:
            self._timer = asyncio.get_running_loop().call_later(_BATCH_PERIOD, self.record)

    def add_event(self, connection: int, kind: EventKind, by: Side, text: str = "") -> None:
        """Record an event."""
        self.call(self._writer.add_event, connection, kind, by, text, self._writer.now())

    def call(self, work: Callable[..., None], *arguments: Any) -> None:
        """Record the current batch, and then call a function in the thread."""
        self.record()
        self._hand_over(0, work, *arguments)

    def record(self) -> None:
        """Hand the current batch over to the thread, which records the frames in it."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self._collected:
            collected, self._collected = self._collected, []
            size, self._collected_size = self._collected_size, 0
            self._hand_over(size, self._parse_all, collected)

    def close(self) -> None:
        """Record the current batch, and wait until everything is recorded.

        An error of earlier work is raised here.
        """
        self.record()
        self._thread.shutdown()
        while self._waiting:
            self._waiting.popleft()[0].result()

    def _hand_over(self, size: int, work: Callable[..., None], *arguments: Any) -> None:
        """Run work on `size` bytes in the thread; end the recording if too many bytes wait for it.

        An error of earlier work is raised here.
        """
        if self._has_ended:
            return
        self._waiting.append((self._thread.submit(work, *arguments), size))
        while self._waiting and self._waiting[0][0].done():
            self._waiting.popleft()[0].result()
        if sum(each for _, each in self._waiting) > _MAX_WAITING:
            self._has_ended = True
            self._writer.files.end_early(
                f"the disk of {self._writer.files.paths[-1]} hangs or is too slow: record to "
                "another disk"
            )

    def _parse_all(self, collected: list[tuple[int, Direction, bytes]]) -> None:
        for received, direction, data in collected:
            self._parse(received, direction, data)

    def _parse(self, received: int, direction: Direction, data: bytes) -> None:
        """Record the frames that further bytes of a direction complete."""
        if direction.parser is None:
            return
        number, sender = direction.connection, direction.sender
        try:
            for frame in direction.parser.feed(data):
                if frame.close:
                    direction.on_close(frame.data.decode(errors="replace").strip(), received)
                else:
                    self._writer.add_frame(
                        number, sender, frame.data, text=frame.text, received=received
                    )
        except UnreadableError as error:
            self._give_up(direction, str(error))
        except Exception as error:  # a bug here must not cut the connection
            _LOG.exception("recording connection %d failed", number)
            self._give_up(direction, f"internal error: {error!r}")

    def _give_up(self, direction: Direction, reason: str) -> None:
        """Stop recording a direction of a connection."""
        direction.parser = None
        self._writer.add_event(direction.connection, "unreadable", direction.sender, reason)
        _LOG.warning(
            "no longer recording frames from the %s on connection %d, only forwarding them: %s",
            direction.sender,
            direction.connection,
            reason,
        )
