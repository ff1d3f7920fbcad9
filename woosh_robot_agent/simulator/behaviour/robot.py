"""The interface of the robot that jobs, tasks and actions use."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Protocol

from google.protobuf.message import Message

from woosh_robot_agent.pb.robot import robot_pb2
from woosh_robot_agent.simulator.body.base import Base
from woosh_robot_agent.simulator.body.battery import Battery
from woosh_robot_agent.simulator.body.codes import Codes
from woosh_robot_agent.simulator.body.lift import Lift
from woosh_robot_agent.simulator.body.readiness import Readiness
from woosh_robot_agent.simulator.profile import Profile
from woosh_robot_agent.simulator.scenes.scene import Scene
from woosh_robot_agent.simulator.world.footprints import Outline
from woosh_robot_agent.simulator.world.geometry import Pose
from woosh_robot_agent.simulator.world.laser import Laser
from woosh_robot_agent.simulator.world.maps import Map
from woosh_robot_agent.simulator.world.obstacles import Obstacles


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
