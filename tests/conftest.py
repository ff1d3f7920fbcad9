"""Fixtures of the tests that need ROS, and the order of all tests."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from typing import Any

import pytest


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run the tests with the longest timeouts first, so that the last ones are short."""
    items.sort(key=_own_timeout, reverse=True)


def _own_timeout(item: pytest.Item) -> float:
    mark = item.get_closest_marker("timeout")
    return float(mark.args[0]) if mark else 0.0


try:
    from tests import harness
except ModuleNotFoundError as error:  # the tests of the link also run without ROS
    if error.name not in ("rclpy",):
        raise
    collect_ignore = ["node", "robustness", "test_benchmarks.py", "test_interfaces.py"]
else:
    from woosh_robot_agent.simulator import SimulatorConfig, SimulatorThread

    @pytest.fixture
    def domain() -> Iterator[int]:
        """A ROS_DOMAIN_ID that no other test uses."""
        with harness.own_domain() as number:
            yield number

    @pytest.fixture
    def simulator() -> Iterator[SimulatorThread]:
        """A simulated chassis that runs 20 times faster than real time."""
        with SimulatorThread(SimulatorConfig(port=0, tcp_port=0, speed=20, seed=1)) as running:
            yield running

    @pytest.fixture
    def start_agent(domain: int) -> Iterator[Callable[..., harness.RunningAgent]]:
        """Start agents; keyword arguments are ROS parameters."""
        running: list[harness.RunningAgent] = []

        def start(**parameters: Any) -> harness.RunningAgent:
            running.append(harness.RunningAgent(domain, **parameters))
            return running[-1]

        yield start
        for agent in running:
            agent.close()

    @pytest.fixture
    def agent(
        simulator: SimulatorThread, start_agent: Callable[..., harness.RunningAgent]
    ) -> harness.RunningAgent:
        """An agent that is connected to the simulator."""
        started = start_agent(ip="127.0.0.1", port=simulator.port, backoff_min=0.1)
        started.wait_connected()
        return started

    @pytest.fixture
    def client(domain: int) -> Iterator[harness.Client]:
        """A ROS node that uses the agent."""
        running = harness.Client(domain)
        yield running
        running.close()

    @pytest.fixture
    def start_program(domain: int) -> Iterator[Callable[..., harness.Program]]:
        """Start the agent's program; arguments are ROS arguments."""
        programs: list[harness.Program] = []

        def start(*arguments: str) -> harness.Program:
            programs.append(harness.Program(domain, *arguments))
            return programs[-1]

        yield start
        for program in programs:
            program.process.kill()
            program.process.wait()

    @pytest.fixture
    def logs() -> Iterator[harness.Collector]:
        """Log records of the agents in this process."""
        collector = harness.Collector()
        handler = logging.Handler()
        handler.emit = collector.add  # type: ignore[method-assign]
        logger = logging.getLogger("woosh_robot_agent")
        logger.addHandler(handler)
        yield collector
        logger.removeHandler(handler)
