r"""The file of a recording: JSON lines, a header first, then what passed on the link.

    {"format": "woosh_robot_agent recording", "version": 1, "started": 1700000000.0, "address": ...}
    {"t": 0.01, "connection": 1, "event": "open", "by": "client", "text": "127.0.0.1:41234"}
    {"t": 0.02, "connection": 1, "from": "client", "text": "{\"type\":\"woosh.robot.Mode\", ...}"}
    {"t": 0.03, "connection": 1, "from": "chassis", "base64": "CgRieXRl"}

`t` is in s since `started`, which is Unix time. A text frame is `text`, a binary one `base64`; one
that claims to be text and is not UTF-8 is `base64` too, with `"invalid": true`.
"""

from __future__ import annotations

import base64
import binascii
import gzip
import json
import time
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Literal

FORMAT = "woosh_robot_agent recording"
VERSION = 1
_FLUSH_EVERY = 1.0
"""s that a compressed recording may lag behind: flushing it costs space."""
_GZIP = 16 + zlib.MAX_WBITS

Side = Literal["client", "chassis", "recorder"]
EventKind = Literal["open", "close", "refused", "unreadable"]
SIDES: tuple[Side, ...] = ("client", "chassis", "recorder")
EVENTS: tuple[EventKind, ...] = ("open", "close", "refused", "unreadable")


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame, byte for byte.

    Attributes:
        t: when it passed, s since the start.
        connection: number of its connection, from 1.
        sender: who sent it.
        data: a text frame's text or a binary frame's bytes.
        invalid: it claims to be text and is not UTF-8; `data` is its bytes.
    """

    t: float
    connection: int
    sender: Side
    data: str | bytes
    invalid: bool = False


@dataclass(frozen=True, slots=True)
class Event:
    """Something else that happened to a connection.

    Attributes:
        t: when, s since the start.
        connection: its number.
        kind: it was opened; closed; the chassis could not be reached; what follows on it in one
            direction cannot be read.
        by: who did it.
        text: more about it, for people.
    """

    t: float
    connection: int
    kind: EventKind
    by: Side
    text: str = ""


Record = Frame | Event


@dataclass(frozen=True)
class Recording:
    """What a file holds.

    Attributes:
        address: the chassis that was recorded.
        started: Unix time in s of its start.
        records: everything, in order.
        damage: why the file's end is missing, empty if it is whole.
    """

    address: str
    started: float
    records: tuple[Record, ...]
    damage: str = ""


class RecordingError(Exception):
    """A file that is no recording; the text says why."""


class Writer:
    """Writes a recording, so that a crash loses little. Compressed where the name ends in `.gz`.

    Trouble with the file ends the recording and nothing else: whatever passes through is needed.

    Args:
        path: must not exist.
        address: the chassis, for the header.
        max_size: bytes after which the recording ends.
        ended: is called once, with the reason, if the recording ends early.

    Attributes:
        frames: how many were written.
        connections: how many were seen.

    Raises:
        OSError: the file cannot be made.
    """

    def __init__(
        self, path: Path, address: str, max_size: int, ended: Callable[[str], None]
    ) -> None:
        self.path = path
        self.frames = 0
        self.connections = 0
        self.ended = ""
        self._tell = ended
        self._max_size = max_size
        self._raw = path.open("xb")
        self._file: IO[bytes] = (
            gzip.GzipFile(fileobj=self._raw, mode="wb", filename="", mtime=0)  # type: ignore[assignment]
            if path.suffix == ".gz"
            else self._raw
        )
        self._start = self._flushed = time.monotonic()
        self._write(
            {"format": FORMAT, "version": VERSION, "started": time.time(), "address": address}
        )

    def now(self) -> float:
        """The time for a record, s since the start."""
        return round(time.monotonic() - self._start, 6)

    def frame(self, connection: int, sender: Side, data: bytes, *, text: bool) -> None:
        """Write a frame that passed just now."""
        line: dict[str, Any] = {"t": self.now(), "connection": connection, "from": sender}
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
        """Write what happened just now."""
        self.connections = max(self.connections, connection)
        line = {"t": self.now(), "connection": connection, "event": kind, "by": by}
        self._write(line | ({"text": text} if text else {}))

    def flush(self) -> None:
        """Bring what was written to the disk."""
        if not self.ended:
            self._flushed = time.monotonic()
            self._guard(self._file.flush)

    def close(self) -> None:
        """End the file in an orderly way."""
        if not self.ended:
            self._end("closed", quiet=True)

    def _write(self, line: dict[str, Any]) -> bool:
        if self.ended:
            return False
        data = json.dumps(line, ensure_ascii=False, separators=(",", ":")).encode() + b"\n"
        if self._raw.tell() + len(data) > self._max_size:
            self._end(f"{self.path} has reached its size limit, {self._max_size} bytes")
            return False
        compressed = self._file is not self._raw
        self._guard(lambda: self._file.write(data))
        if not compressed or time.monotonic() - self._flushed > _FLUSH_EVERY:
            self.flush()
        return not self.ended

    def _guard(self, work: Callable[[], object]) -> None:
        try:
            work()
        except OSError as error:
            self._end(f"{self.path} cannot be written any more: {error.strerror or error}")

    def _end(self, reason: str, *, quiet: bool = False) -> None:
        self.ended = reason
        for file in (self._file, self._raw):
            try:
                file.close()
            except OSError as error:
                if quiet:  # else the first reason is the one that counts
                    quiet, self.ended = False, f"{self.path} is not complete: {error}"
        if not quiet:
            self._tell(self.ended)


def read(path: Path) -> Recording:
    """The recording in a file; its end may be missing, as after a crash.

    Raises:
        OSError: the file cannot be read.
        RecordingError: it is no recording.
    """
    data, damage = _content(path)
    *lines, rest = data.split(b"\n")
    if rest:
        damage = damage or "its last line is not complete"
    if not lines:
        raise RecordingError(f"{path} is no recording: it has no header")
    header = _object(path, 1, lines[0])
    if header.get("format") != FORMAT:
        raise RecordingError(f"{path} is no recording: its first line is not the header of one")
    if header.get("version") != VERSION:
        raise RecordingError(
            f"{path} has version {header.get('version')} of the format, and this program reads "
            f"{VERSION}: use the one that recorded it"
        )
    records = []
    for number, line in enumerate(lines[1:], start=2):
        try:
            records.append(_record(_object(path, number, line)))
        except (KeyError, TypeError, ValueError, binascii.Error) as error:
            raise RecordingError(f"{path}: line {number} is no record: {error!r}") from None
    return Recording(
        str(header.get("address", "")), float(header.get("started", 0)), tuple(records), damage
    )


def _content(path: Path) -> tuple[bytes, str]:
    data = path.read_bytes()
    if path.suffix != ".gz":
        return data, ""
    unpack = zlib.decompressobj(_GZIP)
    try:
        data = unpack.decompress(data)
    except zlib.error as error:
        raise RecordingError(f"{path} is no gzip file: {error}") from None
    return data, "" if unpack.eof else "the compressed file breaks off"


def _object(path: Path, number: int, line: bytes) -> dict[str, Any]:
    try:
        found = json.loads(line)
    except ValueError as error:
        raise RecordingError(f"{path}: line {number} is not JSON: {error}") from None
    if not isinstance(found, dict):
        raise RecordingError(f"{path}: line {number} is no JSON object")
    return found


def _record(line: dict[str, Any]) -> Record:
    t, connection = float(line["t"]), int(line["connection"])
    if "event" in line:
        kind = line["event"]
        if kind not in EVENTS:
            raise ValueError(f"unknown event {kind!r}")
        return Event(t, connection, kind, _side(line["by"]), str(line.get("text", "")))
    sender = _side(line["from"])
    if "text" in line:
        return Frame(t, connection, sender, str(line["text"]))
    data = base64.b64decode(line["base64"], validate=True)
    return Frame(t, connection, sender, data, bool(line.get("invalid")))


def _side(name: str) -> Side:
    for side in SIDES:
        if name == side:
            return side
    raise ValueError(f"unknown side {name!r}")
