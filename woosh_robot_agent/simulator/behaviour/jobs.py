"""The base class of jobs, and all jobs except navigation: waits, steps, lifting, charging."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from woosh_robot_agent.pb.robot import robot_pb2
from woosh_robot_agent.pb.util import action_pb2 as util_action_pb2
from woosh_robot_agent.simulator.body.base import (
    ACCELERATION,
    ANGULAR_ACCELERATION,
    Velocity,
    approach,
)
from woosh_robot_agent.simulator.body.devices import Device, Lift
from woosh_robot_agent.simulator.robot import Robot
from woosh_robot_agent.simulator.timeline import ROUNDING
from woosh_robot_agent.simulator.world.geometry import Pose
from woosh_robot_agent.simulator.world.maps import Mark

_STOP_GAP = 0.3
"""Gap that a robot leaves between its outline and the obstacle before which it stops, in metres."""

_SIDE_GAP = 0.05
"""Gap that a robot needs between its outline and obstacles beside its path, in metres."""

_TOLERANCE = 5e-3
"""Distance by which a robot may get nearer to an obstacle that is already too close, in metres."""


def is_clear(robot: Robot, direction: float, distance: float) -> bool:
    """Return True if the base can drive on without coming too close to an obstacle.

    The walls of the map do not count: planned paths keep away from them.

    Args:
        direction: direction of the motion, counter-clockwise from straight ahead, in radians.
        distance: length of the motion, in metres. Obstacles further away are ignored.
    """
    cos, sin = math.cos(direction), math.sin(direction)
    outline = robot.outline
    front = max(x * cos + y * sin for x, y in outline)
    half_width = max(abs(y * cos - x * sin) for x, y in outline) + _SIDE_GAP
    braking = robot.base.velocity.speed**2 / (2.0 * ACCELERATION)
    # The checked area is a corridor whose round end reaches `half_width` beyond its length.
    length = min(distance, max(0.0, braking + front + _STOP_GAP - half_width))
    here = robot.base.pose
    there = here.moved(length * cos, length * sin, 0.0).point
    for wall in robot.obstacles.walls:
        # The robot may move away from an obstacle that is already too close.
        limit = min(half_width, wall.distance(*here.point) - _TOLERANCE)
        if wall.line_distance(here.point, there) < limit:
            return False
    return True


@dataclass(frozen=True, slots=True)
class Progress:
    """The progress of a job.

    Attributes:
        done: True if the job has ended, successfully or not.
        failure: reason of the failure; empty if the job did not fail.
        code: status code of the failure; 0 without one.
        text: description of the progress or of the obstacle, for reports; may be empty.
        impeded: True if an obstacle blocks the job now.
    """

    done: bool = False
    failure: str = ""
    code: int = 0
    text: str = ""
    impeded: bool = False


class Job(ABC):
    """Something that the robot does over time, e.g. drive to a mark. Tasks and actions have jobs.

    Attributes:
        device: device that the job owns while it runs; `NONE` if it needs none.
        kind: the `woosh.action.Type` in reports about the job.
    """

    device: Device = Device.NONE
    kind: util_action_pb2.Type = util_action_pb2.kTypeUndefined

    @abstractmethod
    def tick(self, robot: Robot, dt: float) -> Progress:
        """Work for `dt` seconds of simulated time."""

    def suspend(self, robot: Robot) -> None:  # noqa: B027 - most jobs need nothing
        """Prepare for a pause or an end: the next tick may come later, elsewhere, or never."""


def failed(reason: str, code: int = 0) -> Progress:
    """Return the progress of a job that failed."""
    return Progress(done=True, failure=reason, code=code)


class Done(Job):
    """Ends at once and reports `text`: nothing is left to do after the request."""

    def __init__(self, text: str) -> None:
        self._text = text

    def tick(self, robot: Robot, dt: float) -> Progress:
        return Progress(done=True, text=self._text)


class Wait(Job):
    """Waits for a time, or until `end` is called.

    Args:
        seconds: the time, in simulated seconds. It may be infinite.
        number: number of the wait in reports; 0 for its position among the waits of the task.
    """

    kind = util_action_pb2.kWait

    def __init__(self, seconds: float, number: int = 0) -> None:
        self.number = number
        self._left = seconds
        """Remaining time, in seconds; not positive at the end."""

    def tick(self, robot: Robot, dt: float) -> Progress:
        self._left -= dt
        if self._left == math.inf:
            return Progress(text="waiting for the order to continue")
        return Progress(done=self._left <= 0.0, text=f"{max(0.0, self._left):.0f} s left to wait")

    def end(self) -> None:
        """End the wait at the next tick."""
        self._left = 0.0


_OBSTACLE_TIMEOUT = 5.0
"""Time after which `Steps` with `avoid` fails at an obstacle that stays, in seconds."""

STEP_SPEED = 0.5
"""Default speed of steps, in m/s or rad/s."""

_STEP_TOLERANCE = 1e-6
"""Distance or angle at which a step counts as done, in metres or radians."""


@dataclass(frozen=True, slots=True)
class Shift:
    """A straight move without turning.

    Attributes:
        direction: direction from straight ahead, counter-clockwise, in radians.
        distance: distance in metres, negative for the opposite direction.
        speed: speed, in m/s.
    """

    direction: float
    distance: float
    speed: float

    def remaining(self, start: Pose, now: Pose) -> float:
        """Return the remaining distance in metres, with the sign of the motion that it needs."""
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
        angle: angle in radians, negative for clockwise. It may exceed a full turn.
        speed: maximum turn rate, in rad/s.
    """

    angle: float
    speed: float

    def remaining(self, start: Pose, now: Pose) -> float:
        """Return the remaining angle in radians, with the sign of the turn that it needs.

        The poses are from the odometry, whose angle is not wrapped, so it counts full turns.
        """
        return self.angle - (now.theta - start.theta)

    def velocity(self, remaining: float, dt: float) -> Velocity:
        """Return the velocity for the next `dt` seconds."""
        return Velocity(turn=approach(remaining, self.speed, ANGULAR_ACCELERATION, dt))

    def describe(self, remaining: float) -> str:
        """Return the progress as a text."""
        return f"{self.angle - remaining:.2f} of {self.angle:.2f} rad"


class Steps(Job):
    """Makes steps one after the other.

    Args:
        avoid: True to stop before an obstacle and wait some seconds for it to go away; False to
            drive until the base touches it, and fail at once. At a wall of the map, the base
            always drives until it touches the wall.
        kind: the `woosh.action.Type` in reports.
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
        """Odometry at the start of the current step, None before it has started.

        The odometry never jumps, unlike the pose in the map.
        """
        self._blocked_for = 0.0
        """Time for which an obstacle or a wall has been in the way, in seconds."""
        self._avoid = avoid
        self._timeout = _OBSTACLE_TIMEOUT if avoid else 0.0
        """Value of `_blocked_for` above which the job fails, in seconds."""

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
            if abs(remaining) > _STEP_TOLERANCE:
                base.drive(step.velocity(remaining, dt))
                number = self._count - len(self._steps) + 1
                text = f"step {number} of {self._count}: {how_far}"
                return Progress(text=text, impeded=blocked)
            self._steps.popleft()
            self._start = None
        return Progress(done=True, text=f"{self._count} of {self._count} steps done")

    def _clear_ahead(self, robot: Robot) -> bool:
        """Return True if no obstacle is in the way of the current step.

        Return True also for a turn, which needs no way, and for a step that has not started.
        """
        step = self._steps[0] if self._steps else None
        if not isinstance(step, Shift) or self._start is None:
            return True
        remaining = step.remaining(self._start, robot.base.odometry)
        backwards = math.pi if remaining < 0.0 else 0.0
        return is_clear(robot, step.direction + backwards, abs(remaining))

    def suspend(self, robot: Robot) -> None:
        """Reset the timeout for obstacles."""
        self._blocked_for = 0.0


class MoveLift(Job):
    """Moves a lift.

    Args:
        height: a height that the lift can reach, in metres.
        speed: speed, in m/s; 0 for the default of the lift.
    """

    kind = util_action_pb2.kCarry

    def __init__(self, lift: Lift, height: float, speed: float = 0.0) -> None:
        self.device = lift.device
        self._lift = lift
        self._goal = height
        self._speed = speed or lift.default_speed

    def tick(self, robot: Robot, dt: float) -> Progress:
        lift, step = self._lift, self._speed * dt
        if robot.readiness.motors_on:
            distance = self._goal - lift.height
            arrives = abs(distance) <= step
            lift.height = self._goal if arrives else lift.height + math.copysign(step, distance)
        return Progress(done=lift.height == self._goal, text=f"at {lift.height:.3f} m")


class Charge(Job):
    """Charges at a charger.

    With `confirmed_after` in the profile, the job ends that time after its start, and the battery
    goes on charging. Otherwise it ends when the battery is full as defined by the settings.
    """

    device = Device.CHARGER
    kind = util_action_pb2.kCharge

    def __init__(self) -> None:
        self._time = 0.0
        """Time since the job started or was resumed, in seconds."""
        self._keeps_charging = False
        """True once the job has ended and the battery goes on charging."""

    def tick(self, robot: Robot, dt: float) -> Progress:
        if robot.charger is None:
            return failed("not at a charger")
        profile = robot.profile.charging
        self._time += dt
        if self._time >= profile.starts_after - ROUNDING:
            robot.battery.charging = robot_pb2.Battery.kAuto
        if profile.confirmed_after is not None:
            self._keeps_charging = self._time >= profile.confirmed_after - ROUNDING
            return Progress(done=self._keeps_charging, text="charging")
        full = robot.setting.power.full
        if robot.battery.level >= full:
            return Progress(done=True, text=f"charged to {full} %")
        return Progress(text=f"at {robot.battery.percent} of {full} %")

    def suspend(self, robot: Robot) -> None:
        """Stop charging, unless the job has ended and the battery goes on charging."""
        self._time = 0.0
        if not self._keeps_charging:
            robot.battery.charging = robot_pb2.Battery.kNot


def leave_charger_job(robot: Robot, charger: Mark) -> Job:
    """Return the job that drives a robot out of `charger`: backwards, unless it turned there."""
    distance = robot.dock_distance(charger)
    turned = math.cos(robot.base.pose.theta - charger.pose.theta) < 0.0
    return dock_job(robot, distance if turned else -distance, util_action_pb2.kSecondposQuit)


def dock_job(robot: Robot, distance: float, kind: util_action_pb2.Type) -> Job:
    """Return the job that drives into a dock or out of it.

    Args:
        distance: distance straight ahead, in metres; negative for backwards.
        kind: the `woosh.action.Type` in reports.
    """
    return Steps(
        [Shift(0.0, distance, robot.profile.charging.docking_speed)], avoid=True, kind=kind
    )
