"""What reaches the node's log, and in what shape."""

from __future__ import annotations

import logging

from woosh_robot_agent.logs import RosLogHandler, context_of, log_to_ros, speak_as


class Lines:
    """In the place of rclpy's logger, which writes to the process's stderr."""

    def __init__(self) -> None:
        self.lines: list[tuple[str, str]] = []

    def __getattr__(self, severity: str) -> object:
        return lambda text: self.lines.append((severity, text))


def say(logger: logging.Logger) -> None:
    logger.warning("the chassis said %s", "a\n\x1b[31mb")
    logger.error("x" * 3000)
    try:
        raise ZeroDivisionError("once")
    except ZeroDivisionError:
        logger.exception("failed")


def test_a_message_is_one_line_of_bounded_length_and_a_traceback_is_whole() -> None:
    lines = Lines()
    logger = logging.getLogger("a test of logs")
    logger.propagate = False
    logger.addHandler(RosLogHandler())
    context_of(lines).run(say, logger)
    assert lines.lines[0] == ("warning", "the chassis said a\\n\\x1b[31mb")
    assert lines.lines[1] == ("error", "x" * 2000 + "... (3000 characters)")
    severity, text = lines.lines[2]
    assert severity == "error"
    assert text.startswith("failed\nTraceback (most recent call last):\n")
    assert text.endswith("ZeroDivisionError: once")


def test_each_context_has_its_speaker_and_a_line_comes_once() -> None:
    log_to_ros()
    log_to_ros()
    logger = logging.getLogger("woosh_robot_agent.a_test")
    one, other = Lines(), Lines()
    context = context_of(one)
    context.run(logger.info, "1")
    context_of(other).run(logger.info, "2")
    context.run(speak_as, other)
    context.run(logger.info, "3")
    assert one.lines == [("info", "1")]
    assert other.lines == [("info", "2"), ("info", "3")]
