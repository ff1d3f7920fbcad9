"""The lifting mechanisms."""

from __future__ import annotations

from dataclasses import dataclass

from woosh_robot_agent.simulator import refusals
from woosh_robot_agent.simulator.body.devices import Device
from woosh_robot_agent.simulator.refusals import RefusedError


@dataclass
class Lift:
    """A vertical axis.

    Attributes:
        name: Name for texts.
        device: Device that a job owns while it moves the lift.
        travel: Maximum height, in metres; the minimum is 0.
        default_speed: Speed if a request gives none, in m/s.
        height: Current height, in metres.
    """

    name: str
    device: Device
    travel: float
    default_speed: float
    height: float = 0.0

    @property
    def raised(self) -> bool:
        """True if the lift is above the middle of its travel."""
        return self.height > self.travel / 2

    def checked(self, height: float) -> float:
        """Return `height` if the lift can reach it.

        Raises:
            RefusedError: The height is out of range.
        """
        if not 0.0 <= height <= self.travel + 1e-6:
            raise RefusedError(
                refusals.LIFT_OUT_OF_RANGE, lift=self.name, height=height, limit=self.travel
            )
        return min(height, self.travel)
