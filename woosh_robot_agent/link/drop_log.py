"""Logging of drops: a warning when a series of them begins, and their number when it has ended."""

from __future__ import annotations

import asyncio
import logging
from dataclasses import dataclass

QUIET = 3.0
"""Time without a drop of the same kind after which a series has ended, in seconds."""


@dataclass(slots=True)
class _Series:
    """Drops of one kind that follow each other closely.

    Attributes:
        first: loop time of the first drop.
        last: loop time of the latest drop.
        count: number of drops.
        timer: checks whether the series has ended.
    """

    first: float
    last: float
    count: int
    timer: asyncio.TimerHandle


class DropLog:
    """Logs series of drops. Use it in the event loop.

    Args:
        logger: gets the first drop of a series at WARNING, and their number at INFO.
    """

    def __init__(self, logger: logging.Logger) -> None:
        self._logger = logger
        self._series: dict[str, _Series] = {}
        """Series that have not ended, by kind."""

    def count(self, kind: str, text: str) -> None:
        """Count one drop.

        Args:
            kind: what was dropped, as words that can follow a number: "requests were refused".
            text: why it was dropped and what to do; logged for the first drop of a series.
        """
        loop = asyncio.get_running_loop()
        now = loop.time()
        series = self._series.get(kind)
        if series is None:
            self._logger.warning("%s", text)
            timer = loop.call_at(now + QUIET, self._check, kind)
            self._series[kind] = _Series(now, now, 1, timer)
        else:
            series.last = now
            series.count += 1

    def finish(self) -> None:
        """End all series now and log their numbers."""
        for kind in tuple(self._series):
            self._end(kind)

    def _check(self, kind: str) -> None:
        series = self._series[kind]
        loop = asyncio.get_running_loop()
        if loop.time() < series.last + QUIET:
            series.timer = loop.call_at(series.last + QUIET, self._check, kind)
        else:
            self._end(kind)

    def _end(self, kind: str) -> None:
        series = self._series.pop(kind)
        series.timer.cancel()
        self._logger.info(
            "%d %s within %.1f s; none since then", series.count, kind, series.last - series.first
        )
