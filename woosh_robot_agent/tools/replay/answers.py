"""Recorded answers, and the choice of one for each request."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass

from woosh_robot_agent.link.codecs.choice import server_codec
from woosh_robot_agent.link.codecs.frames import Envelope, FrameError
from woosh_robot_agent.protos import message_types
from woosh_robot_agent.tools.recording.records import Frame
from woosh_robot_agent.tools.replay.decoded_record import DecodedRecord

_Key = tuple[str, bytes | None]
"""Type and body of a request; None instead of the body for a request with any body."""


@dataclass(slots=True)
class Exchange:
    """A recorded request and its answer.

    Attributes:
        t: Time of the request in the recording, in seconds.
        answer: Frame of the answer; None if there was none.
        delay: Time from the request to the answer, in seconds.
    """

    t: float
    answer: Frame | None = None
    delay: float = 0.0


class RecordedAnswers:
    """The recorded answers, given in the order in which they were recorded.

    A request gets the answer of one with the same type and body. If there is none, the type alone
    has to match. When all answers for a request have been given, the last one is repeated.

    Args:
        decoded: The records.

    Attributes:
        unmatched: Number of answers without a request, which are left out.
    """

    def __init__(self, decoded: Iterable[DecodedRecord]) -> None:
        self.unmatched = 0
        self._recorded: dict[_Key, list[Exchange]] = {}
        self._given: dict[_Key, int] = {}
        """Number of answers given, by request."""
        pending: dict[tuple[int, int], Exchange] = {}
        for record, envelope in decoded:
            if envelope is None or not envelope.sn or not isinstance(record, Frame):
                continue
            request = (record.connection, envelope.sn)
            if record.sender == "client":
                pending[request] = exchange = Exchange(record.t)
                for key in _keys(envelope, record.data):
                    self._recorded.setdefault(key, []).append(exchange)
            elif (answered := pending.pop(request, None)) is not None:
                answered.answer, answered.delay = record, record.t - answered.t
            else:
                self.unmatched += 1

    @property
    def types(self) -> list[str]:
        """Types of all recorded requests."""
        return sorted({name for name, body in self._recorded if body is None})

    def find(self, envelope: Envelope, frame: str | bytes) -> Exchange | None:
        """Return the next exchange for a request; None if none of its type was recorded."""
        for key in _keys(envelope, frame):
            if recorded := self._recorded.get(key):
                index = self._given.get(key, 0)
                self._given[key] = index + 1
                return recorded[min(index, len(recorded) - 1)]
        return None

    def rewind(self) -> None:
        """Start again with the first answers."""
        self._given.clear()


def _keys(envelope: Envelope, frame: str | bytes) -> tuple[_Key, ...]:
    """Return the keys by which a request is found, the best match first."""
    return (envelope.type, _canonical_body(envelope, frame)), (envelope.type, None)


def _canonical_body(envelope: Envelope, frame: str | bytes) -> bytes:
    """Return the same bytes for equal bodies, whatever their encoding."""
    cls = message_types().get(envelope.type)
    if cls is not None:
        try:
            return server_codec(frame).body(envelope, cls).SerializeToString(deterministic=True)
        except FrameError:
            pass  # compare the body as it is
    if isinstance(envelope.body, bytes):
        return envelope.body
    return json.dumps(envelope.body, sort_keys=True).encode()
