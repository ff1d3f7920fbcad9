from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.quick_chassis import quick_config
from tests.simulator.sim_wire import JsonClient, TcpClient
from woosh_robot_agent.simulator import SimulatorThread


@pytest.fixture
def simulator() -> Iterator[SimulatorThread]:
    with SimulatorThread(quick_config(port=0, tcp_port=0, speed=50, seed=1)) as simulator:
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
    # Without resolve(): the folder of the tests may be a symbolic link.
    return yaml.safe_load((Path(__file__).parents[1] / "facts" / "endpoints.yaml").read_text())
