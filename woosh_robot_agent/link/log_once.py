"""Logging that says a thing once: the first of a kind at WARNING, repeats at DEBUG."""

from __future__ import annotations

import logging

_KINDS = 200
"""Kinds that are remembered at most; the texts of other people's errors can be without number."""
_LONGEST_KIND = 200
_LONGEST_LINE = 1000


def shown(text: str, limit: int = 500) -> str:
    """A text as it may stand in a log: one line, without control characters, of bounded length.

    Args:
        text: any text, of the chassis perhaps.
        limit: characters of it at most.
    """
    cut = text[:limit]
    if not cut.isprintable():
        cut = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in cut)
    return cut if len(text) <= limit else f"{cut}... ({len(text)} characters)"


class LogOnce:
    """Remembers which kinds of trouble were told, until they are over."""

    def __init__(self, logger: logging.Logger) -> None:
        self._logger = logger
        self._told: dict[str, None] = {}

    def warn(self, kind: str, text: str) -> None:
        """Log `text`; at WARNING if nothing of this kind was told since it was last cleared."""
        kind = kind[:_LONGEST_KIND]
        told = kind in self._told
        if not told:
            if len(self._told) >= _KINDS:
                del self._told[next(iter(self._told))]
            self._told[kind] = None
        self._logger.log(
            logging.DEBUG if told else logging.WARNING, "%s", shown(text, _LONGEST_LINE)
        )

    def clear(self, kind: str | None = None) -> None:
        """The trouble is over: all of it, or the one kind."""
        if kind is None:
            self._told.clear()
        else:
            self._told.pop(kind[:_LONGEST_KIND], None)
