"""Log records in the ROS log, and their format.

fleet/test_fleet.py has the loggers of several robots.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from typing import Any

import pytest
from rclpy.logging import LoggingSeverity, get_logger

from woosh_robot_agent.ros import rclpy_private
from woosh_robot_agent.ros.logs import RosLogHandler, context_of, log_to_ros


@pytest.fixture
def lines(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Logged lines: severity, name of the logger, text, and source location."""
    logged: list[Any] = []

    def note(severity: Any, name: str, text: str, *place: Any) -> None:
        logged.append((severity.name, name, text, place))

    monkeypatch.setattr(rclpy_private._rclpy, "rclpy_logging_rcutils_log", note)
    return logged


@pytest.fixture
def logger() -> Iterator[logging.Logger]:
    """A logger whose records go to ROS only."""
    found = logging.getLogger("a test of logs")
    handler = RosLogHandler()
    found.propagate = False
    found.addHandler(handler)
    yield found
    found.removeHandler(handler)


def say(logger: logging.Logger) -> None:
    logger.warning("the chassis said %s", "a\n\x1b[31mb")
    logger.error("x" * 3000)
    try:
        raise ZeroDivisionError("once")
    except ZeroDivisionError:
        logger.exception("failed")


def test_a_message_is_one_line_of_bounded_length_and_a_traceback_is_whole(
    lines: list[Any], logger: logging.Logger
) -> None:
    context_of(get_logger("one")).run(say, logger)
    assert lines[0][:3] == ("WARN", "one", "the chassis said a\\n\\x1b[31mb")
    assert lines[1][:3] == ("ERROR", "one", "x" * 2000 + "... (3000 characters)")
    severity, _, text, _ = lines[2]
    assert severity == "ERROR"
    assert text.startswith("failed\nTraceback (most recent call last):\n")
    assert text.endswith("ZeroDivisionError: once")


def test_a_line_says_where_in_the_source_it_comes_from(
    lines: list[Any], logger: logging.Logger
) -> None:
    context_of(get_logger("one")).run(say, logger)
    function, path, line = lines[0][3]
    assert (function, path) == ("say", __file__)
    assert line == say.__code__.co_firstlineno + 1


def test_what_is_below_the_loggers_level_is_left_out(lines: list[Any]) -> None:
    log_to_ros()
    quiet = get_logger("quiet")
    quiet.set_level(LoggingSeverity.WARN)
    logger = logging.getLogger("woosh_robot_agent.a_test")
    for level in (logging.DEBUG, logging.INFO, logging.WARNING, logging.CRITICAL):
        context_of(quiet).run(logger.log, level, "x")
    assert [line[0] for line in lines] == ["WARN", "ERROR"]
