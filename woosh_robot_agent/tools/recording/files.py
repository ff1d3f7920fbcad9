"""Write the MCAP files of a recording."""

from __future__ import annotations

import contextlib
import math
import os
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from mcap.writer import Writer

from woosh_robot_agent.tools.recording.layout import Channel

_CHUNK_SIZE = 1024 * 1024
"""Total size of messages above which a chunk is compressed and written, in bytes."""
_NEVER = 2**62
"""Chunk size that is never reached: `McapFile` ends each chunk, to know what is written."""
_LIBRARY = "woosh_robot_agent"


class McapFile:
    """Writes one file in chunks, so that it can be read up to the last chunk after a crash.

    Args:
        path: path of the new file; it must not exist.
        profile: MCAP profile, for the header of the file; empty for none.

    Attributes:
        written: number of messages in the file, by topic, without those in `pending`.
        pending: number of messages in the chunk that is not written yet, by topic.

    Raises:
        OSError: the file cannot be created.
    """

    def __init__(self, path: Path, profile: str) -> None:
        self.path = path
        self.written: Counter[str] = Counter()
        self.pending: Counter[str] = Counter()
        self._file = path.open("xb")
        self._writer = Writer(self._file, chunk_size=_NEVER)
        self._writer.start(profile=profile, library=_LIBRARY)
        self._schemas: dict[tuple[str, str], int] = {}
        self._channels: dict[Channel, int] = {}
        self._size = 0
        """Size of the file after the last `flush`, in bytes."""
        self._pending_size = 0
        """Size of the messages in the chunk that is not written yet, in bytes."""
        try:
            self.flush()
        except OSError as error:
            self.abandon()
            path.unlink()  # an empty file would block the next attempt
            error.filename = path
            raise

    @property
    def size(self) -> int:
        """Size of the file, with the messages that are not written yet, in bytes.

        They are not compressed yet. `close` adds an index, usually of less than 1 %.
        """
        return self._size + self._pending_size

    def add(self, channel: Channel, log_time: int, publish_time: int, data: bytes) -> None:
        """Add a message to the chunk; write the chunk if it is full.

        Args:
            log_time: time of recording, in ns.
            publish_time: time of sending by the sender's clock, in ns.
        """
        number = self._channels.get(channel)
        if number is None:
            number = self._register(channel)
        topic = channel.topic
        sequence = self.written[topic] + self.pending[topic]
        self._writer.add_message(number, log_time, data, publish_time, sequence)
        self.pending[topic] += 1
        self._pending_size += len(data)
        if self._pending_size > _CHUNK_SIZE:
            self.flush()

    def attach(self, name: str, media_type: str, data: bytes, log_time: int) -> None:
        """Write an attachment after the messages so far; `log_time` is its time, in ns."""
        self.flush()
        self._writer.add_attachment(log_time, log_time, name, media_type, data)
        self.flush()

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Write metadata after the messages so far."""
        self.flush()
        self._writer.add_metadata(name, values)
        self.flush()

    def flush(self) -> None:
        """Write the pending chunk, and pass everything on to the operating system."""
        self._writer.flush()
        self._size = self._file.tell()
        self._pending_size = 0
        self.written.update(self.pending)
        self.pending.clear()

    def close(self) -> None:
        """Complete and close the file."""
        self.flush()
        self._writer.finish()
        self._file.close()

    def abandon(self) -> None:
        """Close the file after an error, and cut off what was written since the last `flush`."""
        with contextlib.suppress(OSError):
            self._file.close()
        with contextlib.suppress(OSError):
            os.truncate(self.path, self._size)

    def _register(self, channel: Channel) -> int:
        """Register a channel, and its schema if that is new in the file; return its number."""
        key = (channel.schema_name, channel.schema_encoding)
        if key not in self._schemas:
            self._schemas[key] = self._writer.register_schema(
                channel.schema_name, channel.schema_encoding, channel.schema
            )
        number = self._channels[channel] = self._writer.register_channel(
            channel.topic, channel.message_encoding, self._schemas[key], channel.metadata
        )
        return number


@dataclass(frozen=True)
class Limits:
    """Limits of a recording. It is split into several files if one of the last two is set.

    Attributes:
        max_size: maximum size of all files together, in bytes, without their indexes; reaching it
            ends the recording.
        split_size: size of one file after which the next file begins, in bytes, without its index
            and what it begins with, such as maps; 0 for no limit.
        split_duration: duration after which the next file begins, in seconds; 0 for no limit.
    """

    max_size: int
    split_size: int = 0
    split_duration: float = 0.0


class RecordingFiles:
    """Writes messages into one file, or into several files, one after the other.

    An error ends the recording but is not raised, because `RecordingProxy` must keep forwarding.

    Args:
        path: path of the new file, which must not exist. The names of the files of a split
            recording have a number, from 0, before the suffix.
        on_new_file: called with each new file, to write the start of the file, e.g. the last map.
        on_early_end: called once with the reason if the recording ends before `close`, or if
            `close` fails.
        profile: MCAP profile, for the header of the files; empty for none.

    Attributes:
        paths: paths of the files so far.
        failed: True if the recording ended before `close`, or a file is not complete.

    Raises:
        OSError: the first file cannot be created.
    """

    def __init__(
        self,
        path: Path,
        limits: Limits,
        on_new_file: Callable[[McapFile], None],
        on_early_end: Callable[[str], None],
        profile: str = "",
    ) -> None:
        self.paths: list[Path] = []
        self.failed = False
        self._path = path
        self._limits = limits
        self._on_new_file = on_new_file
        self._on_early_end = on_early_end
        self._profile = profile
        self._closed_size = 0
        """Size of the completed files, in bytes."""
        self._closed_count: Counter[str] = Counter()
        """Number of messages in the completed files, by topic."""
        self._start: int | None = None
        """Log time of the first message of `add` in the current file, in ns; None before it."""
        self._begun_at = self._flushed_at = 0.0
        """Monotonic times of the start of the current file, and of its last `flush`, in seconds."""
        self._begin_size = 0
        """Size of the current file right after `on_new_file`, in bytes."""
        self._split_after = limits.split_duration * 1e9 or math.inf
        """Duration after which the next file begins, in ns; infinite without a limit."""
        self._file: McapFile | None = None
        """The current file; None after the end of the recording."""
        self._begin_file()

    @property
    def is_open(self) -> bool:
        """True until the end of the recording."""
        return self._file is not None

    def count(self, topic: str) -> int:
        """Return the number of messages of a topic in the files.

        Those in the chunk that is not written yet are not counted.
        """
        current = 0 if self._file is None else self._file.written[topic]
        return self._closed_count[topic] + current

    def add(
        self, channel: Channel, log_time: int, data: bytes, publish_time: int | None = None
    ) -> bool:
        """Write a message.

        Args:
            log_time: time of recording, in ns.
            publish_time: time of sending by the sender's clock, in ns; None if unknown.

        Returns:
            False if the recording has ended.
        """
        published = log_time if publish_time is None else publish_time

        def work(_: McapFile) -> None:
            self._apply_limits(log_time, len(data))
            if self._file is None:
                return
            # not the argument `_`, because `_apply_limits` may have begun the next file
            self._file.add(channel, log_time, published, data)
            if self._start is None:
                self._start = log_time

        self._write(work)
        return self._file is not None

    def attach(self, name: str, media_type: str, data: bytes, log_time: int) -> None:
        """Write an attachment, unless it would exceed `max_size`; `log_time` is its time, in ns."""

        def work(file: McapFile) -> None:
            if self._closed_size + file.size + len(data) <= self._limits.max_size:
                file.attach(name, media_type, data, log_time)

        self._write(work)

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Write metadata."""
        self._write(lambda file: file.add_metadata(name, values))

    def flush(self) -> None:
        """Pass everything written so far on to the operating system, if this is due.

        In a file that is less than an hour old, it is always due. In an older one, it is due when
        1/3600 of the file's age has passed since the last flush, e.g. every 24 s after a day: each
        flush adds a chunk to the index, which stays in memory until `close`.
        """
        now = time.monotonic()
        period = (now - self._begun_at) / 3600
        if period <= 1.0 or now - self._flushed_at >= period:
            self._flushed_at = now
            self._write(McapFile.flush)

    def close(self) -> None:
        """Complete and close the current file."""
        self._write(lambda _: self._close_file())

    def _write(self, work: Callable[[McapFile], None]) -> None:
        """Call `work` with the current file, if any; an OSError in it ends the recording."""
        if self._file is not None:
            try:
                work(self._file)
            except OSError as error:
                self._fail(error)

    def _apply_limits(self, log_time: int, size: int) -> None:
        """Begin the next file or end the recording if a message would exceed a limit.

        `log_time` is that of the message, in ns, and `size` is its size, in bytes.
        """
        file = self._file
        assert file is not None
        if file.pending and self._exceeded_limit(file.size + size):
            file.flush()  # compressed, the chunk may be small enough
        exceeded = self._exceeded_limit(file.size + size)
        if exceeded == "max_size":
            self._close_file()
            self.end_early(
                f"{self._path} has reached its size limit of {self._limits.max_size} bytes"
            )
        elif self._start is None:  # the first message of a file stays in it, whatever its size
            return
        elif exceeded == "split_size" or log_time - self._start >= self._split_after:
            self._close_file()
            self._begin_file()
            self._apply_limits(log_time, size)  # the start of the next file may reach `max_size`

    def _exceeded_limit(self, size: int) -> str:
        """Return the limit that the current file would exceed with a size of `size` bytes.

        It is "max_size", the limit of all files together, or "split_size"; empty for none.
        """
        if self._closed_size + size > self._limits.max_size:
            return "max_size"
        split = self._limits.split_size
        return "split_size" if split and size - self._begin_size > split else ""

    def _begin_file(self) -> None:
        path = self._path
        if self._limits.split_size or self._limits.split_duration:
            path = path.with_name(f"{path.stem}_{len(self.paths)}{path.suffix}")
        self._file = McapFile(path, self._profile)
        self.paths.append(path)
        self._on_new_file(self._file)
        self._file.flush()
        self._start, self._begin_size = None, self._file.size
        self._begun_at = self._flushed_at = time.monotonic()

    def _close_file(self) -> None:
        file = self._file
        assert file is not None
        file.close()
        self._file = None
        self._closed_size += file.path.stat().st_size
        self._closed_count.update(file.written)

    def _fail(self, error: OSError) -> None:
        """End the recording because of an error; keep what has been written."""
        path = self._path
        if self._file is not None:
            path = self._file.path
            self._closed_count.update(self._file.written)
            self._file.abandon()
            self._file = None
        self.end_early(f"cannot write to {error.filename or path}: {error.strerror or error}")

    def end_early(self, reason: str) -> None:
        """Note that nothing more is recorded, for a reason; only the first one is told."""
        if self.failed:
            return
        self.failed = True
        self._on_early_end(reason)
