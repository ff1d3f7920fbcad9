"""Hands what the layers below ROS log to the node's logger."""

from __future__ import annotations

import logging
from typing import Any

from woosh_robot_agent.link.once import shown

_LONGEST = 2000
"""Characters of a message, tracebacks apart."""


_FORMATTER = logging.Formatter()


class RosLogHandler(logging.Handler):
    """A handler that logs by a node's logger. Its own mistakes go to stderr, as logging does."""

    def __init__(self, logger: Any) -> None:
        super().__init__()
        self._logger = logger

    def emit(self, record: logging.LogRecord) -> None:
        """Log one record."""
        try:
            text = shown(record.getMessage(), _LONGEST)
            if record.exc_info:
                text += "\n" + _FORMATTER.formatException(record.exc_info)
            # one line of code for each severity: rclpy does not let a line change its severity
            if record.levelno >= logging.ERROR:
                self._logger.error(text)
            elif record.levelno >= logging.WARNING:
                self._logger.warning(text)
            elif record.levelno >= logging.INFO:
                self._logger.info(text)
            else:
                self._logger.debug(text)
        except Exception:
            self.handleError(record)
