"""The robot and its surroundings, e.g. base, battery and map, without behaviour."""

from __future__ import annotations

import random
from dataclasses import replace
from typing import Any

from woosh_robot_agent.data_files import DataFileError
from woosh_robot_agent.pb.robot import robot_count_pb2, robot_pb2, robot_setting_pb2
from woosh_robot_agent.pb.util import robot_pb2 as util_robot_pb2
from woosh_robot_agent.simulator import refusals
from woosh_robot_agent.simulator.body.base import Base, displacement
from woosh_robot_agent.simulator.body.code_log import CodeLog
from woosh_robot_agent.simulator.body.devices import Battery, Device, Lift, Readiness
from woosh_robot_agent.simulator.config import SimulatorConfig
from woosh_robot_agent.simulator.profile import load_profile
from woosh_robot_agent.simulator.refusals import RefusedError
from woosh_robot_agent.simulator.scenes import files
from woosh_robot_agent.simulator.scenes.scene import Scene, with_map_changed
from woosh_robot_agent.simulator.timeline import ROUNDING, Timeline
from woosh_robot_agent.simulator.world.geometry import (
    Outline,
    Pose,
    Wall,
    footprints,
    hull,
    outer_radius,
)
from woosh_robot_agent.simulator.world.maps import Map, Mark, MarkKind, Obstacles
from woosh_robot_agent.simulator.world.planner import PATH_MARGIN

_DOCK_SHARES = (1.0, 0.8, 0.6, 0.4, 0.2)
"""Shares of the usual docking distance, tried in this order until one has enough room."""

_CHARGER_DISTANCE = 0.3
"""Maximum distance to a charger at which the robot can charge, in metres."""


class Robot(Timeline):
    """The robot and its surroundings. Behaviours act on this object.

    Attributes:
        profile: behaviour of this robot model.
        omnidirectional: True if the base can move sideways.
        rng: random number generator for everything that varies, e.g. answer times.
        answer_delay: time until the current request is answered, in seconds. The handler of the
            request may change it.
        state_first: True if the states that the current request changes are pushed before its
            answer, not after it.
        scenes: known scenes, by name.
        scene: current scene.
        map: current map.
        obstacles: obstacles that are not in the map.
        jack: the lift of LiftControl, which carries goods.
        column: the lift of LiftControl2 and LiftControl3.
        readiness: modes and conditions that decide whether the robot may move by itself.
        occupied: True if a client has reserved the robot.
        scan_time: simulated time of the last scan of the laser, in seconds.
        scan_pose: pose of the robot at the last scan.
        pushed_scan_time: simulated time of the last scan that subscribers get, in seconds. They get
            only some of the scans.
        footprint: the `woosh.robot.FootPrint` in use.
        footprints: outlines of the robot by `woosh.robot.FootPrint`.
        setting: settings, as reported to clients.
        codes: the log of status codes.
    """

    def __init__(self, config: SimulatorConfig) -> None:
        super().__init__(config.robot_id, config.start_time(), config.clock_offset)
        self.profile = load_profile(config.profile)
        self.omnidirectional = config.omnidirectional
        self._seed = random.randrange(2**32) if config.seed is None else config.seed
        """Seed of `rng` and of the laser noise, which append different texts to it."""
        self.rng = random.Random(f"{self._seed}:chance")
        self.answer_delay = 0.0
        self.state_first = False

        self.scenes, self.scene = files.known_scenes(config.scenes)
        self.map, start = files.start_place(self.scene)
        self.obstacles = Obstacles()

        driving = self.profile.driving
        # The odometer, the charge of the battery and the settings have arbitrary initial values.
        self.base = Base(
            start,
            odometer=1204.0,
            rolls_for=driving.rolls_for,
            stops_below=driving.stops_below,
            max_speed=driving.max_speed,
            max_turn_rate=driving.max_turn_rate,
        )
        self.laser = self.profile.laser
        self.scan_pose = start
        self.scan_time = 0.0
        self.pushed_scan_time = 0.0
        self._ranges: list[float] = []
        """Ranges of the last scan, in metres; empty until `scan` computes them."""
        self.battery = Battery(93.0, self.profile.battery)
        self.jack = Lift("lift", Device.JACK, travel=0.06, default_speed=0.02)
        self.column = Lift("lift column", Device.COLUMN, travel=1.0, default_speed=0.2)
        self.readiness = Readiness(initialised=config.initialised, located=config.initialised)
        self.occupied = False
        self.footprint: util_robot_pb2.FootPrint = util_robot_pb2.kOriginal
        self.footprints = footprints(self.profile.model.outline)
        self.setting = robot_pb2.Setting(
            robot_id=self.robot_id,
            identity=robot_setting_pb2.Identity(name=str(self.robot_id)),
            server=robot_setting_pb2.Server(ip="172.20.8.85", port=5420),
            power=robot_setting_pb2.Power(alarm=5, low=20, idle=80, full=98),
            sound=robot_setting_pb2.Sound(mute=False, volume=50),
            allow=robot_pb2.Setting.Allow(auto_charge=True, auto_park=True, goods_check=True),
        )

        language = config.code_language or self.profile.status_codes.language
        self.codes = CodeLog(language, self.publish_code)

        if not self.can_stand(start):
            raise DataFileError(
                f"scene {self.scene.name}: the robot cannot start at {start} on map "
                f"{self.map.name}, which is not free floor: name another pose under start"
            )

    @property
    def outline(self) -> Outline:
        """Outline of the robot with the footprint in use."""
        return self.footprints[self.footprint]

    @property
    def ground_truth(self) -> Map:
        """The current map with its real walls, also if the robot has made the map itself."""
        return self.map.ground_truth or self.map

    @property
    def walls(self) -> tuple[Wall, ...]:
        """The real walls around the robot, and the sides of the obstacles."""
        return self.ground_truth.walls + self.obstacles.walls

    @property
    def pose(self) -> Pose:
        """Pose at this moment, also between two steps of the motion."""
        base, dt = self.base, self.elapsed - self.stepped
        return base.pose.moved(*displacement(base.velocity, dt)) if base.moving else base.pose

    def publish_code(self, status: robot_count_pb2.StatusCode) -> None:
        """Add the robot's id and time to a new status code, and send it to the clients."""
        status.robot_id = self.robot_id
        status.time = round(self.time * 1000)
        self.emit(status)

    def gap(self, pose: Pose) -> float:
        """Return the gap between the robot at `pose` and walls and obstacles, in metres.

        It is negative if they overlap.
        """
        shape = hull(self.outline)
        return min(self.ground_truth.gap(shape, pose), shape.gap(pose, self.obstacles.walls))

    def can_stand(self, pose: Pose) -> bool:
        """Return True if a pose is in the mapped area, and no wall or obstacle is in the way."""
        return self.map.contains(*pose.point) and self.gap(pose) >= 0.0

    def require_room(self, pose: Pose) -> None:
        """Raise RefusedError unless the robot can stand at a pose of the map."""
        if not self.map.contains(*pose.point):
            raise RefusedError(refusals.POSE_OUTSIDE_MAP, pose=pose, map=self.map.name)
        if self.gap(pose) < 0.0:
            raise RefusedError(
                f"pose {pose} is inside a wall of map {self.map.name}: choose one on free floor"
            )

    def switch_map(self, scene: Scene, area: Map) -> None:
        """Store a scene, and make one of its maps the current map. No task may be running.

        The pose of the robot stays. A robot that cannot stand there has lost its localisation.
        """
        self.scenes[scene.name] = scene
        self.scene, self.map = scene, area
        if not self.can_stand(self.base.pose):
            self.readiness.located = False

    def replace_scene(self, old: Scene | None, new: Scene, current_map: str = "") -> None:
        """Store a new scene, or replace a scene.

        Args:
            old: the scene to replace, None for a new scene.
            new: the scene to store. It may have another name than the old scene.
            current_map: name that the current map has in `new`, if `old` is the current scene;
                empty if the map keeps its name.
        """
        if old is self.scene:
            area = new.map(current_map or self.map.name)
            assert area is not None
            if area.same_ground(self.map):  # only its name or its marks have changed
                self.scenes[new.name] = self.scene = new
                self.map = area
            else:
                self.switch_map(new, area)
        else:
            self.scenes[new.name] = new
        if old and old.name != new.name:
            del self.scenes[old.name]

    def change_map(self, **changes: Any) -> None:
        """Replace the current map by its next version, in which some attributes have changed."""
        area = replace(self.map, version=self.map.version + 1, **changes)
        self.replace_scene(self.scene, with_map_changed(self.scene, self.map, area))

    def nearest_mark(self, kind: MarkKind) -> Mark | None:
        """Return the nearest mark of a kind on the current map, None if there is none."""
        marks = [mark for mark in self.map.marks.values() if mark.kind is kind]
        return min(marks, key=lambda mark: self.pose.distance(mark.pose.point), default=None)

    @property
    def charger(self) -> Mark | None:
        """The charger at which the robot stands; None if it stands elsewhere."""
        chargers = (mark for mark in self.map.marks.values() if mark.kind is MarkKind.CHARGER)
        for charger in chargers:
            if self.base.pose.distance(charger.pose.point) <= _CHARGER_DISTANCE:
                return charger
        return None

    def dock_distance(self, mark: Mark) -> float:
        """Return the distance from a mark at which docking starts, in metres.

        It is less than usual if walls are near, and 0 if no distance has enough room.
        """
        usual = self.profile.charging.docking_distance
        needed = outer_radius(self.outline) + PATH_MARGIN
        for share in _DOCK_SHARES:
            start = mark.pose.moved(-share * usual, 0.0, 0.0).point
            if self.map.contains(*start) and self.map.clearance(*start) >= needed:
                return share * usual
        return 0.0

    def scan(self) -> list[float]:
        """Return the ranges of the last scan of the laser, in metres."""
        self.begin_due_scan()
        if not self._ranges:
            # The noise depends on the time, not on the number of scans: equal seeds give equal
            # scans.
            rng = random.Random(f"{self._seed}:{self.scan_time:.3f}")
            self._ranges = self.laser.scan(self.scan_pose, self.walls, rng, self.ground_truth.grid)
        return self._ranges

    def begin_due_scan(self) -> None:
        """Begin a new scan of the laser if it is due."""
        rates = self.profile.rates
        if self.stepped - self.scan_time >= rates.scan - ROUNDING:
            self.scan_time, self.scan_pose, self._ranges = self.stepped, self.base.pose, []
            if self.scan_time - self.pushed_scan_time >= rates.scan_push - ROUNDING:
                self.pushed_scan_time = self.scan_time
