"""What reaches the node's log, and in what shape."""

from __future__ import annotations

import logging

from woosh_robot_agent.logs import RosLogHandler


class Lines:
    """In the place of rclpy's logger, which writes to the process's stderr."""

    def __init__(self) -> None:
        self.lines: list[tuple[str, str]] = []

    def __getattr__(self, severity: str) -> object:
        return lambda text: self.lines.append((severity, text))


def test_a_message_is_one_line_of_bounded_length_and_a_traceback_is_whole() -> None:
    lines = Lines()
    logger = logging.getLogger("a test of logs")
    logger.propagate = False
    logger.addHandler(RosLogHandler(lines))
    logger.warning("the chassis said %s", "a\n\x1b[31mb")
    logger.error("x" * 3000)
    try:
        raise ZeroDivisionError("once")
    except ZeroDivisionError:
        logger.exception("failed")
    assert lines.lines[0] == ("warning", "the chassis said a\\n\\x1b[31mb")
    assert lines.lines[1] == ("error", "x" * 2000 + "... (3000 characters)")
    severity, text = lines.lines[2]
    assert severity == "error"
    assert text.startswith("failed\nTraceback (most recent call last):\n")
    assert text.endswith("ZeroDivisionError: once")
