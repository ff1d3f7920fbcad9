"""Hands what the layers below ROS log to the logger of the node that it is about.

Several agents can share a process. What works for one of them runs in a context (`contextvars`)
that knows its logger: in the link's thread tasks and callbacks inherit it, and in the executor's
thread each callback that may log begins with `speak_as`.
"""

from __future__ import annotations

import contextvars
import logging
from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.logging import LoggingSeverity, get_logger

from woosh_robot_agent.link.log_once import one_line

_LONGEST = 2000
"""Characters of a message, tracebacks apart."""
_PACKAGE = "woosh_robot_agent"

_SEVERITIES = (
    (logging.ERROR, LoggingSeverity.ERROR),
    (logging.WARNING, LoggingSeverity.WARN),
    (logging.INFO, LoggingSeverity.INFO),
)

_FORMATTER = logging.Formatter()
_SPEAKER = contextvars.ContextVar[Any]("speaker", default=None)


_CLOSING: set[str] = set()
"""Names of the loggers of the nodes that are closing."""


def expect_losses(logger: Any, *, expected: bool) -> None:
    """Log the warnings of a node at INFO while it closes: it may lose its chassis on the way.

    Args:
        logger: logger of the node.
        expected: True when the node begins to close, False when it is closed.
    """
    (_CLOSING.add if expected else _CLOSING.discard)(logger.name)


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
            text = one_line(record.getMessage(), _LONGEST)
            if record.exc_info:
                text += "\n" + _FORMATTER.formatException(record.exc_info)
            logger = _SPEAKER.get() or get_logger(_PACKAGE)
            _say(logger.name, record, text)
        except Exception:
            self.handleError(record)


def _say(name: str, record: logging.LogRecord, text: str) -> None:
    """Log as rclpy's logger does, with the place in the source where it was logged.

    rclpy would look for that place, find the handler here, and take 60 ms for its first line.
    """
    severity = _severity(record.levelno)
    if severity is LoggingSeverity.WARN and name in _CLOSING:
        severity = LoggingSeverity.INFO
    if _rclpy.rclpy_logging_logger_is_enabled_for(name, severity):
        place = record.funcName or "", record.pathname, record.lineno
        _rclpy.rclpy_logging_rcutils_log(severity, name, text, *place)


def _severity(level: int) -> LoggingSeverity:
    """ROS's severity for one of `logging`."""
    return next((s for least, s in _SEVERITIES if level >= least), LoggingSeverity.DEBUG)


_HANDLER = RosLogHandler()


def log_to_ros() -> None:
    """Have all that the package logs go to ROS, once, however often this is called."""
    logger = logging.getLogger(_PACKAGE)
    logger.addHandler(_HANDLER)
    logger.setLevel(logging.DEBUG)
    logger.propagate = False
