"""The timeline of a recording: which pushes and answers a client gets, and when.

A recording can hold several clients at a time, which all received the same pushes. The timeline has
the pushes of the connection with the most frames; overlapping connections add only their answers.
"""

from __future__ import annotations

import contextlib
import json
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Literal, NamedTuple

from woosh_robot_agent.endpoints import COMMANDS
from woosh_robot_agent.link.codecs import server_codec
from woosh_robot_agent.link.frames import SUBSCRIPTION_TYPES, Envelope, FrameError
from woosh_robot_agent.link.protos import full_name, message_types
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Twist
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction
from woosh_robot_agent.pb.util.commu_pack_pb2 import Subscription
from woosh_robot_agent.tools.recording.layout import Event, Frame, Record, Recording


class DecodedRecord(NamedTuple):
    """A record, and the envelope of its frame; None for an event or an invalid frame."""

    record: Record
    envelope: Envelope | None


def _decode(record: Record) -> Envelope | None:
    if isinstance(record, Event) or record.invalid:
        return None
    try:
        envelope = server_codec(record.data).decode(record.data)
    except FrameError:
        return None
    if record.sender == "chassis":
        envelope.body = None  # unused, and far larger than the frame
    return envelope


def apply_subscription(topics: set[str], envelope: Envelope, frame: str | bytes) -> None:
    """Change a client's set of subscribed types as its frame requests.

    Raises:
        FrameError: the frame cannot be read.
    """
    subscription = server_codec(frame).body(envelope, Subscription)
    if subscription.sub:
        topics.update(subscription.topics)
    else:
        topics.difference_update(subscription.topics)


COMMAND_TYPES = frozenset(
    {command.request for command in COMMANDS if not command.reads} | {full_name(CallAction)}
) - {full_name(Twist)}
"""Types of the commands for which the playback can wait.

Excluded are reads, which cause no pushes, and velocities, of which there are too many.
"""


StepKind = Literal["open", "subscribed", "command", "push", "lost", "end"]
"""What happened in a step.

- `open`: a client connected.
- `subscribed`: the client, which had no subscriptions, subscribed.
- `command`: the client sent a command.
- `push`: the chassis sent a push.
- `lost`: the connection was lost.
- `end`: the recording ended.
"""


@dataclass(frozen=True, slots=True)
class Step:
    """One step of the timeline.

    Attributes:
        t: time in the recording, in seconds.
        frame: recorded frame of a push or a command; empty for another kind of step.
        type: message type of the frame; empty if the frame is invalid, or there is none.
        subscribed: True for a push of a subscribed type. Other pushes go to all clients.
    """

    t: float
    kind: StepKind
    frame: str | bytes = b""
    type: str = ""
    subscribed: bool = False


def make_timeline(decoded: Iterable[DecodedRecord], connections: set[int]) -> Iterator[Step]:
    """Yield the steps of some connections, which must not overlap in time.

    A connection that the chassis closed counts as lost. One that the client closed counts as lost
    only if a client connected again: otherwise the client was simply stopped.
    """
    topics: set[str] = set()  # the subscribed types
    loss: Step | None = None  # a close by the client that may count as lost
    for record, envelope in decoded:
        if record.connection not in connections:
            continue
        if isinstance(record, Event):
            if record.kind == "open":
                if loss is not None:
                    yield loss
                loss, topics = None, set()
                yield Step(record.t, "open")
            elif record.kind == "close" and record.by == "chassis":
                yield Step(record.t, "lost")
            elif record.kind == "close" and record.by == "client":
                loss = Step(record.t, "lost")
        elif record.sender == "client":
            if envelope is not None:
                yield from _client_steps(record, envelope, topics)
        elif envelope is None or not envelope.sn:  # an unreadable frame counts as a push
            name = "" if envelope is None else envelope.type
            yield Step(record.t, "push", record.data, name, name in topics)


def _client_steps(record: Frame, envelope: Envelope, topics: set[str]) -> Iterator[Step]:
    """Yield the step of a client's frame, if any; update `topics`, the client's subscriptions."""
    if envelope.type in SUBSCRIPTION_TYPES:
        had_none = not topics
        with contextlib.suppress(FrameError):  # the chassis could not read it, either
            apply_subscription(topics, envelope, record.data)
        if had_none and topics:
            yield Step(record.t, "subscribed")
    elif envelope.type in COMMAND_TYPES:
        yield Step(record.t, "command", record.data, envelope.type)


def until_ends(decoded: Iterable[DecodedRecord]) -> Iterator[DecodedRecord]:
    """Yield the records of each connection up to its end; what came later reached nobody."""
    ended: set[int] = set()
    for each in decoded:
        if each.record.connection not in ended:
            yield each
        if isinstance(each.record, Event) and each.record.kind == "close":
            ended.add(each.record.connection)


def main_connections(records: Iterable[Record]) -> set[int]:
    """Return connections that do not overlap in time, preferring those with most chassis frames."""
    frames: Counter[int] = Counter()
    begin: dict[int, float] = {}
    end: dict[int, float] = {}
    for record in records:
        begin.setdefault(record.connection, record.t)
        end[record.connection] = record.t
        if isinstance(record, Frame) and record.sender == "chassis":
            frames[record.connection] += 1
    chosen: set[int] = set()
    for number, _ in frames.most_common():
        if all(end[number] <= begin[other] or end[other] <= begin[number] for other in chosen):
            chosen.add(number)
    return chosen


_Key = tuple[str, bytes | None]
"""Type and body of a request; None instead of the body for a request with any body."""


@dataclass(slots=True)
class Exchange:
    """A recorded request and its answer.

    Attributes:
        t: time of the request in the recording, in seconds.
        answer: frame of the answer; None if there was none.
        delay: time from the request to the answer, in seconds; 0 if there was none.
    """

    t: float
    answer: Frame | None = None
    delay: float = 0.0


class RecordedAnswers:
    """The recorded answers, given in the order in which they were recorded.

    A request gets the answer of a recorded request with the same type and body. If there is no such
    request, only the type has to match. When all answers have been given, the last one is repeated.

    Args:
        decoded: the records of all connections.

    Attributes:
        unmatched: number of answers without a request, which are left out.
    """

    def __init__(self, decoded: Iterable[DecodedRecord]) -> None:
        self.unmatched = 0
        self._recorded: dict[_Key, list[Exchange]] = {}
        self._given: Counter[_Key] = Counter()
        """Number of answers given, by key."""
        pending: dict[tuple[int, int], Exchange] = {}  # by connection and serial number
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

    def take(self, envelope: Envelope, frame: str | bytes) -> Exchange | None:
        """Return the next exchange for a request; None if no request of its type was recorded."""
        for key in _keys(envelope, frame):
            if recorded := self._recorded.get(key):
                index = min(self._given[key], len(recorded) - 1)
                self._given[key] += 1
                return recorded[index]
        return None

    def rewind(self) -> None:
        """Start again with the first answers."""
        self._given.clear()


def _keys(envelope: Envelope, frame: str | bytes) -> tuple[_Key, ...]:
    """Return the keys by which a request is found, the best match first."""
    return (envelope.type, _canonical_body(envelope, frame)), (envelope.type, None)


def _canonical_body(envelope: Envelope, frame: str | bytes) -> bytes:
    """Return the same bytes for equal bodies, also in different encodings if the type is known."""
    cls = message_types().get(envelope.type)
    if cls is not None:
        try:
            return server_codec(frame).body(envelope, cls).SerializeToString(deterministic=True)
        except FrameError:
            pass  # compare the body as it is
    if isinstance(envelope.body, bytes):
        return envelope.body
    return json.dumps(envelope.body, sort_keys=True).encode()


@dataclass(frozen=True)
class Playback:
    """A recording, prepared to be replayed.

    Attributes:
        steps: the timeline.
        duration: time from the first to the last record, in seconds; 0 if there are none.
    """

    steps: list[Step]
    answers: RecordedAnswers
    duration: float


def prepare(recording: Recording) -> Playback:
    """Decode a recording into a timeline and answers."""
    records = recording.records
    decoded = [DecodedRecord(record, _decode(record)) for record in records]
    answers = RecordedAnswers(decoded)
    reached = list(until_ends(decoded))
    steps = list(make_timeline(reached, main_connections(each.record for each in reached)))
    if not records:
        return Playback(steps, answers, 0.0)
    steps.append(Step(records[-1].t, "end"))
    return Playback(steps, answers, records[-1].t - records[0].t)
