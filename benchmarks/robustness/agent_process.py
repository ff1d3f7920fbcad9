"""The agent in a process of its own, whose resources and debug state can be read."""

from __future__ import annotations

import contextlib
import json
import queue
import subprocess
import threading
import time
from collections.abc import Iterator
from typing import Any

from benchmarks.processes import ROOT, Resources, resources, rss
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.testing import AgentProcess, wait_until

_ANSWER_TIMEOUT = 120.0
"""Timeout for the debug state of an agent under load, in seconds."""


class DebugAgentProcess(AgentProcess):
    """The program `benchmarks.robustness.debug_agent`. It takes the arguments of its base class."""

    module = "benchmarks.robustness.debug_agent"
    popen_options = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "cwd": ROOT}

    def __init__(self, domain: int, **parameters: Any) -> None:
        super().__init__(domain, **parameters)
        self._answers: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._answer_reader = threading.Thread(target=self._read_answers, daemon=True)
        self._answer_reader.start()

    def close(self) -> None:
        super().close()
        self._answer_reader.join()
        for pipe in (self.process.stdin, self.process.stdout):
            assert pipe is not None
            pipe.close()

    @property
    def rss(self) -> int:
        """Resident memory, in bytes."""
        return rss(self.process.pid)

    def resources(self) -> Resources:
        """Return the resources that the process holds."""
        return resources(self.process.pid)

    def debug(self) -> dict[str, Any]:
        """Return the result of the agent's `Agent.debug`."""
        assert self.process.stdin is not None
        self.process.stdin.write("state\n")
        self.process.stdin.flush()
        try:
            state: dict[str, Any] = json.loads(self._answers.get(timeout=_ANSWER_TIMEOUT))
        except queue.Empty:
            raise AssertionError(f"the agent does not answer. Its log:\n{self.output}") from None
        return state

    def held(self) -> dict[str, int]:
        """Return the counts of everything in the agent that must not grow with time."""
        state, process = self.debug(), self.resources()
        return {
            "tasks": len(state["tasks"]),
            "requests": state["requests"],
            "pushes": state["pushes"],
            "goals": state["goals"],
            "fds": process.fds,
            "sockets": process.sockets,
            "threads": process.threads,
        }

    def settled_rss(self, limit: float, timeout: float) -> int:
        """Wait until the resident memory is within `limit`, or the timeout is over; return it.

        Args:
            limit: memory in bytes.
            timeout: timeout in seconds.
        """
        deadline = time.monotonic() + timeout
        while (now := self.rss) > limit and time.monotonic() < deadline:
            threading.Event().wait(0.2)
        return now

    @contextlib.contextmanager
    def watch_rss(self) -> Iterator[list[int]]:
        """Sample the resident memory, in bytes, during the block."""
        samples = [self.rss]
        stop = threading.Event()

        def watch() -> None:
            while not stop.wait(0.1):
                samples.append(self.rss)

        watching = threading.Thread(target=watch)
        watching.start()
        try:
            yield samples
        finally:
            stop.set()
            watching.join()

    def wait_logged(self, text: str, timeout: float) -> None:
        """Wait until `text` is in the log."""
        wait_until(lambda: text in self.output, f"{text!r} in the agent's log", timeout)

    def _read_answers(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self._answers.put(line)


@contextlib.contextmanager
def connected_agent(
    domain: int, simulator: SimulatorThread, **parameters: Any
) -> Iterator[DebugAgentProcess]:
    """Run the agent, connected to the simulator, while the block runs."""
    with contextlib.closing(
        DebugAgentProcess(domain, ip="127.0.0.1", port=simulator.port, **parameters)
    ) as agent:
        agent.wait_connected()
        yield agent
