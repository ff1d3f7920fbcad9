"""Reading a recording."""

from __future__ import annotations

import base64
import binascii
import json
import zlib
from pathlib import Path
from typing import Any

from woosh_robot_agent.tools.recording.records import (
    EVENTS,
    FORMAT,
    SIDES,
    VERSION,
    Event,
    Frame,
    Record,
    Recording,
    Side,
)

_GZIP_WINDOW = 16 + zlib.MAX_WBITS
"""Value of `wbits` with which zlib expects a gzip header."""


class RecordingError(Exception):
    """The file is not a valid recording."""


def read_recording(path: Path) -> Recording:
    """Read a recording; its end may be missing, as after a crash.

    Raises:
        OSError: The file cannot be read.
        RecordingError: The file is not a valid recording.
    """
    data, damage = _read(path)
    *lines, rest = data.split(b"\n")
    if rest:
        damage = damage or "the last line is not complete"
    if not lines:
        raise RecordingError(f"{path} is not a recording: it has no header")
    header = _parse_line(path, 1, lines[0])
    if header.get("format") != FORMAT:
        raise RecordingError(f"{path} is not a recording: its first line is not a header")
    if header.get("version") != VERSION:
        raise RecordingError(
            f"{path} has version {header.get('version')} of the format, but this program reads "
            f"version {VERSION}: use the release that recorded the file"
        )
    records = []
    for number, line in enumerate(lines[1:], start=2):
        try:
            records.append(_make_record(_parse_line(path, number, line)))
        except (KeyError, TypeError, ValueError, binascii.Error) as error:
            raise RecordingError(
                f"{path}: line {number} is not a valid record: {error!r}"
            ) from None
    return Recording(
        str(header.get("address", "")), float(header.get("started", 0)), tuple(records), damage
    )


def _read(path: Path) -> tuple[bytes, str]:
    """Return the uncompressed contents of a file, and what is wrong with its end."""
    data = path.read_bytes()
    if path.suffix != ".gz":
        return data, ""
    decompressor = zlib.decompressobj(_GZIP_WINDOW)
    try:
        data = decompressor.decompress(data)
    except zlib.error as error:
        raise RecordingError(f"{path} is not a gzip file: {error}") from None
    return data, "" if decompressor.eof else "the compressed file is truncated"


def _parse_line(path: Path, number: int, line: bytes) -> dict[str, Any]:
    try:
        found = json.loads(line)
    except ValueError as error:
        raise RecordingError(f"{path}: line {number} is not JSON: {error}") from None
    if not isinstance(found, dict):
        raise RecordingError(f"{path}: line {number} is not a JSON object")
    return found


def _make_record(line: dict[str, Any]) -> Record:
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
