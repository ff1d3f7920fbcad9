"""The records of a recording, the libraries that it needs, and its errors."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

import google.protobuf


class RecordingError(Exception):
    """The file is not a valid recording, or the libraries to read and write one are missing."""


Side = Literal["client", "chassis", "recorder"]
EventKind = Literal["open", "close", "refused", "unreadable"]
SIDES: tuple[Side, ...] = ("client", "chassis", "recorder")
EVENTS: tuple[EventKind, ...] = ("open", "close", "refused", "unreadable")


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame, byte for byte.

    Attributes:
        t: Time since the start of the recording, in seconds.
        connection: Number of the connection, from 1.
        sender: Side that sent the frame.
        data: Text of a text frame, bytes of a binary frame.
        invalid: True for a text frame that is not valid UTF-8; `data` holds its bytes.
    """

    t: float
    connection: int
    sender: Side
    data: str | bytes
    invalid: bool = False


@dataclass(frozen=True, slots=True)
class Event:
    """A change of a connection, such as its end.

    Attributes:
        t: Time since the start of the recording, in seconds.
        connection: Number of the connection, from 1.
        kind: `open`, `close`, `refused` (a client connected, but the chassis could not be reached)
            or `unreadable` (the rest of one direction cannot be parsed into frames).
        by: Side that caused the event.
        text: Human-readable explanation.
    """

    t: float
    connection: int
    kind: EventKind
    by: Side
    text: str = ""


Record = Frame | Event


@dataclass(frozen=True)
class Recording:
    """Contents of a recording.

    Attributes:
        address: Address of the recorded chassis.
        started: Unix time of the start, in seconds.
        records: Frames and events, in order.
        damage: Why the end of a file is missing; empty if all files are complete.
        missing_parts: Numbers, from 0, of the files of a split recording that were not given; those
            after the last one that was given are unknown.
    """

    address: str
    started: float
    records: tuple[Record, ...]
    damage: str = ""
    missing_parts: tuple[int, ...] = ()


_PACKAGES = "mcap mcap-protobuf-support foxglove-schemas-protobuf"
"""Packages on PyPI that reading and writing recordings needs."""
_PACKAGES_FOR_OLD_PROTOBUF = "mcap 'mcap-protobuf-support<0.4' 'foxglove-schemas-protobuf<0.4'"
"""Releases that work with protobuf before 5.29, such as that of Ubuntu 24.04."""


def require_libraries() -> None:
    """Check that all libraries are installed and recent enough.

    Raises:
        RecordingError: A library is missing or too old; the text says how to install it.
    """
    release = [int(part) for part in re.findall(r"\d+", google.protobuf.__version__)[:2]]
    packages = _PACKAGES if release >= [5, 29] else _PACKAGES_FOR_OLD_PROTOBUF
    install = f"run: python3 -m pip install --upgrade {packages} (see docs/recordings.md)"
    try:
        import foxglove_schemas_protobuf.Pose_pb2  # noqa: F401
        import mcap_protobuf.schema  # noqa: F401
        import zstandard  # noqa: F401
        from mcap.writer import Writer
    except ImportError as error:
        raise RecordingError(
            f"recordings need Python packages that are not installed ({error}); {install}"
        ) from None
    if not hasattr(Writer, "flush"):
        raise RecordingError(f"the installed mcap is older than 1.6; {install}")
