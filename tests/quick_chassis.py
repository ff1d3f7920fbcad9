"""Options, speed and changed answers of simulated chassis for tests that need no delays."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from woosh_robot_agent.link.protos import message_type
from woosh_robot_agent.simulator import Outgoing, SimulatorThread
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.config import SimulatorConfig
from woosh_robot_agent.simulator.protocol.handlers import Answer, dispatch


def quick_config(**options: Any) -> SimulatorConfig:
    """Return options of a chassis that answers without delay; see `SimulatorConfig`."""
    return SimulatorConfig(**{"profile": "instant", **options})


def execute(chassis: Chassis, type_name: str, **fields: Any) -> Answer:
    """Execute a request on a chassis without clients, and return the answer."""
    return dispatch(chassis, message_type(type_name)(**fields))


def set_speed(chassis: SimulatorThread, speed: float) -> None:
    """Change the simulated seconds per real second; it takes effect after the current step."""
    chassis.call(lambda simulator: setattr(simulator, "speed", speed))


def edit_bodies(
    chassis: SimulatorThread, cls: Any, edit: Callable[[Any], object]
) -> Callable[[], None]:
    """Let a function change the bodies of a class in all frames of the chassis.

    Returns:
        A function that ends this.
    """

    def intercept(frame: Outgoing) -> list[Outgoing]:
        if isinstance(frame.body, cls):
            edit(frame.body)
        return [frame]

    return chassis.intercept(intercept)
