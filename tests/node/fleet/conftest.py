"""Two robots, each with a simulated chassis and a client, and the program that has both."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from tests.harness import Client, Program
from tests.node.fleet.robots import NAMES, ROBOTS, logger_of, write_parameters
from tests.node.test_process import LONG
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.testing import running_chassis


@pytest.fixture
def chassis() -> Iterator[dict[str, SimulatorThread]]:
    """A simulated chassis for each robot, by namespace."""
    with ExitStack() as stack:
        yield {
            name: stack.enter_context(running_chassis(robot_id=number))
            for number, name in enumerate(ROBOTS, start=30001)
        }


@pytest.fixture
def clients(domain: int) -> Iterator[dict[str, Client]]:
    """A client for each robot, by namespace."""
    running = {name: Client(domain, name) for name in ROBOTS}
    yield running
    for client in running.values():
        client.close()


@pytest.fixture
def start_fleet(
    tmp_path: Path,
    chassis: dict[str, SimulatorThread],
    start_program: Callable[..., Program],
) -> Callable[..., Program]:
    """Start the program for all robots, and wait until it is connected to them."""

    def start(**common: Any) -> Program:
        own = {name: {"ip": "127.0.0.1", "port": each.port} for name, each in chassis.items()}
        common = {**LONG, **common}
        program = start_program(
            "--params-file", str(write_parameters(tmp_path, NAMES, common, **own))
        )
        for name in ROBOTS:
            program.wait_says(f"{logger_of(name)}]: connected to")
        return program

    return start


@pytest.fixture
def fleet(start_fleet: Callable[..., Program]) -> Program:
    return start_fleet()
