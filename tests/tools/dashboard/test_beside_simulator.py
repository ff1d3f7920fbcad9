"""The page beside the simulator: obstacles and faults, and the option `--dashboard`."""

from __future__ import annotations

import re
import signal
import socket
import subprocess
import sys
import urllib.request
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

from tests.asynchronous import TIMEOUT
from tests.quick_chassis import quick_config
from tests.tools.dashboard.pages import Page, is_emergency_stopped, page
from woosh_robot_agent.simulator.__main__ import main
from woosh_robot_agent.simulator.server import SimulatedChassis
from woosh_robot_agent.tools.dashboard.beside_simulator import dashboard_beside


@asynccontextmanager
async def page_beside() -> AsyncIterator[tuple[SimulatedChassis, Page]]:
    """A simulated chassis and a page that knows its state."""
    async with (
        SimulatedChassis(quick_config(port=0, tcp_port=0)) as simulator,
        dashboard_beside(simulator, 0) as url,
        page(url) as viewer,
    ):
        await viewer.until(lambda parts: parts["robot"]["known"] and parts["simulator"])
        yield simulator, viewer


async def test_faults_begin_and_end() -> None:
    async with page_beside() as (simulator, viewer):
        await viewer.give("fault", text="emergency_stop")
        await viewer.until(is_emergency_stopped)
        await viewer.give("fault", text="key_switch")
        await viewer.until(lambda parts: parts["robot"]["control"] == "manual")
        await viewer.give("clearFaults")
        await viewer.until(lambda parts: not parts["robot"]["objections"])
        assert simulator.faults == []
        await viewer.give("fault", text="emergency_stop for=0.2")
        await viewer.until(lambda parts: parts["simulator"]["faults"])
        await viewer.until(lambda parts: not parts["simulator"]["faults"])


async def test_an_invalid_fault_and_more_than_100_are_refused() -> None:
    async with page_beside() as (simulator, viewer):
        for text, reason in (
            ("explode", "unknown fault 'explode'"),
            ("obstacle x=nan y=0", "is not a number"),
            ("emergency_stop at=5", "leave out `at`"),
            ("x" * 301, "at most 300 characters"),
            (7, "at most 300 characters"),
        ):
            assert reason in await viewer.refused("fault", text=text)
        assert await viewer.refused("endFault", id="delay 1") == "this fault has ended already"
        assert simulator.faults == []
        for _ in range(100):
            simulator.inject("delay", seconds=0.001)
        reason = await viewer.refused("fault", text="emergency_stop")
        assert reason == "there are 100 faults already: end some of them"


def test_the_simulator_serves_the_page() -> None:
    command = [sys.executable, "-m", "woosh_robot_agent.simulator", "--port", "0"]
    with subprocess.Popen(
        [*command, "--tcp-port", "0", "--dashboard", "0"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            assert process.stdout is not None
            found = re.fullmatch(r"dashboard ready at (\S+)\n", process.stdout.readline())
            assert found
            assert process.stdout.readline().startswith("simulated chassis ready on ")
            with urllib.request.urlopen(found[1], timeout=TIMEOUT) as response:
                assert b"main.js" in response.read()
            process.send_signal(signal.SIGINT)
            _, err = process.communicate(timeout=TIMEOUT)
        finally:
            process.kill()
    assert (process.returncode, err) == (0, "")


def test_a_port_in_use_is_reported(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        assert main(["--port", "0", "--tcp-port", "0", "--dashboard", port]) == 1
    err = capsys.readouterr().err
    assert f"cannot serve the page on port {port}: " in err
    assert "--dashboard PORT" in err
