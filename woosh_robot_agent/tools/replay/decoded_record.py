"""Records with their decoded envelopes."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from woosh_robot_agent.link.codecs.choice import server_codec
from woosh_robot_agent.link.codecs.frames import Envelope, FrameError
from woosh_robot_agent.tools.recording.records import Event, Record


class DecodedRecord(NamedTuple):
    """A record, and the envelope of its frame; None for an event or an invalid frame."""

    record: Record
    envelope: Envelope | None


def decode_records(records: Iterable[Record]) -> list[DecodedRecord]:
    """Decode the envelopes of all frames."""
    return [DecodedRecord(record, _decode(record)) for record in records]


def _decode(record: Record) -> Envelope | None:
    if isinstance(record, Event) or record.invalid:
        return None
    try:
        return server_codec(record.data).decode(record.data)
    except FrameError:
        return None
