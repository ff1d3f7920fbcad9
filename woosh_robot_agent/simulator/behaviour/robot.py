"""What jobs, tasks and actions use of the robot, and what a job is."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from google.protobuf.message import Message

from woosh_robot_agent.pb.robot import robot_pb2
from woosh_robot_agent.pb.util import action_pb2 as util_action_pb2
from woosh_robot_agent.simulator.body.base import ACCELERATION, Base
from woosh_robot_agent.simulator.body.devices import Battery, Device, Lift
from woosh_robot_agent.simulator.body.readiness import Readiness
from woosh_robot_agent.simulator.body.statistics import Codes, Statistics
from woosh_robot_agent.simulator.profile import Profile
from woosh_robot_agent.simulator.scenes.scene import Scene
from woosh_robot_agent.simulator.world.collision import Obstacles
from woosh_robot_agent.simulator.world.geometry import Outline, Pose
from woosh_robot_agent.simulator.world.laser import Laser
from woosh_robot_agent.simulator.world.maps import Map


class Robot(Protocol):
    """The parts of the robot that behaviours use."""

    @property
    def profile(self) -> Profile:
        """How a robot of this model behaves."""

    @property
    def chance(self) -> random.Random:
        """Random number generator for everything that varies."""

    @property
    def answer_delay(self) -> float:
        """Time until the current request is answered, in seconds."""

    @property
    def state_first(self) -> bool:
        """True if the changes that the current request causes are pushed before its answer."""

    @property
    def robot_id(self) -> int:
        """Number of the robot."""

    @property
    def time(self) -> float:
        """Simulated Unix time, in seconds."""

    @property
    def elapsed(self) -> float:
        """Simulated time since the start, in seconds."""

    @property
    def base(self) -> Base:
        """The driven base."""

    @property
    def battery(self) -> Battery:
        """The battery."""

    @property
    def jack(self) -> Lift:
        """The lift that carries goods."""

    @property
    def readiness(self) -> Readiness:
        """Modes and conditions."""

    @property
    def occupied(self) -> bool:
        """True if a client has reserved the robot."""

    @property
    def setting(self) -> robot_pb2.Setting:
        """Current settings."""

    @property
    def outline(self) -> Outline:
        """Outline of the robot with the footprint in use."""

    @property
    def map(self) -> Map:
        """Current map."""

    @property
    def scene(self) -> Scene:
        """Current scene."""

    @property
    def scenes(self) -> dict[str, Scene]:
        """Known scenes, by name."""

    @property
    def ground_truth(self) -> Map:
        """The hall in which the robot is, with its real walls."""

    @property
    def laser(self) -> Laser:
        """The laser."""

    @property
    def scan_time(self) -> float:
        """Simulated time of the last scan of the laser, in seconds."""

    @property
    def scan_pose(self) -> Pose:
        """Pose of the robot at this scan."""

    @property
    def obstacles(self) -> Obstacles:
        """Obstacles that are not in the map."""

    @property
    def codes(self) -> Codes:
        """Status codes."""

    @property
    def statistics(self) -> Statistics:
        """Records of what the robot did."""

    def at_charger(self) -> bool:
        """Return True if the robot stands at a charger."""

    def scan(self) -> list[float]:
        """Return the ranges of one scan of the laser, in metres."""

    def enter(self, scene: Scene, area: Map) -> None:
        """Switch to another scene or map while there is no task. The coordinates stay the same."""

    def change_map(self, area: Map) -> None:
        """Replace the current map by a changed one of the same name."""

    def after(self, delay: float, call: Callable[[], object]) -> None:
        """Schedule a call in `delay` seconds of simulated time, or call now if that is 0."""

    def emit(self, event: Message) -> None:
        """Send a message to all its subscribers. It must not be modified afterwards."""


class DelayedCalls:
    """Calls that are due later and can be cancelled together.

    Args:
        robot: Schedules the calls.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._cancellations = 0
        """Number of calls of `cancel_all`."""

    def add(self, delay: float, call: Callable[[], object]) -> None:
        """Schedule a call in `delay` seconds of simulated time, or call now if that is 0."""
        cancellations = self._cancellations

        def call_unless_cancelled() -> None:
            if self._cancellations == cancellations:
                call()

        self._robot.after(delay, call_unless_cancelled)

    def cancel_all(self) -> None:
        """Cancel the calls that are not yet due."""
        self._cancellations += 1


_STOP_GAP = 0.3
"""Gap between the outline of a stopped robot and the obstacle, in metres."""

_SIDE_GAP = 0.05
"""Gap between the outline and obstacles beside the path, in metres."""

_TOLERANCE = 5e-3
"""Tolerance for obstacles that are already too close, in metres."""


def is_clear(robot: Robot, direction: float, distance: float) -> bool:
    """Return True if the base can go on without coming too close to an obstacle.

    Args:
        robot: The robot.
        direction: Direction of the motion from straight ahead, in radians.
        distance: Length of the motion, in metres. Obstacles further away are ignored.
    """
    obstacles = robot.obstacles.walls
    if not obstacles:
        return True
    cos, sin = math.cos(direction), math.sin(direction)
    outline = robot.outline
    front = max(x * cos + y * sin for x, y in outline)
    half_width = max(y * cos - x * sin for x, y in outline) + _SIDE_GAP
    braking = robot.base.velocity.speed**2 / (2.0 * ACCELERATION)
    # The checked area is a corridor with a round end of the same width.
    length = min(distance, max(0.0, braking + front + _STOP_GAP - half_width))
    here = robot.base.pose
    there = here.moved(length * cos, length * sin, 0.0).point
    for wall in obstacles:
        # The robot may move away from an obstacle that is already too close.
        limit = min(half_width, wall.distance(*here.point) - _TOLERANCE)
        if wall.line_distance(here.point, there) < limit:
            return False
    return True


@dataclass(frozen=True, slots=True)
class Progress:
    """The progress of a job.

    Attributes:
        done: The job has ended, successfully or not.
        failure: Reason of the failure; empty if the job did not fail.
        text: Description of the progress, for reports.
        impeded: An obstacle blocks the job at the moment; `text` describes it.
    """

    done: bool = False
    failure: str = ""
    text: str = ""
    impeded: bool = False


class Job(Protocol):
    """Something that the robot does over time.

    Attributes:
        device: Device that the job owns while it runs.
        kind: The `woosh.action.Type` in reports about the job.
    """

    device: Device
    kind: util_action_pb2.Type

    def tick(self, robot: Robot, dt: float) -> Progress:
        """Work for `dt` seconds of simulated time."""

    def suspend(self, robot: Robot) -> None:
        """Prepare for a pause: the next tick may come later and at another place, or never."""


def failed(reason: str) -> Progress:
    """Return the progress of a job that failed."""
    return Progress(done=True, failure=reason)


class Done:
    """Ends at once, because everything was done before it started.

    Args:
        text: Text of its report.
    """

    device = Device.NONE
    kind = util_action_pb2.kTypeUndefined

    def __init__(self, text: str) -> None:
        self._text = text

    def tick(self, robot: Robot, dt: float) -> Progress:
        return Progress(done=True, text=self._text)

    def suspend(self, robot: Robot) -> None:
        """Do nothing: the job ends in its first tick."""


class Wait:
    """Waits for a time in seconds, which may be infinite, or until `end` is called."""

    device = Device.NONE
    kind = util_action_pb2.kWait

    def __init__(self, seconds: float) -> None:
        self._left = seconds
        """Remaining time, in seconds."""

    def tick(self, robot: Robot, dt: float) -> Progress:
        self._left -= dt
        if self._left == math.inf:
            return Progress(text="waiting for the order to continue")
        return Progress(done=self._left <= 0.0, text=f"{max(0.0, self._left):.0f} s left to wait")

    def suspend(self, robot: Robot) -> None:
        """Do nothing: the remaining time is kept."""

    def end(self) -> None:
        """End the wait at the next tick."""
        self._left = 0.0
