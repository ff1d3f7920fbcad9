"""Programs of a bench: started, asked for their port, measured, ended."""

from __future__ import annotations

import contextlib
import gc
import json
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from benchmarks.options import Options
from benchmarks.process import module, rss
from tests.harness import NAMESPACE, wait_until

_LAST_WORDS = 4000
"""Characters of what a program said that are shown when it died."""


class Program:
    """A Python module in a process of its own. What it says on stderr is kept."""

    def __init__(self, *command: str, domain: int) -> None:
        # not a pipe: one that nobody reads would block it
        self._said = tempfile.TemporaryFile("w+")  # noqa: SIM115
        self._name = " ".join(command)
        self._stopping = False
        self.started = time.monotonic()
        self.process = module(
            *command,
            domain=domain,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._said,
        )

    def tell(self, *words: object) -> None:
        """Write a line to its standard input."""
        assert self.process.stdin is not None
        self.check()
        self.process.stdin.write(" ".join(map(str, words)) + "\n")
        self.process.stdin.flush()

    def read(self) -> Any:
        """The next line that it prints, as JSON."""
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            self.process.wait()
            self.check()
            raise RuntimeError(f"{self._name} was stopped before it answered")
        return json.loads(line)

    def check(self) -> None:
        """Raise where it has ended, which nobody told it to."""
        if (status := self.process.poll()) is not None and not self._stopping:
            raise RuntimeError(f"{self._name} ended with {status}; it said:\n{self.said}")

    @property
    def said(self) -> str:
        """The end of what it said on stderr."""
        # not by this end's position: it shares that with the program, which would write there
        return Path(f"/proc/self/fd/{self._said.fileno()}").read_text()[-_LAST_WORDS:]

    def wait_says(self, text: str, times: int = 1, timeout: float = 60.0) -> None:
        """Wait until it has said something on stderr so many times."""

        def there() -> bool:
            self.check()
            return self.said.count(text) >= times

        wait_until(there, f"{text!r} of {self._name}", timeout)

    @property
    def cpu(self) -> float:
        """CPU time of all its threads in s, to the nanosecond."""
        self.check()
        total = 0
        for task in Path("/proc", str(self.process.pid), "task").iterdir():
            with contextlib.suppress(OSError):  # a thread that has ended meanwhile
                total += int((task / "schedstat").read_text().split()[0])
        return total / 1e9

    @property
    def rss(self) -> int:
        """Resident memory in bytes."""
        return rss(self.process.pid)

    def stop(self) -> None:
        """Tell it to end. It is still to be ended by `end`."""
        if not self._stopping and self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        self._stopping = True

    def end(self) -> None:
        """End it, politely at first."""
        self.stop()
        try:
            self.process.wait(5)
        except subprocess.TimeoutExpired:
            self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout, self._said):
            assert pipe is not None
            pipe.close()


@contextlib.contextmanager
def running(*command: str, domain: int) -> Iterator[Program]:
    """A program, ended at the end.

    Raises:
        RuntimeError: it ended before, by itself; the text has what it said.
    """
    program = Program(*command, domain=domain)
    try:
        try:
            yield program
        except (AssertionError, OSError):
            program.check()  # what it died of tells more than who missed it
            raise
        program.check()
    finally:
        program.end()


@contextlib.contextmanager
def echo_chassis(domain: int, transport: str, *options: str) -> Iterator[tuple[Program, int]]:
    """The other end of the link, and its port."""
    command = ("benchmarks.echo_chassis", "--transport", transport, *options)
    with running(*command, domain=domain) as program:
        yield program, program.read()


@contextlib.contextmanager
def agent(
    domain: int, port: int, options: Options, namespace: str = NAMESPACE, **parameters: Any
) -> Iterator[Program]:
    """The agent, connected."""
    with running(*agent_command(port, options, namespace, **parameters), domain=domain) as program:
        program.wait_says("connected to")
        yield program


def agent_command(
    port: int, options: Options, namespace: str = NAMESPACE, **parameters: Any
) -> list[str]:
    """The agent as a program for `running`."""
    given: Mapping[str, Any] = {"ip": "127.0.0.1", "port": port, **options.agent, **parameters}
    words = [word for name, value in given.items() for word in ("-p", f"{name}:={value}")]
    return ["woosh_robot_agent.agent", "--ros-args", "-r", f"__ns:={namespace}", *words]


@contextlib.contextmanager
def no_collection() -> Iterator[None]:
    """Python's garbage collector keeps out of what this process measures."""
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
