"""Fixtures that work without ROS, unlike those of `tests/conftest.py`."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from tests.quick_chassis import quick_config
from woosh_robot_agent.simulator import SimulatorThread


@pytest.fixture
def chassis() -> Iterator[SimulatorThread]:
    """A simulated chassis in real time."""
    with SimulatorThread(quick_config(port=0, tcp_port=0)) as running:
        yield running


@pytest.fixture
def set_state(chassis: SimulatorThread) -> Callable[..., None]:
    """Function that sets attributes of the chassis's readiness for tasks."""

    def change(**values: object) -> None:
        def do(simulator: object) -> None:
            readiness = simulator.chassis.readiness  # type: ignore[attr-defined]
            for name, value in values.items():
                assert hasattr(readiness, name)
                setattr(readiness, name, value)

        chassis.call(do)

    return change
