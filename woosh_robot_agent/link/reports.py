"""Counters and log helpers of the link, e.g. to log each problem once."""

from __future__ import annotations

import logging
import math
import os
import time
from collections import Counter, OrderedDict
from dataclasses import dataclass, field
from types import TracebackType
from typing import TypeVar

from woosh_robot_agent.sentences import said_by

K = TypeVar("K")
V = TypeVar("V")


def system_text(error: OSError) -> str:
    """Return the operating system's text for an error, without the text that asyncio adds."""
    if error.errno and error.errno > 0:  # negative: a host name that cannot be resolved
        return os.strerror(error.errno)
    return error.strerror or said_by(error) or type(error).__name__


class RecentDict(OrderedDict[K, V]):
    """A dictionary that holds only the entries that were set last, the oldest first."""

    def __init__(self, limit: int) -> None:
        super().__init__()
        self._limit = limit

    def __setitem__(self, key: K, value: V) -> None:
        """Set an entry, and remove the oldest one if there are too many."""
        super().__setitem__(key, value)
        self.move_to_end(key)
        if len(self) > self._limit:
            self.popitem(last=False)


@dataclass(slots=True)
class LinkStats:
    """Totals since the client was created, and the last measurements.

    Attributes:
        connects: number of times that the link became ready.
        rx: valid frames received.
        tx: frames sent.
        bad_frames: frames that could not be read or used, by kind of defect.
        dropped_pushes: pushes that were dropped because newer ones came, by message type.
        refused_requests: requests that were not sent because too many were in flight, by message
            type.
        timeouts: requests that were not answered in time, by message type.
        late_answers: answers whose requests were no longer pending.
        round_trip: round-trip time of the last answered request or ping, in seconds; None before
            the first.
        clock_offset: time by which the chassis's clock is ahead of this computer's, in seconds; too
            small by the transit time of the last frame, large ones excepted. None if no such frame
            of the connection has had a time.
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


_ExceptionInfo = (
    tuple[type[BaseException], BaseException, TracebackType | None] | tuple[None, None, None]
)
_MAX_KINDS = 200
"""Maximum number of kinds that `LogOnce` remembers: kinds contain error texts, which may vary."""
_LONGEST_KIND = 200
"""Maximum length of the name of a kind, in characters; the rest is cut off."""
_LONGEST_LINE = 1000
"""Maximum length of a logged line, in characters; the rest is cut off."""


def printable(text: str) -> str:
    """Return a text with each character escaped that could control a terminal or mislead a reader.

    These are line breaks and other control characters, characters that change the direction of
    writing, and invisible characters.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def one_line(text: str, limit: int = 500) -> str:
    """Return a text as one line for a log, with control characters escaped.

    Args:
        text: any text, possibly from the chassis.
        limit: maximum length in characters; the rest is cut off.
    """
    cut = printable(text[:limit])
    return cut if len(text) <= limit else f"{cut}... ({len(text)} characters)"


class PrintableFormatter(logging.Formatter):
    """Formats each record as one line without control characters; a traceback keeps its lines."""

    def format(self, record: logging.LogRecord) -> str:
        record.exc_text = None  # another formatter may have cached it unescaped
        return super().format(record)

    def formatMessage(self, record: logging.LogRecord) -> str:
        return printable(super().formatMessage(record))

    def formatException(self, ei: _ExceptionInfo) -> str:
        return "\n".join(map(printable, super().formatException(ei).split("\n")))


def log_to_stderr(level: int, record_format: str, *filters: logging.Filter) -> None:
    """Make a program log to stderr, from a level on; each record passes the filters."""
    handler = logging.StreamHandler()
    handler.setFormatter(PrintableFormatter(record_format))
    for each in filters:
        handler.addFilter(each)
    logging.basicConfig(level=level, handlers=[handler])


QUIET = 600.0
"""Time without a problem after which it is logged again, in seconds."""
DROPS_QUIET = 3.0
"""The same for pushes and commands that are dropped, whose totals are in counters."""


class LogOnce:
    """Logs each kind of problem once, until it is cleared, or has not occurred for a while.

    Args:
        quiet: that while, in seconds.
    """

    def __init__(self, logger: logging.Logger, quiet: float = QUIET) -> None:
        self._logger = logger
        self._quiet = quiet
        self._latest: RecentDict[str, float] = RecentDict(_MAX_KINDS)
        """Monotonic time of the latest problem of each kind that was not cleared since."""

    def warn(self, kind: str, text: str, level: int = logging.WARNING) -> None:
        """Log `text` at a level; at DEBUG if a problem of its kind has just been logged."""
        kind, now = kind[:_LONGEST_KIND], time.monotonic()
        if now - self._latest.get(kind, -math.inf) <= self._quiet:
            level = logging.DEBUG
        self._latest[kind] = now
        # the place in the log is that of the caller
        self._logger.log(level, "%s", one_line(text, _LONGEST_LINE), stacklevel=2)

    def clear(self, kind: str | None = None) -> None:
        """Forget one kind of problem, or all of them, so that it is logged again."""
        if kind is None:
            self._latest.clear()
        else:
            self._latest.pop(kind[:_LONGEST_KIND], None)


class LinkRecord:
    """Counters and logs of one link.

    Attributes:
        stats: counters.
        log: log of problems that repeat.
        drops: log of dropped pushes and refused requests.
    """

    def __init__(self, logger: logging.Logger) -> None:
        self.stats = LinkStats()
        self.log = LogOnce(logger)
        self.drops = LogOnce(logger, DROPS_QUIET)
