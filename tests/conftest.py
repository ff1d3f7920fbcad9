"""Fixtures of the tests that need ROS; for all tests: warnings, order and garbage collection."""

from __future__ import annotations

import gc
import inspect
import logging
import os
from collections.abc import Callable, Iterator
from contextlib import closing
from itertools import pairwise
from typing import Any

import pytest

from tests.asynchronous import run_test

gc.disable()  # during the collection, of which nothing is garbage
_WARNINGS_ARE_ERRORS = ("tests/link/", "tests/motion/", "tests/robot/")
"""Folders of tests in which each warning is an error, e.g. about unclosed sockets."""
_LEAVE_NO_TASKS = (*_WARNINGS_ARE_ERRORS, "tests/robustness/")
"""Folders of asynchronous tests that fail if they leave a task."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.nodeid.startswith(_WARNINGS_ARE_ERRORS):
            item.add_marker(pytest.mark.filterwarnings("error"))
    _begin_with_the_longest(items)


def _begin_with_the_longest(items: list[pytest.Item]) -> None:
    """Let each process begin with some of the longest tests, so that none runs alone at the end.

    Tests with a timeout of their own count as long. pytest-xdist gives each process a section of
    the list, and moves tests to idle processes later.
    """
    processes = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    if processes == 1:
        return
    long = sorted(filter(_own_timeout, items), key=_own_timeout, reverse=True)
    short = [item for item in items if not _own_timeout(item)]
    sections = [len(short) * number // processes for number in range(processes + 1)]
    items[:] = []
    for number, (start, end) in enumerate(pairwise(sections)):
        items += long[number::processes] + short[start:end]


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """Run asynchronous tests."""
    if not inspect.iscoroutinefunction(pyfuncitem.obj):
        return None
    names = inspect.signature(pyfuncitem.obj).parameters
    test = pyfuncitem.obj(**{name: pyfuncitem.funcargs[name] for name in names})
    run_test(test, leaves_nothing=pyfuncitem.nodeid.startswith(_LEAVE_NO_TASKS))
    return True


def pytest_collection_finish() -> None:
    """Exclude the modules and the thousands of collected tests from garbage collection.

    They live until the end, and each complete collection would visit all of them. The tests of the
    link collect after each test, and would take several times as long. Python's default thresholds
    cost the other tests about a tenth of their CPU time.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)
    gc.enable()


def _own_timeout(item: pytest.Item) -> float:
    mark = item.get_closest_marker("timeout")
    return float(mark.args[0]) if mark else 0.0


try:
    from tests import harness
except ModuleNotFoundError as error:  # the tests of the link also run without ROS
    if error.name not in ("rclpy",):
        raise
    collect_ignore = ["convert", "node", "robustness"]
    collect_ignore += ["tooling/test_benchmarks.py", "tooling/test_interfaces.py"]
else:
    from tests.quick_chassis import quick_config
    from woosh_robot_agent.simulator import SimulatorThread

    @pytest.fixture
    def domain() -> Iterator[int]:
        """A ROS_DOMAIN_ID that no other test uses at the same time."""
        with harness.own_domain() as number:
            yield number

    @pytest.fixture
    def simulator() -> Iterator[SimulatorThread]:
        """A simulated chassis that runs 20 times faster than real time."""
        with SimulatorThread(quick_config(port=0, tcp_port=0, speed=20, seed=1)) as running:
            yield running

    @pytest.fixture
    def start_agent(domain: int) -> Iterator[Callable[..., harness.RunningAgent]]:
        """Function that starts an agent; its keyword arguments are ROS parameters."""
        running: list[harness.RunningAgent] = []

        def start(**parameters: Any) -> harness.RunningAgent:
            running.append(harness.RunningAgent(domain, **parameters))
            return running[-1]

        yield start
        for agent in running:
            agent.close()

    @pytest.fixture
    def connect(
        simulator: SimulatorThread, start_agent: Callable[..., harness.RunningAgent]
    ) -> Callable[..., harness.RunningAgent]:
        """Function that starts an agent and connects it to the simulator; as `start_agent`."""

        def connect(**parameters: Any) -> harness.RunningAgent:
            address = {"ip": "127.0.0.1", "port": simulator.port, "backoff_min": 0.1}
            started = start_agent(**{**address, **parameters})
            started.wait_connected()
            return started

        return connect

    @pytest.fixture
    def agent(connect: Callable[..., harness.RunningAgent]) -> harness.RunningAgent:
        """An agent that is connected to the simulator."""
        return connect()

    @pytest.fixture
    def client(domain: int) -> Iterator[harness.Client]:
        """A ROS node that uses the agent."""
        with closing(harness.Client(domain)) as running:
            yield running

    @pytest.fixture
    def robot(agent: harness.RunningAgent, simulator: SimulatorThread) -> Iterator[harness.Robot]:
        """A ROS node that uses the agent, with the agent and the simulator."""
        with closing(harness.Robot(agent, simulator)) as running:
            yield running

    @pytest.fixture
    def start_program(domain: int) -> Iterator[Callable[..., harness.Program]]:
        """Function that starts the agent's program; it takes ROS arguments, and parameters."""
        programs: list[harness.Program] = []

        def start(*arguments: str, **parameters: Any) -> harness.Program:
            programs.append(harness.Program(domain, *arguments, **parameters))
            return programs[-1]

        yield start
        for program in programs:
            program.process.kill()
            program.process.wait()

    @pytest.fixture
    def start_connected(
        simulator: SimulatorThread, start_program: Callable[..., harness.Program]
    ) -> Callable[[], harness.Program]:
        """Function that starts the agent's program, and connects it to the simulator."""

        def start() -> harness.Program:
            program = start_program(ip="127.0.0.1", port=simulator.port)
            program.wait_says("connected to")
            return program

        return start

    @pytest.fixture
    def program(start_connected: Callable[[], harness.Program]) -> harness.Program:
        """The agent's program, connected to the simulator."""
        return start_connected()

    @pytest.fixture
    def logs() -> Iterator[harness.Logs]:
        """Log records of the agents in this process."""
        collector = harness.Logs()
        handler = logging.Handler()
        handler.emit = collector.add  # type: ignore[method-assign]
        logger = logging.getLogger("woosh_robot_agent")
        logger.addHandler(handler)
        yield collector
        logger.removeHandler(handler)
