"""Start tools as programs, and judge what they print."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from tests.asynchronous import TIMEOUT
from woosh_robot_agent.simulator import SimulatorThread

HOSTILE = "\x1b]0;owned\x07 \x9b31m \u202e gnp \u2028 \r\nok    taskable"
"""Text that sets a terminal's title, rings, colours, runs backwards and makes lines of its own."""


@contextmanager
def start(tool: str, *arguments: str, **streams: Any) -> Iterator[Any]:
    """Start a program; yield its process, which is killed at the end."""
    with subprocess.Popen(
        [sys.executable, "-m", "woosh_robot_agent.tools", tool, *arguments],
        **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **streams},
        text=True,
        # as in a terminal: tests that run in the background pass on which signals are ignored
        preexec_fn=lambda: [
            signal.signal(number, signal.SIG_DFL) for number in (signal.SIGINT, signal.SIGHUP)
        ],
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def end(process: Any, number: signal.Signals | None = signal.SIGINT) -> tuple[int, str, str]:
    """End a program by a signal, or wait for its end; return exit status, stdout and stderr."""
    if number is not None:
        process.send_signal(number)
    out, err = process.communicate(timeout=2 * TIMEOUT)
    return process.returncode, out, err


def run(tool: str, *arguments: str) -> tuple[int, str, str]:
    with start(tool, *arguments) as process:
        return end(process, None)


def address(chassis: SimulatorThread) -> list[str]:
    return ["--ip", f"127.0.0.1:{chassis.port}"]


def harmless(text: str) -> bool:
    return all(character.isprintable() or character == "\n" for character in text)
