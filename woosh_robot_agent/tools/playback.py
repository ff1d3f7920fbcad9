"""What a recording says, made ready to be replayed: a timeline of pushes, and answers to requests.

A recording can hold several clients at a time, who all heard the same robot. The timeline is that
of the connection on which most was heard; of those that overlap it only requests and answers count.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from enum import Enum
from typing import NamedTuple

from woosh_robot_agent.endpoints import COMMANDS
from woosh_robot_agent.link.codecs.frames import SUBSCRIPTION_TYPE, Envelope, FrameError
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Twist
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction
from woosh_robot_agent.pb.util.commu_pack_pb2 import Subscription
from woosh_robot_agent.protos import full_name, message_types
from woosh_robot_agent.simulator.serving.client import codec_of
from woosh_robot_agent.tools.recording import Event, Frame, Record, Recording

_SUBSCRIPTIONS = (SUBSCRIPTION_TYPE, full_name(Subscription))
COMMAND_TYPES = frozenset({command.request for command in COMMANDS} | {full_name(CallAction)}) - {
    full_name(Twist)
}
"""Requests that make the robot do something; velocities come too often to be waited for."""


class Kind(Enum):
    """What a step of the timeline is.

    A client was connected, had subscribed, had sent a command; the chassis pushed something; the
    connection was lost; the recording is over.
    """

    OPEN = "open"
    SUBSCRIBED = "subscribed"
    COMMAND = "command"
    PUSH = "push"
    LOST = "lost"
    END = "end"


@dataclass(frozen=True, slots=True)
class Step:
    """One step of the timeline.

    Attributes:
        t: its time in the recording, s.
        kind: what it is.
        frame: the push or the command as it was recorded.
        type: the push's or the command's type, empty for a frame that cannot be read.
        wanted: whether the push's type had been subscribed to; others go to everybody.
    """

    t: float
    kind: Kind
    frame: str | bytes = b""
    type: str = ""
    wanted: bool = False


@dataclass(slots=True)
class Exchange:
    """One request that was recorded, and its answer.

    Attributes:
        t: when it was sent, s.
        answer: the frame that answered it; None where none came.
        delay: s until the answer.
    """

    t: float
    answer: Frame | None = None
    delay: float = 0.0


class Answers:
    """The recorded answers, to be given in the order in which they were recorded.

    A request is matched by type and body, else by type alone. What was asked more often than it was
    recorded gets the last one again.
    """

    def __init__(self) -> None:
        self._recorded: dict[tuple[str, bytes | None], list[Exchange]] = {}
        self._given: dict[tuple[str, bytes | None], int] = {}

    @property
    def types(self) -> list[str]:
        """The types of all recorded requests."""
        return sorted({name for name, body in self._recorded if body is None})

    def add(self, envelope: Envelope, frame: str | bytes, exchange: Exchange) -> None:
        """Add one, the oldest first."""
        for key in _keys(envelope, frame):
            self._recorded.setdefault(key, []).append(exchange)

    def find(self, envelope: Envelope, frame: str | bytes) -> Exchange | None:
        """The exchange that a request gets replayed; None if there was none of its type."""
        for key in _keys(envelope, frame):
            if recorded := self._recorded.get(key):
                index = self._given.get(key, 0)
                self._given[key] = index + 1
                return recorded[min(index, len(recorded) - 1)]
        return None

    def rewind(self) -> None:
        """Begin with the first ones again."""
        self._given.clear()


@dataclass
class Playback:
    """A recording, ready to be replayed.

    Attributes:
        steps: the timeline.
        answers: the answers to requests.
        strays: answers of the chassis to nothing that was asked, or asked twice; left out.
        duration: s from the first to the last record.
    """

    steps: list[Step] = field(default_factory=list)
    answers: Answers = field(default_factory=Answers)
    strays: int = 0
    duration: float = 0.0


class _Decoded(NamedTuple):
    record: Record
    envelope: Envelope | None


def prepare(recording: Recording) -> Playback:
    """Make a recording ready."""
    playback = Playback()
    decoded = [_Decoded(record, _decode(record)) for record in recording.records]
    main = _main_connections(recording.records)
    playback.strays = _pair(decoded, playback.answers)
    playback.steps = list(_timeline(decoded, main))
    if recording.records:
        playback.duration = recording.records[-1].t - recording.records[0].t
        playback.steps.append(Step(recording.records[-1].t, Kind.END))
    return playback


def _decode(record: Record) -> Envelope | None:
    if isinstance(record, Event) or record.invalid:
        return None
    try:
        return codec_of(record.data).decode(record.data)
    except FrameError:
        return None


def _main_connections(records: Iterable[Record]) -> set[int]:
    """Those on which most was heard, none of which overlaps another."""
    heard: dict[int, int] = {}
    begun: dict[int, float] = {}
    ended: dict[int, float] = {}
    for record in records:
        begun.setdefault(record.connection, record.t)
        ended[record.connection] = record.t
        if isinstance(record, Frame) and record.sender == "chassis":
            heard[record.connection] = heard.get(record.connection, 0) + 1
    main: set[int] = set()
    for number in sorted(heard, key=lambda number: -heard[number]):
        if all(ended[number] <= begun[m] or ended[m] <= begun[number] for m in main):
            main.add(number)
    return main


def _pair(decoded: Iterable[_Decoded], answers: Answers) -> int:
    """Give `answers` every request with its answer; returns the number of answers to nothing."""
    waiting: dict[tuple[int, int], Exchange] = {}
    strays = 0
    for record, envelope in decoded:
        if envelope is None or not envelope.sn or not isinstance(record, Frame):
            continue
        key = (record.connection, envelope.sn)
        if record.sender == "client":
            waiting[key] = exchange = Exchange(record.t)
            answers.add(envelope, record.data, exchange)
        elif (asked := waiting.pop(key, None)) is not None:
            asked.answer, asked.delay = record, record.t - asked.t
        else:
            strays += 1
    return strays


def _timeline(decoded: Iterable[_Decoded], main: set[int]) -> Iterator[Step]:
    topics: set[str] = set()
    lost: Step | None = None
    for record, envelope in decoded:
        if record.connection not in main:
            continue
        if isinstance(record, Event):
            if record.kind == "open":
                if lost is not None:  # a client that went, and came again
                    yield lost
                lost, topics = None, set()
                yield Step(record.t, Kind.OPEN)
            elif record.kind == "close" and record.by != "recorder":
                lost = Step(record.t, Kind.LOST)
                if record.by == "chassis":
                    yield lost
                    lost = None
        elif record.sender == "client":
            yield from _of_client(record, envelope, topics)
        elif envelope is None or not envelope.sn:
            name = "" if envelope is None else envelope.type
            yield Step(record.t, Kind.PUSH, record.data, name, name in topics)


def _of_client(record: Frame, envelope: Envelope | None, topics: set[str]) -> Iterator[Step]:
    if envelope is None:
        return
    if envelope.type in _SUBSCRIPTIONS:
        first = not topics
        subscribe(topics, envelope, record.data)
        if first and topics:
            yield Step(record.t, Kind.SUBSCRIBED)
    elif envelope.type in COMMAND_TYPES:
        yield Step(record.t, Kind.COMMAND, record.data, envelope.type)


def is_subscription(envelope: Envelope) -> bool:
    """Whether a client's frame says what it wants to hear."""
    return envelope.type in _SUBSCRIPTIONS


def subscribe(topics: set[str], envelope: Envelope, frame: str | bytes) -> None:
    """Change what a client wants to hear, as its subscription says.

    Raises:
        FrameError: it cannot be read.
    """
    subscription = codec_of(frame).body(envelope, Subscription)
    if subscription.sub:
        topics.update(subscription.topics)
    else:
        topics.difference_update(subscription.topics)


def _keys(envelope: Envelope, frame: str | bytes) -> tuple[tuple[str, bytes | None], ...]:
    """What a request is found by, the best first."""
    return (envelope.type, _body(envelope, frame)), (envelope.type, None)


def _body(envelope: Envelope, frame: str | bytes) -> bytes:
    """The same bytes for equal bodies, however they were written."""
    cls = message_types().get(envelope.type)
    if cls is not None:
        try:
            return codec_of(frame).body(envelope, cls).SerializeToString(deterministic=True)
        except FrameError:
            pass  # to be compared as it stands
    if isinstance(envelope.body, bytes):
        return envelope.body
    return json.dumps(envelope.body, sort_keys=True).encode()
