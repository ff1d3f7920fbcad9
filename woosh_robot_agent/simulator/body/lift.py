"""The lifting mechanisms, and the job that moves them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from woosh_robot_agent.pb.util import action_pb2 as util_action_pb2
from woosh_robot_agent.simulator.behaviour.jobs import Device, Progress
from woosh_robot_agent.simulator.errors import Refused

if TYPE_CHECKING:
    from woosh_robot_agent.simulator.chassis import Chassis


@dataclass
class Lift:
    """One vertical axis.

    Attributes:
        name: For texts.
        device: How jobs refer to it.
        travel: The highest height in m; the lowest is 0.
        usual_speed: In m/s, where nobody asks for another.
        height: In m.
    """

    name: str
    device: Device
    travel: float
    usual_speed: float
    height: float = 0.0

    @property
    def raised(self) -> bool:
        """Whether it stands nearer to its top than to its bottom."""
        return self.height > self.travel / 2

    def checked(self, height: float) -> float:
        """The same height in m, if the axis can go there.

        Raises:
            Refused: It cannot.
        """
        if not 0.0 <= height <= self.travel + 1e-6:
            raise Refused(f"{self.name}: {height:.3f} m is not within 0 to {self.travel:g} m")
        return min(height, self.travel)


class MoveLift:
    """Moving a lift to one height after the other."""

    kind = util_action_pb2.kCarry

    def __init__(self, lift: Lift, *heights: float, speed: float = 0.0) -> None:
        self.device = lift.device
        self._lift = lift
        self._heights = list(heights)
        self._speed = abs(speed) or lift.usual_speed

    def tick(self, chassis: Chassis, dt: float) -> Progress:
        """See `Job.tick`."""
        way = self._heights[0] - self._lift.height if self._heights else 0.0
        if self._heights and abs(way) <= self._speed * dt:
            self._lift.height = self._heights.pop(0)
        else:
            self._lift.height += math.copysign(self._speed * dt, way)
        return Progress(done=not self._heights, text=f"at {self._lift.height:.3f} m")

    def hold(self, chassis: Chassis) -> None:
        """See `Job.hold`."""
