"""The programs that flood the agent with calls."""

from __future__ import annotations

import contextlib
import json
import subprocess
from collections.abc import Iterator
from typing import Any

from benchmarks.processes import start_module

CALLERS = 2
"""Number of calling processes, because one Python process does not reach the rate."""


@contextlib.contextmanager
def calling_programs(domain: int, rate: float, seconds: float) -> Iterator[list[Any]]:
    """Run the calling programs; the yielded list contains their reports after the block."""
    arguments = (str(rate / CALLERS), str(seconds))
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with contextlib.ExitStack() as stack:
        callers = []
        for _ in range(CALLERS):
            caller = start_module(
                "benchmarks.programs.flood_caller", *arguments, domain=domain, **pipes
            )
            stack.callback(_kill, caller)
            callers.append(caller)
        for caller in callers:
            assert caller.stdout.readline().strip() == "ready"
        for caller in callers:
            caller.stdin.write("go\n")
            caller.stdin.flush()
        reports: list[Any] = []
        yield reports
        reports += [json.loads(caller.stdout.readline()) for caller in callers]


def _kill(process: subprocess.Popen[str]) -> None:
    process.kill()
    process.wait()
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.close()
    process.stdout.close()
