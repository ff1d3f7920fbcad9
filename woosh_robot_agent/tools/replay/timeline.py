"""Timeline of a replayed chassis: pushes, losses of the connection, and where to pause."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import Enum

from woosh_robot_agent.endpoints import COMMANDS
from woosh_robot_agent.link.codecs.frames import Envelope, FrameError
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Twist
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction
from woosh_robot_agent.protos import full_name
from woosh_robot_agent.tools.recording.records import Event, Frame, Record
from woosh_robot_agent.tools.replay.decoded_record import DecodedRecord
from woosh_robot_agent.tools.replay.subscriptions import apply_subscription, is_subscription

COMMAND_TYPES = frozenset({command.request for command in COMMANDS} | {full_name(CallAction)}) - {
    full_name(Twist)
}
"""Types of the requests that the playback waits for: all but velocities, which are too many."""


class StepKind(Enum):
    """Kind of a step.

    Attributes:
        OPEN: A client connected.
        SUBSCRIBED: The client made its first subscription.
        COMMAND: The client sent a command.
        PUSH: The chassis sent a push.
        LOST: The connection was lost.
        END: The recording ended.
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
        t: Time in the recording, in seconds.
        kind: Kind of the step.
        frame: Recorded frame of a push or a command.
        type: Message type of the frame; empty if the frame is invalid.
        subscribed: True for a push of a subscribed type; other pushes go to all clients.
    """

    t: float
    kind: StepKind
    frame: str | bytes = b""
    type: str = ""
    subscribed: bool = False


def make_timeline(decoded: Iterable[DecodedRecord], connections: set[int]) -> Iterator[Step]:
    """Yield the steps of some connections, which must not overlap in time.

    A connection that the client closed counts as lost only if the client connected again.
    Otherwise the client was simply stopped.
    """
    topics: set[str] = set()
    loss: Step | None = None
    for record, envelope in decoded:
        if record.connection not in connections:
            continue
        if isinstance(record, Event):
            if record.kind == "open":
                if loss is not None:
                    yield loss
                loss, topics = None, set()
                yield Step(record.t, StepKind.OPEN)
            elif record.kind == "close" and record.by != "recorder":
                loss = Step(record.t, StepKind.LOST)
                if record.by == "chassis":
                    yield loss
                    loss = None
        elif record.sender == "client":
            if envelope is not None:
                yield from _client_steps(record, envelope, topics)
        elif envelope is None or not envelope.sn:
            name = "" if envelope is None else envelope.type
            yield Step(record.t, StepKind.PUSH, record.data, name, name in topics)


def _client_steps(record: Frame, envelope: Envelope, topics: set[str]) -> Iterator[Step]:
    if is_subscription(envelope):
        had_none = not topics
        with contextlib.suppress(FrameError):  # the chassis could not read it, either
            apply_subscription(topics, envelope, record.data)
        if had_none and topics:
            yield Step(record.t, StepKind.SUBSCRIBED)
    elif envelope.type in COMMAND_TYPES:
        yield Step(record.t, StepKind.COMMAND, record.data, envelope.type)


def main_connections(records: Iterable[Record]) -> set[int]:
    """Return the connections with the most frames of the chassis, none of which overlap in time."""
    frames: dict[int, int] = {}
    begin: dict[int, float] = {}
    end: dict[int, float] = {}
    for record in records:
        begin.setdefault(record.connection, record.t)
        end[record.connection] = record.t
        if isinstance(record, Frame) and record.sender == "chassis":
            frames[record.connection] = frames.get(record.connection, 0) + 1
    chosen: set[int] = set()
    for number in sorted(frames, key=lambda number: -frames[number]):
        if all(end[number] <= begin[other] or end[other] <= begin[number] for other in chosen):
            chosen.add(number)
    return chosen
