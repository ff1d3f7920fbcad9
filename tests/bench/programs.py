"""Programs of a bench: started, asked for their port, measured, ended."""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from bench.process import module, rss


class Program:
    """A Python module in a process of its own."""

    def __init__(self, *command: str, domain: int) -> None:
        self.started = time.monotonic()
        self.process = module(
            *command,
            domain=domain,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )

    def tell(self, line: str) -> None:
        """Write a line to its standard input."""
        assert self.process.stdin is not None
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def read(self) -> Any:
        """The next line that it prints, as JSON."""
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise RuntimeError(f"{self.process.args} ended with {self.process.wait()}")
        return json.loads(line)

    @property
    def cpu(self) -> float:
        """CPU time of all its threads in s, to the nanosecond."""
        total = 0
        for task in Path("/proc", str(self.process.pid), "task").iterdir():
            with contextlib.suppress(OSError):  # a thread that has ended meanwhile
                total += int((task / "schedstat").read_text().split()[0])
        return total / 1e9

    @property
    def rss(self) -> int:
        """Resident memory in bytes."""
        return rss(self.process.pid)

    def end(self) -> None:
        """End it, politely at first."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
            try:
                self.process.wait(5)
            except subprocess.TimeoutExpired:
                self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            assert pipe is not None
            pipe.close()


@contextlib.contextmanager
def running(*command: str, domain: int) -> Iterator[Program]:
    """A program, ended at the end."""
    program = Program(*command, domain=domain)
    try:
        yield program
    finally:
        program.end()


@contextlib.contextmanager
def echo_chassis(domain: int, *options: str) -> Iterator[tuple[Program, int]]:
    """The other end of the link, and its port."""
    with running("bench.echo_chassis", *options, domain=domain) as program:
        yield program, program.read()


def agent_command(port: int, executor: str, **parameters: Any) -> list[str]:
    """The agent as a program for `running`."""
    given = {"ip": "127.0.0.1", "port": port, "executor": executor, **parameters}
    words = [word for name, value in given.items() for word in ("-p", f"{name}:={value}")]
    return ["woosh_robot_agent.agent", "--ros-args", "-r", "__ns:=/woosh_robot", *words]
