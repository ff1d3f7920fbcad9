"""Logging to ROS: records of `logging` go to the logger of the node that they concern.

Several agents can share a process. Work for one of them runs in a context (`contextvars`) that
holds the logger of its node: asyncio tasks and callbacks of the link thread inherit the context;
callbacks in the executor thread begin with `log_as`.
"""

from __future__ import annotations

import contextvars
import logging
import os
import sys
import tempfile
from collections.abc import Sequence
from typing import Any

from rclpy.logging import LoggingSeverity, get_logger

from woosh_robot_agent.link.reports import one_line
from woosh_robot_agent.ros import rclpy_private

_MAX_LENGTH = 2000
"""Maximum length of a message without its traceback, in characters."""
_PACKAGE = "woosh_robot_agent"
"""Name of the package's root logger, in `logging` and in ROS."""

_FORMATTER = logging.Formatter()
_NODE_LOGGER = contextvars.ContextVar[Any]("node_logger", default=None)
_NO_LOG_FILES = "--disable-external-lib-logs"
"""ROS argument with which rclpy writes no log files."""

_CLOSING: set[str] = set()
"""Names of the loggers of the nodes that are closing."""


def set_closing(logger: Any, *, closing: bool) -> None:
    """Log a node's warnings at INFO while the node closes, because a lost link is expected then.

    Args:
        closing: True when the node begins to close, False when it is closed.
    """
    if closing:
        _CLOSING.add(logger.name)
    else:
        _CLOSING.discard(logger.name)


def log_as(logger: Any) -> None:
    """Send the log records of this context to a node's logger, or to the package's if None."""
    _NODE_LOGGER.set(logger)


def context_of(logger: Any) -> contextvars.Context:
    """Return a new context whose log records go to a node's logger."""
    context = contextvars.copy_context()
    context.run(log_as, logger)
    return context


class RosLogHandler(logging.Handler):
    """Handler that passes records to the ROS logger of the current context."""

    def emit(self, record: logging.LogRecord) -> None:
        try:
            text = one_line(record.getMessage(), _MAX_LENGTH)
            if record.exc_info:
                text += "\n" + _FORMATTER.formatException(record.exc_info)
            logger = _NODE_LOGGER.get() or get_logger(_PACKAGE)
            place = record.funcName or "", record.pathname, record.lineno
            level = min(record.levelno, logging.ERROR) // 10 * 10
            severity = LoggingSeverity(level)  # ROS numbers the levels like logging
            if severity is LoggingSeverity.WARN and logger.name in _CLOSING:
                severity = LoggingSeverity.INFO
            rclpy_private.log(logger.name, severity, text, *place)
        except Exception:
            self.handleError(record)


_HANDLER = RosLogHandler()


def init_arguments(arguments: Sequence[str]) -> list[str]:
    """Return arguments for `rclpy.init` that turn log files off if their folder is not writable.

    rclpy does not start if it cannot write them. A warning on stderr tells the reason.
    """
    if _NO_LOG_FILES in arguments:
        return list(arguments)
    folder = os.environ.get("ROS_LOG_DIR") or os.path.join(
        os.environ.get("ROS_HOME") or "~/.ros", "log"
    )
    try:
        if folder.startswith("~"):
            if not (home := os.environ.get("HOME")):
                raise OSError("HOME is not set")
            folder = home + folder[1:]
        os.makedirs(folder, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        print(
            f"warning: no log file is written: cannot write to {folder}: "
            f"{error.strerror or error}; set ROS_LOG_DIR to another folder",
            file=sys.stderr,
        )
        return [*arguments, "--ros-args", _NO_LOG_FILES]
    return list(arguments)


def log_to_ros() -> None:
    """Send all records of the package to ROS. Idempotent."""
    logger = logging.getLogger(_PACKAGE)
    logger.addHandler(_HANDLER)
    logger.setLevel(logging.DEBUG)
    logger.propagate = False
