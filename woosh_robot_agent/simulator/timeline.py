"""Simulated time: the clock, calls that are due later, and messages to push."""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Callable
from typing import TypeVar

from google.protobuf.message import Message

_M = TypeVar("_M", bound=Message)

ROUNDING = 1e-9
"""Tolerance of comparisons between sums of time steps, in seconds."""

Call = Callable[[], object]
"""A call that is due at some time."""


def copy_of(message: _M) -> _M:
    """Return a copy of a message, which later changes do not affect."""
    copy = type(message)()
    copy.CopyFrom(message)
    return copy


_LATEST = 2.0**31 - 1
"""The last Unix time that the fields of a record can hold, in seconds: 19 January 2038."""


class Timeline:
    """The clock of the robot, the scheduled calls, and the emitted messages.

    Args:
        start_time: Unix time of the start, in seconds, by a clock without `clock_offset`.

    Attributes:
        robot_id: number of the robot.
        clock_offset: time by which the clock of the robot is ahead, in seconds; negative: behind.
        elapsed: simulated time since the start, in seconds.
        stepped: simulated time up to which the motion is computed, in seconds.
        on_schedule: called for each call that is scheduled, with the simulated time of that call.
        on_change: called after each scheduled call, which may have changed something.
    """

    def __init__(self, robot_id: int, start_time: float, clock_offset: float) -> None:
        self.robot_id = robot_id
        self.clock_offset = clock_offset
        self.elapsed = 0.0
        self.stepped = 0.0
        self.on_schedule: Callable[[float], object] = lambda time: None
        self.on_change: Call = lambda: None
        self._start_time = start_time
        self._calls: list[tuple[float, int, Call]] = []
        """Scheduled calls, as a heap: simulated time, number for the order of equal times, call."""
        self._numbers = itertools.count()
        self._events: list[Message] = []
        """Messages for the next `take_events`, in order."""

    @property
    def time(self) -> float:
        """Clock of the robot: simulated Unix time, in seconds. It stops at `_LATEST`."""
        return min(self._start_time + self.clock_offset + self.elapsed, _LATEST)

    @property
    def next_call(self) -> float:
        """Simulated time at which the next call is due, infinite if there is none."""
        return self._calls[0][0] if self._calls else math.inf

    def after(self, delay: float, call: Call) -> None:
        """Schedule a call in `delay` seconds of simulated time; call at once unless `delay` > 0."""
        if delay <= 0.0:
            call()
            return
        time = self.elapsed + delay
        heapq.heappush(self._calls, (time, next(self._numbers), call))
        self.on_schedule(time)

    def run_until(self, time: float) -> None:
        """Advance the simulated time to `time`, and make the calls that are due by then."""
        while self.next_call <= time:
            self.elapsed = max(self.elapsed, self.next_call)
            heapq.heappop(self._calls)[2]()
            self.on_change()
        self.elapsed = max(self.elapsed, time)

    def emit(self, event: Message) -> None:
        """Queue a message for its subscribers. It must not be modified afterwards."""
        self._events.append(event)

    def take_events(self) -> list[Message]:
        """Return the messages that were emitted since `take_events` was last called, in order."""
        events, self._events = self._events, []
        return events


class DelayedCalls:
    """Calls that are due later and can be cancelled together."""

    def __init__(self, timeline: Timeline) -> None:
        self._timeline = timeline
        self._cancellations = 0
        """Number of calls of `cancel_all`. A scheduled call is skipped if it has changed since."""

    def add(self, delay: float, call: Call) -> None:
        """Schedule a call in `delay` seconds of simulated time; `cancel_all` cancels it.

        Call at once unless `delay` > 0.
        """
        cancellations = self._cancellations

        def call_unless_cancelled() -> None:
            if self._cancellations == cancellations:
                call()

        self._timeline.after(delay, call_unless_cancelled)

    def cancel_all(self) -> None:
        """Cancel the calls that are not yet due."""
        self._cancellations += 1
