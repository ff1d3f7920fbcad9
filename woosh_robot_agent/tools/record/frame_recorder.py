"""Recording of the frames in the bytes that a proxy forwards."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from dataclasses import dataclass

from woosh_robot_agent.tools.record.frame_parsers import FrameParser, UnreadableError
from woosh_robot_agent.tools.recording.records import EventKind, Side
from woosh_robot_agent.tools.recording.writer import RecordingWriter

_LOG = logging.getLogger(__name__)
_BATCH_PERIOD = 0.1
"""Time for which bytes are collected before the frames in them are recorded, in seconds.

Recording a frame in a batch takes about a third of the time that a single one takes, for which the
processor has to load code and data into its caches again.
"""
_MAX_COLLECTED = 1024 * 1024
"""Size of the collected bytes above which the frames in them are recorded at once, in bytes."""


@dataclass(eq=False)
class Direction:
    """One direction of one connection.

    Attributes:
        connection: Number of the connection.
        sender: Side that sends the bytes.
        parser: Parser of the bytes; None once they cannot be parsed.
        on_close: Called with code and reason of a close frame.
    """

    connection: int
    sender: Side
    parser: FrameParser | None
    on_close: Callable[[str], None]


class FrameRecorder:
    """Collects bytes, and finds and records the frames in them several times a second.

    Frames and events are recorded in the order of the calls. The time of a frame is that of the
    call that completed it.

    Args:
        writer: Writer of the recording.
    """

    def __init__(self, writer: RecordingWriter) -> None:
        self._writer = writer
        self._collected: list[tuple[int, Direction, bytes]] = []
        """Time of arrival, in ns, and bytes that have not been parsed."""
        self._collected_size = 0
        self._timer: asyncio.TimerHandle | None = None

    def add(self, direction: Direction, data: bytes) -> None:
        """Record the frames in these bytes, at once or a bit later."""
        if direction.parser is None:
            return
        self._collected.append((self._writer.now(), direction, data))
        self._collected_size += len(data)
        if self._collected_size > _MAX_COLLECTED:
            self.record()
        elif self._timer is None:
            self._timer = asyncio.get_running_loop().call_later(_BATCH_PERIOD, self.record)

    def event(self, connection: int, kind: EventKind, by: Side, text: str = "") -> None:
        """Record an event."""
        self.record()
        self._writer.event(connection, kind, by, text)

    def flush(self) -> None:
        """Record what has been collected, and pass it on to the operating system."""
        self.record()
        self._writer.flush()

    def record(self) -> None:
        """Record the frames in what has been collected."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        collected, self._collected, self._collected_size = self._collected, [], 0
        for received, direction, data in collected:
            self._parse(received, direction, data)

    def _parse(self, received: int, direction: Direction, data: bytes) -> None:
        if direction.parser is None:
            return
        number, sender = direction.connection, direction.sender
        try:
            for frame in direction.parser.feed(data):
                if frame.close:
                    direction.on_close(frame.data.decode(errors="replace").strip())
                else:
                    self._writer.frame(
                        number, sender, frame.data, text=frame.text, received=received
                    )
        except UnreadableError as error:
            self._give_up(direction, str(error))
        except Exception as error:  # a bug here must not cut the connection
            _LOG.exception("recording connection %d failed", number)
            self._give_up(direction, f"internal error: {error!r}")

    def _give_up(self, direction: Direction, reason: str) -> None:
        direction.parser = None
        self._writer.event(direction.connection, "unreadable", direction.sender, reason)
        _LOG.warning(
            "no longer recording frames from the %s on connection %d, only forwarding them: %s",
            direction.sender,
            direction.connection,
            reason,
        )
