"""Counters of the link."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field


@dataclass(slots=True)
class LinkStats:
    """Totals since the client was created.

    Attributes:
        connects: number of times that the link became ready.
        rx: valid frames received.
        tx: frames sent.
        bad_frames: frames that could not be read or used, by kind of defect.
        dropped_pushes: pushes that were dropped because newer ones came, by message type.
        refused_requests: requests that were not sent because too many were in flight, by message
            type.
        timeouts: requests that were not answered in time, by message type.
        late_answers: answers to requests that were no longer pending.
        round_trip: round-trip time of the last answered request or ping, in seconds; None before
            the first.
        clock_offset: time by which the chassis's clock is ahead of this computer's, in seconds; too
            small by the transit time of the last frame. None if the chassis sends no times.
    """

    connects: int = 0
    rx: int = 0
    tx: int = 0
    bad_frames: Counter[str] = field(default_factory=Counter)
    dropped_pushes: Counter[str] = field(default_factory=Counter)
    refused_requests: Counter[str] = field(default_factory=Counter)
    timeouts: Counter[str] = field(default_factory=Counter)
    late_answers: int = 0
    round_trip: float | None = None
    clock_offset: float | None = None
