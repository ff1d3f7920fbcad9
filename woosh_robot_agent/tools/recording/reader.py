"""Read a recording."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import IO, Any

import zstandard
from google.protobuf.message import DecodeError
from mcap.exceptions import EndOfFile, InvalidMagic, McapError
from mcap.records import Channel, Chunk, Header, Message, Metadata
from mcap.stream_reader import CRCValidationError, StreamReader, breakup_chunk

from woosh_robot_agent.tools.recording.layout import (
    EVENT_KINDS,
    EVENTS,
    FRAMES,
    METADATA,
    ROS_PROFILE,
    SIDES,
    VERSION,
    Event,
    EventMessage,
    Frame,
    FrameMessage,
    Record,
    Recording,
    RecordingError,
    Side,
)

_DAMAGE = (
    McapError,
    CRCValidationError,
    zstandard.ZstdError,
    DecodeError,
    struct.error,
    ValueError,
    KeyError,
    MemoryError,
    OverflowError,
)
"""Errors that the library raises for damaged contents."""
_MAX_CHUNK = 256 * 1024 * 1024
"""Maximum size of a decompressed chunk, in bytes. `record` ends a chunk with the first frame after
1 MiB."""


class _Stream:
    """A file in which reading beyond the end raises `EndOfFile`."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file

    def read(self, size: int) -> bytes:
        data = self._file.read(size)
        if len(data) < size:
            raise EndOfFile
        return data


class _Part:
    """Contents of one file of a recording, which is a part if the recording was split."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.metadata: dict[str, str] = {}
        self.messages: list[tuple[int, Any]] = []
        """The messages on the channels that are replayed, with their log times."""
        self.damage = ""
        """Why the end of the file is missing; empty if the file is complete."""
        self.has_ros_topics = False
        """True for a file of `record --ros`, which is not read further."""

    def read(self) -> None:
        """Read the file up to its end, or up to where it is damaged.

        Raises:
            RecordingError: the file cannot be read, or is no MCAP file.
        """
        try:
            opened = self.path.open("rb")
        except OSError as error:
            raise RecordingError(f"cannot read {self.path}: {error.strerror}") from None
        with opened as file:
            try:
                self._read(_records(file))
            except InvalidMagic:
                raise RecordingError(
                    f"{self.path} is not a recording: it is no MCAP file; replay a file in the "
                    "former format (.jsonl) with the release that recorded it"
                ) from None
            except EndOfFile:
                self.damage = f"{self.path} has no end"
            except _DAMAGE as error:
                self.damage = f"{self.path} is damaged: {error or type(error).__name__}"

    def _read(self, records: Iterator[Any]) -> None:
        classes: dict[int, Any] = {}
        for record in records:
            if isinstance(record, Header):
                self.has_ros_topics = record.profile == ROS_PROFILE
                if self.has_ros_topics:
                    return
            elif isinstance(record, Channel):
                cls = {FRAMES.topic: FrameMessage, EVENTS.topic: EventMessage}.get(record.topic)
                if cls is not None:
                    classes[record.id] = cls
            elif isinstance(record, Metadata) and record.name == METADATA:
                self.metadata = record.metadata
            elif isinstance(record, Message) and record.channel_id in classes:
                message = classes[record.channel_id].FromString(record.data)
                self.messages.append((record.log_time, message))


def _records(file: IO[bytes]) -> Iterator[Any]:
    """Yield the records of a file; a chunk that expands to more than `_MAX_CHUNK` is damage."""
    reader = StreamReader(_Stream(file), emit_chunks=True, validate_crcs=True)  # type: ignore[arg-type]
    for record in reader.records:
        if not isinstance(record, Chunk):
            yield record
            continue
        size = record.uncompressed_size
        if record.compression == "zstd":  # the library trusts the size in the compressed data more
            size = max(size, zstandard.frame_content_size(record.data))
        if size > _MAX_CHUNK:
            raise McapError(f"a chunk of {size} bytes is more than {_MAX_CHUNK}")
        yield from breakup_chunk(record, validate_crc=True)


def read_recording(*paths: Path) -> Recording:
    """Read a recording; the end of each file may be missing, as after a crash.

    Args:
        paths: the file, or all files of a split recording in any order. Files of ROS topics, which
            `record --ros` writes in addition, are ignored.

    Raises:
        RecordingError: a file cannot be read or is not a recording, or the files are of different
            recordings.
    """
    parts = [part for path in paths if not (part := _read_part(path)).has_ros_topics]
    if not parts:
        raise RecordingError(
            f"{paths[0]} has only ROS topics: play it with ros2 bag play, or replay the file "
            "without _ros in its name"
        )
    parts.sort(key=lambda part: int(part.metadata["part"]))
    started = parts[0].metadata["started"]
    for former, part in pairwise(parts):
        if part.metadata["started"] != started:
            raise RecordingError(f"{part.path} and {parts[0].path} are different recordings")
        if part.metadata["part"] == former.metadata["part"]:
            raise RecordingError(f"{former.path} and {part.path} are the same file: leave out one")
    records = tuple(
        _record((log_time - int(started)) / 1e9, message)
        for part in parts
        for log_time, message in part.messages
    )
    damage = "; ".join(part.damage for part in parts if part.damage)
    present = {int(part.metadata["part"]) for part in parts}
    missing = tuple(number for number in range(max(present)) if number not in present)
    return Recording(
        parts[0].metadata.get("address", ""), int(started) / 1e9, records, damage, missing
    )


def _read_part(path: Path) -> _Part:
    """Read one file.

    Raises:
        RecordingError: the file cannot be read, or has no recording of the supported layout.
    """
    part = _Part(path)
    part.read()
    if part.has_ros_topics:
        return part
    version = part.metadata.get("version")
    if version is None:
        raise RecordingError(
            f"{path} is not a recording made with `record`: {part.damage or 'it has no frames'}"
        )
    if version != VERSION:
        raise RecordingError(
            f"{path} has version {version} of the layout, but this program reads version "
            f"{VERSION}: use the release that recorded the file"
        )
    return part


def _record(t: float, message: Any) -> Record:
    if isinstance(message, EventMessage):
        if message.kind not in EVENT_KINDS:
            raise RecordingError(f"unknown event {message.kind!r}")
        return Event(t, message.connection, message.kind, _side(message.by), message.text)
    sender = _side(message.sender)
    content = message.WhichOneof("content")
    if content is None:
        raise RecordingError("a frame has no content")
    return Frame(
        t, message.connection, sender, getattr(message, content), content == "invalid_text"
    )


def _side(name: str) -> Side:
    for side in SIDES:
        if name == side:
            return side
    raise RecordingError(f"unknown side {name!r}")
