"""Contents of a recording, as `replay` needs them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

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
