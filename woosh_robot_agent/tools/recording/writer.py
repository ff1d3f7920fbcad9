"""Writing a recording."""

from __future__ import annotations

import base64
import gzip
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

from woosh_robot_agent.tools.recording.records import FORMAT, VERSION, EventKind, Side

_FLUSH_PERIOD = 1.0
"""Minimum time between two flushes of a compressed file, in seconds.

Frequent flushes make the compression worse.
"""


class RecordingWriter:
    """Writes a recording so that a crash loses little; compressed if the name ends in `.gz`.

    A file error ends the recording but is not raised, because the proxy must keep forwarding.

    Args:
        path: Path of the new file; it must not exist.
        address: Address of the chassis, for the header.
        max_size: Maximum size of the file, in bytes; reaching it ends the recording.
        on_early_end: Called once with the reason if the recording ends before `close`.

    Attributes:
        path: Path of the file.
        frames: Number of frames written.
        connections: Number of connections seen.
        failed: True if the recording ended before `close`, or the file is not complete.

    Raises:
        OSError: The file cannot be created.
    """

    def __init__(
        self, path: Path, address: str, max_size: int, on_early_end: Callable[[str], None]
    ) -> None:
        self.path = path
        self.frames = 0
        self.connections = 0
        self.failed = False
        self._is_open = True
        self._on_early_end = on_early_end
        self._max_size = max_size
        self._raw = path.open("xb")
        self._file: IO[bytes] = (
            gzip.GzipFile(fileobj=self._raw, mode="wb", filename="", mtime=0)  # type: ignore[assignment]
            if path.suffix == ".gz"
            else self._raw
        )
        self._start = self._flushed_at = time.monotonic()
        self._write(
            {"format": FORMAT, "version": VERSION, "started": time.time(), "address": address}
        )

    def frame(self, connection: int, sender: Side, data: bytes, *, text: bool) -> None:
        """Write a frame that has just passed."""
        line: dict[str, Any] = {"t": self._now(), "connection": connection, "from": sender}
        try:
            if not text:
                raise UnicodeError
            line["text"] = data.decode()
        except UnicodeError:
            line["base64"] = base64.b64encode(data).decode()
            if text:
                line["invalid"] = True
        if self._write(line):
            self.frames += 1

    def event(self, connection: int, kind: EventKind, by: Side, text: str = "") -> None:
        """Write an event that has just happened."""
        self.connections = max(self.connections, connection)
        line = {"t": self._now(), "connection": connection, "event": kind, "by": by}
        self._write(line | ({"text": text} if text else {}))

    def flush(self) -> None:
        """Pass everything written so far on to the operating system."""
        if self._is_open:
            self._flushed_at = time.monotonic()
            self._try(self._file.flush)

    def close(self) -> None:
        """Complete and close the file."""
        if self._is_open and (error := self._close_files()):
            self._fail(f"{self.path} is not complete: {error}")

    def _now(self) -> float:
        return round(time.monotonic() - self._start, 6)

    def _write(self, line: dict[str, Any]) -> bool:
        if not self._is_open:
            return False
        data = json.dumps(line, ensure_ascii=False, separators=(",", ":")).encode() + b"\n"
        if self._raw.tell() + len(data) > self._max_size:
            self._end_early(f"{self.path} has reached its size limit of {self._max_size} bytes")
            return False
        is_compressed = self._file is not self._raw
        self._try(lambda: self._file.write(data))
        if not is_compressed or time.monotonic() - self._flushed_at > _FLUSH_PERIOD:
            self.flush()
        return self._is_open

    def _try(self, work: Callable[[], object]) -> None:
        try:
            work()
        except OSError as error:
            self._end_early(f"cannot write to {self.path}: {error.strerror or error}")

    def _end_early(self, reason: str) -> None:
        self._close_files()  # further errors follow from the first one
        self._fail(reason)

    def _close_files(self) -> OSError | None:
        """Close the file; return the first error."""
        self._is_open = False
        first_error = None
        for file in (self._file, self._raw):
            try:
                file.close()
            except OSError as error:
                first_error = first_error or error
        return first_error

    def _fail(self, reason: str) -> None:
        self.failed = True
        self._on_early_end(reason)
