"""The job that moves a lift."""

from __future__ import annotations

import math

from woosh_robot_agent.pb.util import action_pb2 as util_action_pb2
from woosh_robot_agent.simulator.behaviour.jobs import Progress
from woosh_robot_agent.simulator.behaviour.robot import Robot
from woosh_robot_agent.simulator.body.lift import Lift


class MoveLift:
    """Moves a lift to one height after the other.

    Args:
        lift: The lift.
        heights: Heights, in metres.
        speed: Speed in m/s, of either sign; 0 for the default of the lift.
    """

    kind = util_action_pb2.kCarry

    def __init__(self, lift: Lift, *heights: float, speed: float = 0.0) -> None:
        self.device = lift.device
        self._lift = lift
        self._heights = list(heights)
        self._speed = abs(speed) or lift.default_speed

    def tick(self, robot: Robot, dt: float) -> Progress:
        if not robot.readiness.motors_on:
            return Progress(text=f"at {self._lift.height:.3f} m")
        distance = self._heights[0] - self._lift.height if self._heights else 0.0
        if self._heights and abs(distance) <= self._speed * dt:
            self._lift.height = self._heights.pop(0)
        else:
            self._lift.height += math.copysign(self._speed * dt, distance)
        return Progress(done=not self._heights, text=f"at {self._lift.height:.3f} m")

    def suspend(self, robot: Robot) -> None:
        """Do nothing: the lift stays where it is."""
