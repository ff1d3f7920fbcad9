"""Tells of what is dropped: once when it begins, and once, with the number, when it is over."""

from __future__ import annotations

import asyncio
import logging
from dataclasses import dataclass

QUIET = 3.0
"""s without a loss of the kind after which it is over."""


@dataclass(slots=True)
class _Spell:
    """Losses of one kind without a longer pause.

    Attributes:
        since: loop time of the first.
        last: loop time of the last so far.
        count: how many.
        timer: ends the spell.
    """

    since: float
    last: float
    count: int
    timer: asyncio.TimerHandle


class Losses:
    """Remembers what is being dropped now; used in the event loop.

    Args:
        logger: gets the first loss of a spell at WARNING, its number at INFO when it is over.
    """

    def __init__(self, logger: logging.Logger) -> None:
        self._logger = logger
        self._spells: dict[str, _Spell] = {}

    def count(self, kind: str, text: str) -> None:
        """One more was dropped.

        Args:
            kind: what was dropped, in words that a number can stand before.
            text: why, and what to do; told if this is the first in a while.
        """
        loop = asyncio.get_running_loop()
        now = loop.time()
        spell = self._spells.get(kind)
        if spell is None:
            self._logger.warning("%s", text)
            timer = loop.call_at(now + QUIET, self._look, kind)
            self._spells[kind] = _Spell(now, now, 1, timer)
        else:
            spell.last = now
            spell.count += 1

    def finish(self) -> None:
        """Tell the numbers now; nothing more will come."""
        for kind in tuple(self._spells):
            self._end(kind)

    def _look(self, kind: str) -> None:
        spell = self._spells[kind]
        loop = asyncio.get_running_loop()
        if loop.time() < spell.last + QUIET:
            spell.timer = loop.call_at(spell.last + QUIET, self._look, kind)
        else:
            self._end(kind)

    def _end(self, kind: str) -> None:
        spell = self._spells.pop(kind)
        spell.timer.cancel()
        self._logger.info(
            "%d %s in %.1f s; that is over", spell.count, kind, spell.last - spell.since
        )
