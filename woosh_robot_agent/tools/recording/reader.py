"""Read a recording."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import IO, Any

import zstandard
from google.protobuf.message import DecodeError
from mcap.exceptions import EndOfFile, InvalidMagic, McapError
from mcap.records import Channel, Chunk, Header, Message, Metadata
from mcap.stream_reader import CRCValidationError, StreamReader, breakup_chunk

from woosh_robot_agent.tools.options import ToolError
from woosh_robot_agent.tools.recording import layout

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
"""Maximum size of a decompressed chunk, in bytes. `record` writes chunks of 1 MiB and one frame."""


class _Stream:
    """A file in which reading beyond the end raises `EndOfFile`.

    Without it, the library could take the rest of a truncated record for a whole one.
    """

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file

    def read(self, size: int) -> bytes:
        data = self._file.read(size)
        if len(data) < size:
            raise EndOfFile
        return data


@dataclass
class _Part:
    """Contents of one file of a recording, which is a part if the recording was split.

    Attributes:
        metadata: metadata of the recording; empty until they are read.
        messages: messages on `FRAMES` and `EVENTS`, with their log times as Unix time in ns.
        damage: why the end of the file is missing; empty if the file is complete.
        has_ros_topics: True for a file of `record --ros`, whose contents are not read.
    """

    path: Path
    metadata: dict[str, str] = field(default_factory=dict)
    messages: list[tuple[int, Any]] = field(default_factory=list)
    damage: str = ""
    has_ros_topics: bool = False

    def read(self, records: Iterator[Any]) -> None:
        """Take over the contents of the MCAP records of the file."""
        classes: dict[int, Any] = {}  # classes of the messages, by the number of their channel
        for record in records:
            if isinstance(record, Header):
                self.has_ros_topics = record.profile == layout.ROS_PROFILE
                if self.has_ros_topics:
                    return
            elif isinstance(record, Channel):
                cls = {
                    layout.FRAMES.topic: layout.FrameMessage,
                    layout.EVENTS.topic: layout.EventMessage,
                }.get(record.topic)
                if cls is not None:
                    classes[record.id] = cls
            elif isinstance(record, Metadata) and record.name == layout.METADATA:
                self.metadata = record.metadata
            elif isinstance(record, Message) and record.channel_id in classes:
                message = classes[record.channel_id].FromString(record.data)
                self.messages.append((record.log_time, message))


def _records(file: IO[bytes]) -> Iterator[Any]:
    """Yield the MCAP records of a file.

    Raises:
        McapError: a chunk expands to more than `_MAX_CHUNK`; or another of `_DAMAGE`.
    """
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


def read_recording(*paths: Path) -> layout.Recording:
    """Read a recording; the end of each file may be missing, as after a crash.

    Args:
        paths: the file, or all files of a split recording in any order. Files of ROS topics, which
            `record --ros` writes in addition, are ignored.

    Raises:
        ToolError: a file cannot be read, is not a recording, is given twice or has only ROS
            topics, or the files are of different recordings.
    """
    parts = [_read_part(path) for path in paths]
    parts = [part for part in parts if not part.has_ros_topics]
    if not parts:
        raise ToolError(
            f"{paths[0]} has only ROS topics: play it with ros2 bag play, or replay the file "
            "without _ros in its name"
        )
    parts.sort(key=lambda part: int(part.metadata["part"]))
    started = parts[0].metadata["started"]
    for former, part in pairwise(parts):
        if part.metadata["started"] != started:
            raise ToolError(f"{part.path} and {parts[0].path} are different recordings")
        if part.metadata["part"] == former.metadata["part"]:
            raise ToolError(f"{former.path} and {part.path} are the same file: leave out one")
    records = tuple(
        _record((log_time - int(started)) / 1e9, message)
        for part in parts
        for log_time, message in part.messages
    )
    damage = "; ".join(part.damage for part in parts if part.damage)
    present = {int(part.metadata["part"]) for part in parts}
    missing = tuple(number for number in range(max(present)) if number not in present)
    return layout.Recording(
        parts[0].metadata.get("address", ""), int(started) / 1e9, records, damage, missing
    )


def _read_part(path: Path) -> _Part:
    """Read one file up to its end, or up to where it is damaged.

    Raises:
        ToolError: the file cannot be read, or has no recording of the supported layout.
    """
    part = _Part(path)
    try:
        with path.open("rb") as file:
            part.read(_records(file))
    except OSError as error:
        raise ToolError(f"cannot read {path}: {error.strerror}") from None
    except InvalidMagic:
        raise ToolError(f"{path} is not a recording: it is no MCAP file") from None
    except EndOfFile:
        part.damage = f"{path} has no end"
    except _DAMAGE as error:
        part.damage = f"{path} is damaged: {error or type(error).__name__}"
    if part.has_ros_topics:
        return part
    version = part.metadata.get("version")
    if version is None:
        raise ToolError(
            f"{path} is not a recording made with `record`: {part.damage or 'it has no frames'}"
        )
    if version != layout.VERSION:
        raise ToolError(
            f"{path} has version {version} of the layout, but this program reads version "
            f"{layout.VERSION}: use the release that recorded the file"
        )
    return part


def _record(t: float, message: Any) -> layout.Record:
    """Return a message of a file as a record; raise `ToolError` for unknown contents."""
    if isinstance(message, layout.EventMessage):
        if message.kind not in layout.EVENT_KINDS:
            raise ToolError(f"unknown event {message.kind!r}")
        _check_side(message.by)
        return layout.Event(t, message.connection, message.kind, message.by, message.text)
    _check_side(message.sender)
    content = message.WhichOneof("content")
    if content is None:
        raise ToolError("a frame has no content")
    data, invalid = getattr(message, content), content == "invalid_text"
    return layout.Frame(t, message.connection, message.sender, data, invalid)


def _check_side(name: str) -> None:
    if name not in layout.SIDES:
        raise ToolError(f"unknown side {name!r}")
