"""Hands what the layers below ROS log to the logger of the node that it is about.

Several agents can share a process. What works for one of them runs in a context (`contextvars`)
that knows its logger: in the link's thread tasks and callbacks inherit it, and in the executor's
thread each callback that may log begins with `speak_as`.
"""

from __future__ import annotations

import contextvars
import logging
from typing import Any

from rclpy.logging import get_logger

from woosh_robot_agent.link.once import shown

_LONGEST = 2000
"""Characters of a message, tracebacks apart."""
_PACKAGE = "woosh_robot_agent"

_FORMATTER = logging.Formatter()
_SPEAKER = contextvars.ContextVar[Any]("speaker", default=None)


def speak_as(logger: Any) -> None:
    """Have what this context logs from now on go to a node's logger; None: to the program's."""
    _SPEAKER.set(logger)


def context_of(logger: Any) -> contextvars.Context:
    """A new context, in which what is logged goes to a node's logger."""
    context = contextvars.copy_context()
    context.run(speak_as, logger)
    return context


class RosLogHandler(logging.Handler):
    """Logs by the logger of the node that speaks; mistakes of its own go to stderr."""

    def emit(self, record: logging.LogRecord) -> None:
        """Log one record."""
        try:
            text = shown(record.getMessage(), _LONGEST)
            if record.exc_info:
                text += "\n" + _FORMATTER.formatException(record.exc_info)
            logger = _SPEAKER.get() or get_logger(_PACKAGE)
            # one line of code for each severity: rclpy does not let a line change its severity
            if record.levelno >= logging.ERROR:
                logger.error(text)
            elif record.levelno >= logging.WARNING:
                logger.warning(text)
            elif record.levelno >= logging.INFO:
                logger.info(text)
            else:
                logger.debug(text)
        except Exception:
            self.handleError(record)


_HANDLER = RosLogHandler()


def log_to_ros() -> None:
    """Have all that the package logs go to ROS, once, however often this is called."""
    logger = logging.getLogger(_PACKAGE)
    logger.addHandler(_HANDLER)
    logger.setLevel(logging.DEBUG)
    logger.propagate = False
