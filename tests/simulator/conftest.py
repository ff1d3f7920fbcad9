from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from tests.fact_files import facts
from tests.simulator.sim_wire import JsonClient, TcpClient
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.testing import running_chassis


@pytest.fixture
def simulator() -> Iterator[SimulatorThread]:
    with running_chassis(speed=50) as simulator:
        yield simulator


@pytest.fixture
def client(simulator: SimulatorThread) -> Iterator[JsonClient]:
    client = JsonClient(simulator.port)
    yield client
    client.close()


@pytest.fixture
def tcp(simulator: SimulatorThread) -> Iterator[TcpClient]:
    client = TcpClient(simulator.tcp_port)
    yield client
    client.close()


@pytest.fixture(scope="session")
def endpoints() -> Any:
    return facts("endpoints.yaml")
