"""Logging without repetition: the first of a kind at WARNING, repeats at DEBUG."""

from __future__ import annotations

import logging

from woosh_robot_agent.recent_dict import RecentDict

_MAX_KINDS = 200
"""Maximum number of kinds that are remembered, since the texts of errors can vary without end."""
_LONGEST_KIND = 200
"""Maximum length of the name of a kind, in characters; the rest is cut off."""
_LONGEST_LINE = 1000
"""Maximum length of a logged line, in characters; the rest is cut off."""


def one_line(text: str, limit: int = 500) -> str:
    """Return a text as one line for a log, with control characters escaped.

    Args:
        text: any text, possibly from the chassis.
        limit: maximum length in characters; the rest is cut off.
    """
    cut = text[:limit]
    if not cut.isprintable():
        cut = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in cut)
    return cut if len(text) <= limit else f"{cut}... ({len(text)} characters)"


class LogOnce:
    """Logs each kind of problem once, until it is cleared.

    Args:
        logger: the logger to use.
    """

    def __init__(self, logger: logging.Logger) -> None:
        self._logger = logger
        self._logged: RecentDict[str, None] = RecentDict(_MAX_KINDS)
        """The kinds of problems that were logged."""

    def warn(self, kind: str, text: str) -> None:
        """Log `text`, at WARNING if this kind was not logged since it was last cleared."""
        kind = kind[:_LONGEST_KIND]
        repeated = kind in self._logged
        if not repeated:
            self._logged[kind] = None
        self._logger.log(
            logging.DEBUG if repeated else logging.WARNING, "%s", one_line(text, _LONGEST_LINE)
        )

    def clear(self, kind: str | None = None) -> None:
        """Forget one kind of problem, or all of them, so that it is logged again."""
        if kind is None:
            self._logged.clear()
        else:
            self._logged.pop(kind[:_LONGEST_KIND], None)
