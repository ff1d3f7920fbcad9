"""A recording, prepared to be replayed.

A recording can hold several clients at a time, which all received the same pushes. The timeline is
that of the connection with the most frames; overlapping connections add only their answers.
"""

from __future__ import annotations

from dataclasses import dataclass

from woosh_robot_agent.tools.recording.records import Recording
from woosh_robot_agent.tools.replay.answers import RecordedAnswers
from woosh_robot_agent.tools.replay.decoded_record import decode_records
from woosh_robot_agent.tools.replay.timeline import (
    Step,
    StepKind,
    main_connections,
    make_timeline,
)


@dataclass(frozen=True)
class Playback:
    """A recording, prepared to be replayed.

    Attributes:
        steps: The timeline.
        answers: The answers to requests.
        duration: Time from the first to the last record, in seconds.
    """

    steps: list[Step]
    answers: RecordedAnswers
    duration: float


def prepare(recording: Recording) -> Playback:
    """Decode a recording into a timeline and answers."""
    records = recording.records
    decoded = decode_records(records)
    answers = RecordedAnswers(decoded)
    steps = list(make_timeline(decoded, main_connections(records)))
    if not records:
        return Playback(steps, answers, 0.0)
    steps.append(Step(records[-1].t, StepKind.END))
    return Playback(steps, answers, records[-1].t - records[0].t)
