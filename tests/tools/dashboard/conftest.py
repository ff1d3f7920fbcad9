"""Fixtures of the tests of the dashboard."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from tests.quick_chassis import quick_config
from tests.tools.dashboard.browsers import Browser, RobotThread, SimulatedPage, chromium
from woosh_robot_agent.simulator import SimulatorThread


@pytest.fixture(scope="session")
def shared_browser() -> Iterator[Browser]:
    """The browser of all tests of this process, because each start takes seconds."""
    with chromium() as running:
        yield running


@pytest.fixture
def window(shared_browser: Browser) -> Iterator[Browser]:
    """An empty window of the shared browser."""
    with shared_browser.new_window():
        yield shared_browser


@pytest.fixture
def other() -> Iterator[SimulatorThread]:
    """A simulated chassis beside `chassis`."""
    with SimulatorThread(quick_config(port=0, tcp_port=0, robot_id=8)) as running:
        yield running


@pytest.fixture
def certificate(tmp_path: Path) -> list[str]:
    """Options with a new certificate for this machine, and its key."""
    return new_certificate(tmp_path)


def new_certificate(folder: Path) -> list[str]:
    """Return options with a new certificate for this machine, and its key."""
    files = [str(folder / name) for name in ("cert.pem", "key.pem")]
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1"]
        + ["-nodes", "-subj", "/CN=localhost", "-addext", "subjectAltName=IP:127.0.0.1"]
        + ["-out", files[0], "-keyout", files[1]],
        check=True,
        capture_output=True,
    )
    return ["--tls-cert", files[0], "--tls-key", files[1]]


@pytest.fixture
def robot() -> Iterator[SimulatedPage]:
    """A simulated robot with its page."""
    with SimulatedPage() as running:
        yield running


@pytest.fixture
def browser(robot: SimulatedPage, window: Browser) -> Iterator[Browser]:
    """A browser that shows the page; at the end, its console and its requests are checked."""
    window.open(robot.url)
    yield window
    window.check_console_and_requests(robot.url)


class Served(NamedTuple):
    """Simulated robots, and the address of a page for them."""

    robots: list[RobotThread]
    url: str


Serve = Callable[..., Served]


@contextmanager
def serving_robots() -> Iterator[Serve]:
    """Yield a function that starts robots with these options, and a dashboard for them."""
    with ExitStack() as running:

        def start(*robots: dict[str, Any], **options: Any) -> Served:
            threads = [running.enter_context(RobotThread(**each)) for each in robots]
            return Served(threads, running.enter_context(threads[0].serving(*threads, **options)))

        yield start


@pytest.fixture
def serve() -> Iterator[Serve]:
    """Function that starts robots with these options, and a dashboard for them."""
    with serving_robots() as start:
        yield start
