"""The agent, a chassis and other Python modules as processes: their CPU time, memory and files."""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.options import Options
from woosh_robot_agent.testing import wait_until
from woosh_robot_agent.testing.agents import NAMESPACE

MIB = 1024 * 1024
ROOT = Path(__file__).resolve().parents[1]
"""Root of the repository, where modules are started."""
FLOOR = "/floor"
"""Namespace of a floor that shares a ROS domain with the agent."""
_CPU_CLOCK = 2
"""Lowest bits of the number of a process's CPU clock; above them is the inverted process ID."""
_PAGE_SIZE = os.sysconf("SC_PAGE_SIZE")
_END_TIMEOUT = 5.0
"""Time after which a program that was asked to end is killed, in seconds."""
_LOG_TIMEOUT = 300.0
"""Time in which a text must be logged, in seconds. A start takes minutes on a very busy machine."""
_LOG_TAIL = 4000
"""Length of the log that is shown when a program dies, in characters."""


@dataclass(frozen=True)
class Resources:
    """Resources of a process at one moment.

    Attributes:
        rss: resident memory, shared libraries included, in bytes.
        fds: open file descriptors.
        sockets: file descriptors that are sockets.
        threads: threads of the operating system.
    """

    rss: int
    fds: int
    sockets: int
    threads: int


def resources(pid: int) -> Resources:
    """Return the resources that a running process holds."""
    process = Path("/proc", str(pid))
    links = []
    for fd in (process / "fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # closed in the meantime
            links.append(os.readlink(fd))
    return Resources(
        rss=rss(pid),
        fds=len(links),
        sockets=sum(link.startswith("socket:") for link in links),
        threads=len(list((process / "task").iterdir())),
    )


def rss(pid: int) -> int:
    """Return the resident memory of a running process, in bytes."""
    return int(Path("/proc", str(pid), "statm").read_text().split()[1]) * _PAGE_SIZE


def start_module(name: str, *arguments: str, domain: int, **options: Any) -> subprocess.Popen[str]:
    """Start a module of this repository as a process.

    Args:
        name: full name of the module.
        arguments: its command line.
        domain: its ROS_DOMAIN_ID.
        options: further options of `subprocess.Popen`.
    """
    return subprocess.Popen(
        [sys.executable, "-m", name, *arguments],
        env={**os.environ, "ROS_DOMAIN_ID": str(domain), "PYTHONUNBUFFERED": "1"},
        text=True,
        cwd=ROOT,
        **options,
    )


class Program:
    """A module that runs as a process, takes commands on stdin and answers in JSON on stdout.

    Attributes:
        started: time of its start (time.monotonic), in seconds.
        process: the process.
    """

    def __init__(self, *command: str, domain: int) -> None:
        # stderr goes to a file: a pipe that nobody reads would block the program
        self._log_file = tempfile.TemporaryFile("w+")  # noqa: SIM115
        self._name = " ".join(command)
        self._stopping = False
        self.started = time.monotonic()
        self.process = start_module(
            *command,
            domain=domain,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log_file,
        )

    def send(self, *words: object) -> None:
        """Write one line to its stdin."""
        assert self.process.stdin is not None
        self.check_running()
        self.process.stdin.write(" ".join(map(str, words)) + "\n")
        self.process.stdin.flush()

    def receive(self) -> Any:
        """Return the next line of its stdout, parsed as JSON."""
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            self.process.wait()
            self.check_running()
            raise RuntimeError(f"{self._name} was stopped before it answered")
        return json.loads(line)

    def has_answer(self) -> bool:
        """Return True if its stdout has something to receive."""
        self.check_running()
        return bool(select.select([self.process.stdout], [], [], 0)[0])

    def check_running(self) -> None:
        """Raise RuntimeError if the program has ended by itself."""
        if (status := self.process.poll()) is not None and not self._stopping:
            raise RuntimeError(f"{self._name} ended with status {status}. Its log:\n{self.log}")

    @property
    def log(self) -> str:
        """The last part of its stderr."""
        # opened again, because reading would move the file position shared with the program
        return Path(f"/proc/self/fd/{self._log_file.fileno()}").read_text()[-_LOG_TAIL:]

    def wait_logged(self, text: str, times: int = 1, timeout: float = _LOG_TIMEOUT) -> None:
        """Wait until its log contains `text` the given number of times."""

        def logged() -> bool:
            self.check_running()
            return self.log.count(text) >= times

        wait_until(logged, f"{text!r} in the log of {self._name}", timeout)

    @property
    def cpu(self) -> float:
        """CPU time of all its threads, also of those that have ended, in seconds."""
        self.check_running()
        return time.clock_gettime(~self.process.pid << 3 | _CPU_CLOCK)

    @property
    def rss(self) -> int:
        """Resident memory, in bytes."""
        return rss(self.process.pid)

    @property
    def peak_rss(self) -> int:
        """Largest resident memory since its start or the last `reset_peak_rss`, in bytes."""
        for line in self._proc("status").read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024
        raise RuntimeError("this kernel does not tell the peak of the resident memory")

    def reset_peak_rss(self) -> None:
        """Make `peak_rss` start again at the current resident memory."""
        self._proc("clear_refs").write_text("5")

    def _proc(self, name: str) -> Path:
        return Path("/proc", str(self.process.pid), name)

    def interrupt(self) -> None:
        """Send SIGINT to the program, without waiting for its end."""
        if not self._stopping and self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        self._stopping = True

    def end(self) -> None:
        """End the program, by force if it does not end in time."""
        self.interrupt()
        assert self.process.stdin is not None
        self.process.stdin.close()  # asyncio does not interrupt a program that waits for a command
        try:
            self.process.wait(_END_TIMEOUT)
        except subprocess.TimeoutExpired:
            self.process.kill()
        self.process.wait()
        assert self.process.stdout is not None
        self.process.stdout.close()
        self._log_file.close()


@contextlib.contextmanager
def running(*command: str, domain: int) -> Iterator[Program]:
    """Run a program while the block runs.

    Raises:
        RuntimeError: the program ended by itself. The text holds the last part of its log.
    """
    program = Program(*command, domain=domain)
    try:
        try:
            yield program
        except (AssertionError, OSError):
            program.check_running()  # its log explains more than this error
            raise
        program.check_running()
    finally:
        program.end()


@contextlib.contextmanager
def running_chassis(
    domain: int, *options: str, transport: str = "websocket"
) -> Iterator[tuple[Program, int]]:
    """Run the chassis of the benchmarks; yield the program and its port."""
    command = ("benchmarks.programs.chassis", "--transport", transport, *options)
    with running(*command, domain=domain) as program:
        yield program, program.receive()


@contextlib.contextmanager
def running_floor(name: str, domain: int, port: int) -> Iterator[Program]:
    """Run a floor that connects to the chassis at `port`; the block starts when it has."""
    url = f"ws://127.0.0.1:{port}"
    with running(f"benchmarks.floors.{name}", url, domain=domain) as program:
        program.wait_logged("connected to")
        yield program


@contextlib.contextmanager
def running_agent(
    domain: int, port: int, options: Options, namespace: str = NAMESPACE, **parameters: Any
) -> Iterator[Program]:
    """Run the agent; the block starts when it is connected to the chassis at `port`."""
    with running(*agent_command(port, options, namespace, **parameters), domain=domain) as program:
        program.wait_logged("connected to")
        yield program


def agent_command(
    port: int, options: Options, namespace: str = NAMESPACE, **parameters: Any
) -> list[str]:
    """Return the agent's module and arguments, as `running` takes them."""
    values: Mapping[str, Any] = {
        "ip": "127.0.0.1",
        "port": port,
        **options.agent_parameters,
        **parameters,
    }
    words = [word for name, value in values.items() for word in ("-p", f"{name}:={value}")]
    return ["woosh_robot_agent.agent", "--ros-args", "-r", f"__ns:={namespace}", *words]
