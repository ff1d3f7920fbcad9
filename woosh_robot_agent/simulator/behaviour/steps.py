"""The job that makes steps: straight moves and turns, measured by odometry."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from woosh_robot_agent.pb.util import action_pb2 as util_action_pb2
from woosh_robot_agent.simulator.behaviour.forward_clearance import is_clear
from woosh_robot_agent.simulator.behaviour.jobs import Progress, failed
from woosh_robot_agent.simulator.behaviour.robot import Robot
from woosh_robot_agent.simulator.body.base import (
    ACCELERATION,
    ANGULAR_ACCELERATION,
    Velocity,
    approach,
)
from woosh_robot_agent.simulator.body.devices import Device
from woosh_robot_agent.simulator.world.geometry import Pose

_OBSTACLE_TIMEOUT = 5.0
"""Time after which the job gives up if an obstacle stays in the way, in seconds."""

_TOLERANCE = 1e-6
"""Distance or angle at which a step counts as done, in metres or radians."""


@dataclass(frozen=True, slots=True)
class Shift:
    """A straight move without turning.

    Attributes:
        direction: Direction from straight ahead, counter-clockwise, in radians.
        distance: Distance in metres, negative for the opposite direction.
        speed: Speed, in m/s.
    """

    direction: float
    distance: float
    speed: float

    def remaining(self, start: Pose, now: Pose) -> float:
        """Return the remaining signed distance, in metres."""
        heading = start.theta + self.direction
        travelled = (now.x - start.x) * math.cos(heading) + (now.y - start.y) * math.sin(heading)
        return self.distance - travelled

    def velocity(self, remaining: float, dt: float) -> Velocity:
        """Return the velocity for the next `dt` seconds."""
        speed = approach(remaining, self.speed, ACCELERATION, dt)
        return Velocity(speed * math.cos(self.direction), speed * math.sin(self.direction))

    def describe(self, remaining: float) -> str:
        """Return the progress as a text."""
        return f"{self.distance - remaining:.2f} of {self.distance:.2f} m"


@dataclass(frozen=True, slots=True)
class Turn:
    """A turn on the spot.

    Attributes:
        angle: Angle in radians, negative for clockwise. It may exceed a full turn.
        speed: Turn rate, in rad/s.
    """

    angle: float
    speed: float

    def remaining(self, start: Pose, now: Pose) -> float:
        """Return the remaining signed angle, in radians."""
        return self.angle - (now.theta - start.theta)

    def velocity(self, remaining: float, dt: float) -> Velocity:
        """Return the velocity for the next `dt` seconds."""
        return Velocity(turn=approach(remaining, self.speed, ANGULAR_ACCELERATION, dt))

    def describe(self, remaining: float) -> str:
        """Return the progress as a text."""
        return f"{self.angle - remaining:.2f} of {self.angle:.2f} rad"


class Steps:
    """Makes steps one after the other.

    Args:
        steps: At least one step.
        avoid: Stop before an obstacle and wait some seconds for it to go away. Otherwise drive
            until the base touches it, and fail at once.
        kind: The `woosh.action.Type` in reports.
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
        """Remaining steps, the current one first."""
        self._count = len(self._steps)
        """Number of all steps."""
        self._start: Pose | None = None
        """Pose in the odometry at the start of the current step, None before it has started."""
        self._blocked_for = 0.0
        """Time for which an obstacle has been in the way, in seconds."""
        self._avoid = avoid
        self._timeout = _OBSTACLE_TIMEOUT if avoid else 0.0
        """Time after which an obstacle in the way makes the job fail, in seconds."""

    def tick(self, robot: Robot, dt: float) -> Progress:
        base = robot.base
        free = not self._avoid or self._clear_ahead(robot)
        blocked = base.blocked or not free
        self._blocked_for = self._blocked_for + dt if blocked else 0.0
        while self._steps:
            step = self._steps[0]
            self._start = self._start or base.odometry
            remaining = step.remaining(self._start, base.odometry)
            how_far = step.describe(remaining)
            obstacle = f"an obstacle stands in the way after {how_far}"
            if self._blocked_for > self._timeout:
                return failed(f"{obstacle}: remove it")
            if not free:
                return Progress(text=obstacle, impeded=True)
            if abs(remaining) > _TOLERANCE:
                base.drive(step.velocity(remaining, dt))
                number = self._count - len(self._steps) + 1
                text = f"step {number} of {self._count}: {how_far}"
                return Progress(text=text, impeded=blocked)
            self._steps.popleft()
            self._start = None
        return Progress(done=True, text=f"{self._count} of {self._count} steps done")

    def _clear_ahead(self, robot: Robot) -> bool:
        """Return True if no obstacle is in the way of the current step."""
        step = self._steps[0] if self._steps else None
        if not isinstance(step, Shift) or self._start is None:
            return True
        remaining = step.remaining(self._start, robot.base.odometry)
        backwards = math.pi if remaining < 0.0 else 0.0
        return is_clear(robot, step.direction + backwards, abs(remaining))

    def suspend(self, robot: Robot) -> None:
        """Reset the timeout for obstacles."""
        self._blocked_for = 0.0
