"""Step control: so far straight ahead, sideways or round, measured by odometry."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from woosh_robot_agent.pb.util import action_pb2 as util_action_pb2
from woosh_robot_agent.simulator.behaviour.forward_clearance import way_is_free
from woosh_robot_agent.simulator.behaviour.jobs import Device, Progress, failed
from woosh_robot_agent.simulator.body.base import (
    ACCELERATION_MPS2,
    ACCELERATION_RADPS2,
    Velocity,
    approach,
)
from woosh_robot_agent.simulator.world.geometry import Pose

if TYPE_CHECKING:
    from woosh_robot_agent.simulator.chassis import Chassis

_PATIENCE_S = 5.0
_EXACT = 1e-6


@dataclass(frozen=True, slots=True)
class Shift:
    """A straight move without turning.

    Attributes:
        direction: rad from straight ahead, counter-clockwise.
        distance: m, negative backwards.
        speed: m/s.
    """

    direction: float
    distance: float
    speed: float

    def remaining(self, start: Pose, now: Pose) -> float:
        """The signed distance in m still to go."""
        heading = start.theta + self.direction
        gone = (now.x - start.x) * math.cos(heading) + (now.y - start.y) * math.sin(heading)
        return self.distance - gone

    def velocity(self, remaining: float, dt: float) -> Velocity:
        """The velocity for the next step."""
        speed = approach(remaining, self.speed, ACCELERATION_MPS2, dt)
        return Velocity(speed * math.cos(self.direction), speed * math.sin(self.direction))

    def describe(self, remaining: float) -> str:
        """How far it is, for people."""
        return f"{self.distance - remaining:.2f} of {self.distance:.2f} m"


@dataclass(frozen=True, slots=True)
class Turn:
    """A turn on the spot.

    Attributes:
        angle: rad, negative clockwise; more than a full turn is possible.
        speed: rad/s.
    """

    angle: float
    speed: float

    def remaining(self, start: Pose, now: Pose) -> float:
        """The signed angle in rad still to go."""
        return self.angle - (now.theta - start.theta)

    def velocity(self, remaining: float, dt: float) -> Velocity:
        """The velocity for the next step."""
        return Velocity(turn=approach(remaining, self.speed, ACCELERATION_RADPS2, dt))

    def describe(self, remaining: float) -> str:
        """How far it is, for people."""
        return f"{self.angle - remaining:.2f} of {self.angle:.2f} rad"


class Steps:
    """A row of steps, one after the other.

    Args:
        steps: At least one.
        avoid: Stop before an obstacle, and wait some seconds for it to go away; else drive until
            the base touches it, and fail at once.
        kind: What reports say these steps are.
    """

    device = Device.WHEELS

    def __init__(
        self,
        steps: Sequence[Shift | Turn],
        *,
        avoid: bool,
        kind: util_action_pb2.Type = util_action_pb2.kStepCtrl,
    ) -> None:
        self.kind = kind
        self._steps = deque(steps)
        self._count = len(self._steps)
        self._start: Pose | None = None
        self._blocked_for = 0.0
        self._avoid = avoid
        self._patience = _PATIENCE_S if avoid else 0.0

    def tick(self, chassis: Chassis, dt: float) -> Progress:
        """See `Job.tick`."""
        base = chassis.base
        free = not self._avoid or self._way_is_free(chassis)
        blocked = base.blocked or not free
        self._blocked_for = self._blocked_for + dt if blocked else 0.0
        while self._steps:
            step = self._steps[0]
            self._start = self._start or base.odometry
            remaining = step.remaining(self._start, base.odometry)
            how_far = step.describe(remaining)
            if self._blocked_for > self._patience:
                return failed(f"an obstacle stands in the way after {how_far}: remove it")
            if not free:
                return Progress(text=f"an obstacle stands in the way after {how_far}", impeded=True)
            if abs(remaining) > _EXACT:
                base.drive(step.velocity(remaining, dt))
                number = self._count - len(self._steps) + 1
                text = f"step {number} of {self._count}: {how_far}"
                return Progress(text=text, impeded=blocked)
            self._steps.popleft()
            self._start = None
        return Progress(done=True, text=f"{self._count} of {self._count} steps done")

    def _way_is_free(self, chassis: Chassis) -> bool:
        """Whether the present step can go on without coming too near to an obstacle."""
        step = self._steps[0] if self._steps else None
        if not isinstance(step, Shift) or self._start is None:
            return True
        remaining = step.remaining(self._start, chassis.base.odometry)
        backwards = math.pi if remaining < 0.0 else 0.0
        return way_is_free(chassis, step.direction + backwards, abs(remaining))

    def hold(self, chassis: Chassis) -> None:
        """See `Job.hold`."""
        self._blocked_for = 0.0
