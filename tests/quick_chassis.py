"""Options of simulated chassis for tests that are not about the delays of a real robot."""

from __future__ import annotations

from typing import Any

from woosh_robot_agent.simulator.config import SimulatorConfig


def quick_config(**options: Any) -> SimulatorConfig:
    """Return options of a chassis that answers without delay; see `SimulatorConfig`."""
    return SimulatorConfig(**{"profile": "instant", **options})
