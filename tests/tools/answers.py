"""Frames of the simulated chassis, changed before they are sent."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from woosh_robot_agent.simulator import Outgoing, SimulatorThread


def edit_bodies(chassis: SimulatorThread, cls: Any, edit: Callable[[Any], object]) -> None:
    """Let a function change the bodies of a class in all frames of the chassis."""

    def intercept(frame: Outgoing) -> list[Outgoing]:
        if isinstance(frame.body, cls):
            edit(frame.body)
        return [frame]

    chassis.intercept(intercept)
