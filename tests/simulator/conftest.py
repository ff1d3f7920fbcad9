from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, closing
from typing import Any

import pytest

from tests.quick_chassis import quick_config
from tests.simulator.recorded_chassis import SteppedChassis
from tests.simulator.sim_wire import Connect, ConnectTcp, JsonClient, TcpClient
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.testing import running_chassis


def pytest_configure(config: pytest.Config) -> None:
    text = "chassis(**options): options of running_chassis for the fixture simulator"
    config.addinivalue_line("markers", text)


@pytest.fixture
def simulator(request: pytest.FixtureRequest) -> Iterator[SimulatorThread]:
    """A simulated chassis, by default 50 times as fast as real time; see the mark `chassis`."""
    options: dict[str, Any] = {}
    # The mark of a test comes before that of its file.
    for mark in request.node.iter_markers("chassis"):
        options = {**mark.kwargs, **options}
    with running_chassis(**{"speed": 50, **options}) as simulator:
        yield simulator


@pytest.fixture
def connect(simulator: SimulatorThread) -> Iterator[Connect]:
    """Function that connects a client, which is closed at the end."""
    with ExitStack() as stack:
        yield lambda: stack.enter_context(closing(JsonClient(simulator.port, simulator)))


@pytest.fixture
def client(connect: Connect) -> JsonClient:
    return connect()


@pytest.fixture
def connect_tcp(simulator: SimulatorThread) -> Iterator[ConnectTcp]:
    """Function that connects a client over TCP, which is closed at the end."""
    with ExitStack() as stack:
        yield lambda: stack.enter_context(closing(TcpClient(simulator.tcp_port, simulator)))


@pytest.fixture
def tcp(connect_tcp: ConnectTcp) -> TcpClient:
    return connect_tcp()


@pytest.fixture
def chassis() -> Chassis:
    """The model of a chassis that does everything at once, without clients."""
    return Chassis(quick_config(seed=1))


@pytest.fixture
def real() -> SteppedChassis:
    """A chassis as real as it gets, stepped by hand."""
    return SteppedChassis()


@pytest.fixture
def quick() -> SteppedChassis:
    """A chassis that does everything at once, stepped by hand."""
    return SteppedChassis(profile="instant")
