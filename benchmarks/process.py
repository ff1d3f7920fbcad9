"""The agent as a process of its own, and what it costs: memory, files, sockets, threads."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from tests.harness import NAMESPACE, wait_until
from woosh_robot_agent.simulator import SimulatorThread

MIB = 1024 * 1024
_ROOT = Path(__file__).resolve().parents[1]
_PAGE = os.sysconf("SC_PAGE_SIZE")
_ANSWER_TIMEOUT = 60.0
"""s that the agent gets to tell about itself; under a flood its loop is busy."""


@dataclass(frozen=True)
class Sample:
    """What a process holds at one time.

    Attributes:
        rss: resident memory in bytes, that of shared libraries included.
        fds: open file descriptors.
        sockets: those of them that are sockets.
        threads: threads of the operating system.
    """

    rss: int
    fds: int
    sockets: int
    threads: int


def sample(pid: int) -> Sample:
    """Look at a running process."""
    process = Path("/proc", str(pid))
    links = []
    for fd in (process / "fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # closed meanwhile
            links.append(os.readlink(fd))
    return Sample(
        rss=rss(pid),
        fds=len(links),
        sockets=sum(link.startswith("socket:") for link in links),
        threads=len(list((process / "task").iterdir())),
    )


def rss(pid: int) -> int:
    """Resident memory of a running process in bytes."""
    return int(Path("/proc", str(pid), "statm").read_text().split()[1]) * _PAGE


def module(name: str, *arguments: str, domain: int, **options: Any) -> subprocess.Popen[str]:
    """Start a module of this repository as a program, in a ROS domain."""
    return subprocess.Popen(
        [sys.executable, "-m", name, *arguments],
        env={
            **os.environ,
            "ROS_DOMAIN_ID": str(domain),
            "PYTHONUNBUFFERED": "1",
        },
        text=True,
        cwd=_ROOT,
        **options,
    )


class AgentProcess:
    """The agent in a process of its own, which tells about itself; see `tests.robustness.inside`.

    Args:
        domain: ROS_DOMAIN_ID.
        parameters: the agent's parameters.
    """

    def __init__(self, domain: int, **parameters: Any) -> None:
        given = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
        self.process = module(
            "tests.robustness.inside",
            *("--ros-args", "-r", f"__ns:={NAMESPACE}", *given),
            domain=domain,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        self.lines: list[str] = []
        self._answers: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._readers = [
            threading.Thread(target=_pump, args=(self.process.stderr, self.lines.append)),
            threading.Thread(target=_pump, args=(self.process.stdout, self._answers.put)),
        ]
        for reader in self._readers:
            reader.start()

    def __enter__(self) -> AgentProcess:
        return self

    def __exit__(
        self,
        _kind: type[BaseException] | None,
        _error: BaseException | None,
        _traceback: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """End it: in good order, if it can."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
            try:
                self.process.wait(10)
            except subprocess.TimeoutExpired:
                self.process.kill()
        self.process.wait()
        for reader in self._readers:
            reader.join()
        for pipe in (self.process.stdin, self.process.stdout, self.process.stderr):
            assert pipe is not None
            pipe.close()

    @property
    def output(self) -> str:
        """What it said on stderr so far."""
        return "".join(self.lines)

    def said(self, text: str) -> list[str]:
        """The lines on stderr in which `text` is."""
        return [line for line in tuple(self.lines) if text in line]

    def wait_says(self, text: str, times: int = 1, timeout: float = 30.0) -> None:
        """Wait until it has said something so many times since its start."""
        wait_until(lambda: len(self.said(text)) >= times, f"{text!r} in\n{self.output}", timeout)

    def sample(self) -> Sample:
        """What it holds now."""
        return sample(self.process.pid)

    def look(self, *, objects: bool = False) -> dict[str, Any]:
        """What is inside it now: tasks, pending futures, counters.

        Args:
            objects: count Python's objects by type too, which takes it a moment.
        """
        assert self.process.stdin is not None
        self.process.stdin.write("objects\n" if objects else "look\n")
        self.process.stdin.flush()
        try:
            state: dict[str, Any] = json.loads(self._answers.get(timeout=_ANSWER_TIMEOUT))
        except queue.Empty:
            raise AssertionError(f"the agent does not answer; it said:\n{self.output}") from None
        return state

    def settled_rss(self, limit: float, timeout: float) -> int:
        """Resident memory in bytes as soon as it is within `limit`; after `timeout` s anyhow."""
        deadline = time.monotonic() + timeout
        while (now := rss(self.process.pid)) > limit and time.monotonic() < deadline:
            threading.Event().wait(0.2)
        return now


@contextlib.contextmanager
def connected_agent(
    domain: int, simulator: SimulatorThread, **parameters: Any
) -> Iterator[AgentProcess]:
    """The agent as a process of its own, connected to the simulator."""
    with AgentProcess(domain, ip="127.0.0.1", port=simulator.port, **parameters) as agent:
        agent.wait_says("connected to")
        yield agent


def _pump(pipe: Any, take: Callable[[str], object]) -> None:
    for line in pipe:
        take(line)
