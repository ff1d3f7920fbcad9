"""Texts from others in logs and on terminals: without control characters, and not repeated."""

from __future__ import annotations

import logging
from types import TracebackType

from woosh_robot_agent.recent_dict import RecentDict

_ExceptionInfo = (
    tuple[type[BaseException], BaseException, TracebackType | None] | tuple[None, None, None]
)
_MAX_KINDS = 200
"""Maximum number of kinds that are remembered, since the texts of errors can vary without end."""
_LONGEST_KIND = 200
"""Maximum length of the name of a kind, in characters; the rest is cut off."""
_LONGEST_LINE = 1000
"""Maximum length of a logged line, in characters; the rest is cut off."""


def printable(text: str) -> str:
    """Return a text with each character escaped that could control a terminal or mislead a reader.

    These are line breaks and other control characters, those that change the direction of writing,
    and invisible ones.
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
        record.exc_text = None  # another formatter may have cached it as it is
        return super().format(record)

    def formatMessage(self, record: logging.LogRecord) -> str:
        return printable(super().formatMessage(record))

    def formatException(self, ei: _ExceptionInfo) -> str:
        return "\n".join(map(printable, super().formatException(ei).split("\n")))


def log_to_stderr(level: int, form: str, *filters: logging.Filter) -> None:
    """Make a program log to stderr.

    Args:
        level: lowest level that is logged.
        form: format of a record.
        filters: filters that each record passes.
    """
    handler = logging.StreamHandler()
    handler.setFormatter(PrintableFormatter(form))
    for each in filters:
        handler.addFilter(each)
    logging.basicConfig(level=level, handlers=[handler])


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
