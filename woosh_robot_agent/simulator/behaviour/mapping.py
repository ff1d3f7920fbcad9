"""Making maps, and collecting marks for them, while a client drives.

Methods that execute a request raise `RefusedError` if the robot cannot do that now, or never.
"""

from __future__ import annotations

import dataclasses
import logging
import math
from enum import Enum
from functools import partial
from typing import TYPE_CHECKING

from woosh_robot_agent.pb.util import robot_pb2 as util_robot_pb2
from woosh_robot_agent.simulator import refusals
from woosh_robot_agent.simulator.refusals import Refusal, RefusedError
from woosh_robot_agent.simulator.robot import Robot
from woosh_robot_agent.simulator.scenes.files import MAX_SCENES
from woosh_robot_agent.simulator.scenes.robot_files import MAX_MAPS
from woosh_robot_agent.simulator.scenes.scene import (
    MAX_NAME,
    Scene,
    free_id,
    is_plain,
    with_map,
    with_map_changed,
)
from woosh_robot_agent.simulator.timeline import ROUNDING, DelayedCalls
from woosh_robot_agent.simulator.world.geometry import Pose
from woosh_robot_agent.simulator.world.maps import Map, Mark

if TYPE_CHECKING:  # numpy, scipy and Pillow load slowly, and only mapping needs them
    from woosh_robot_agent.simulator.world.grid import Grid
    from woosh_robot_agent.simulator.world.growing_grid import GrowingGrid, Raster

_LOG = logging.getLogger(__name__)

_SCAN_PERIOD = 0.2
"""Minimum time between two scans that are added to the map, in seconds."""

_REST_PERIOD = 1.0
"""Minimum time between two such scans while the robot stands, in seconds."""

_MIN_DISTANCE, _MIN_ANGLE = 0.02, 0.02
"""Motion between two scans below which the robot counts as standing, in metres and radians."""


def require_name(field: str, name: str) -> None:
    """Raise RefusedError if the `name` in a request's `field` is empty, too long, or a path."""
    if not name:
        raise RefusedError(refusals.NO_NAME, field=field)
    if not is_plain(name):
        raise RefusedError(
            f"{field} {name[:MAX_NAME]!r} must be a name of at most {MAX_NAME} characters that is "
            "not a path"
        )


class Phase(Enum):
    """Phase of the mapping. The value is the part of a refusal's text that names the phase."""

    NONE = "is not running"
    STARTING = "is being started"
    RUNNING = "is running"
    SAVING = "is being saved"
    CANCELLING = "is being cancelled"


class MapBuilder:
    """Makes maps, and collects marks for them.

    The robot still localises itself while it makes a map, and the new map has the frame of the
    current map. After saving or cancelling, the robot has to be initialised.

    Attributes:
        draft: the new map with the marks collected so far, but without cells. None if no map is
            being made, or the current map is being updated.
        picture_time: simulated time at which the last picture of the map was due, in seconds; 0
            before the first.
    """

    def __init__(self, robot: Robot) -> None:
        self.draft: Map | None = None
        self.picture_time = 0.0
        self._robot = robot
        self._profile = robot.profile.mapping
        self._pictures = DelayedCalls(robot)
        """The next call of `_request_picture`; none unless the mapping is running."""
        self._phase = Phase.NONE
        self._scene_name = self._map_name = ""
        """Names of the map that is or was last being made, and of its scene; empty at first."""
        self._grid: GrowingGrid | None = None
        """Cells of the map, from the first scan to the end of the mapping; else None."""
        self._located_before = True
        """True if the robot knew its pose before the mapping."""
        self._added_time = -math.inf
        """Simulated time of the last scan that was added, in seconds; -inf before the first."""
        self._added_pose = Pose()
        """Pose of the robot at the last scan that was added."""

    @property
    def active(self) -> bool:
        """True from the first scan of the mapping until it has been saved or cancelled."""
        return self._phase in (Phase.RUNNING, Phase.SAVING, Phase.CANCELLING)

    @property
    def raster(self) -> Raster | None:
        """The map so far; None unless the mapping is running."""
        return self._grid.raster() if self._grid and self._phase is Phase.RUNNING else None

    def require_none(self, refusal: Refusal) -> None:
        """Raise `refusal`, which may use the values `map` and `phase`, if a map is being made."""
        if self._phase is not Phase.NONE:
            raise RefusedError(refusal, map=self._map_name, phase=self._phase.value)

    def add(self, scene_name: str, map_name: str) -> float:
        """Begin to make a new map; return the time until the answer to the request, in seconds.

        The scene may be a new one.
        """
        self._require_startable(scene_name, map_name)
        self._require_new(scene_name, map_name)
        return self._start(scene_name, map_name, update=False)

    def update(self, scene_name: str, map_name: str) -> float:
        """Begin to continue the current map; return the time until the answer, in seconds."""
        self._require_startable(scene_name, map_name)
        scenes, scene = self._robot.scenes, self._robot.scenes.get(scene_name)
        if scene is None:
            known = ", ".join(scenes)
            raise RefusedError(refusals.UPDATE_UNKNOWN_SCENE, scene=scene_name, scenes=known)
        if scene.map(map_name) is None:
            known = ", ".join(each.name for each in scene.maps)
            raise RefusedError(
                refusals.UPDATE_UNKNOWN_MAP, scene=scene_name, map=map_name, maps=known
            )
        if (scene_name, map_name) != (self._robot.scene.name, self._robot.map.name):
            raise RefusedError(refusals.UPDATE_OTHER_MAP, scene=scene_name, map=map_name)
        self._robot.readiness.require_located()
        return self._start(scene_name, map_name, update=True)

    def save(self) -> float:
        """Begin to save the map; return the time until the answer to the request, in seconds.

        Raises:
            RefusedError: the robot cannot save now. The mapping goes on.
        """
        self._require_running()
        self._require_modes(refusals.SAVE_OUTSIDE_DEPLOYMENT)
        if not self._robot.readiness.located:
            raise RefusedError(refusals.SAVE_WHILE_LOST)
        if self.draft:
            self._require_new(self._scene_name, self._map_name)
        robot, profile = self._robot, self._profile
        duration = profile.save.sample(robot.rng)
        use_map = partial(self._use_map, self._current_grid(), self.draft, robot.base.pose)
        self._phase = Phase.SAVING
        self._pictures.cancel_all()
        robot.after(min(profile.scene_after, duration), use_map)
        robot.after(duration, self._end)
        return duration

    def cancel(self) -> float:
        """Begin to discard the map; return the time until the answer to the request, in seconds."""
        self._require_running()
        robot = self._robot
        duration = self._profile.cancel.sample(robot.rng)
        self._phase = Phase.CANCELLING
        self._pictures.cancel_all()
        self.draft = None
        robot.after(duration, self._end)
        return duration

    def collect_mark(self, pose: Pose | None) -> Mark:
        """Add a mark to the new map that is being made, or else to the current map; return it.

        Args:
            pose: pose of the mark; None for the pose of the robot.
        """
        robot = self._robot
        if robot.readiness.work != util_robot_pb2.kDeployMode:
            raise RefusedError(refusals.COLLECTING_OUTSIDE_DEPLOYMENT)
        self._require_settled()
        if not robot.readiness.located:
            raise RefusedError(refusals.LOCALISATION_LOST)
        area = self.draft or robot.map
        if pose is None:
            pose = robot.base.pose
        elif not self.draft and not area.contains(*pose.point):
            raise RefusedError(refusals.POSE_OUTSIDE_MAP, pose=pose, map=area.name)
        # The answer has only the id, so the mark's number, which tasks name, equals the id.
        numbers = {int(number) for number in area.marks if number.isdecimal()}
        id_ = free_id(numbers.union(mark.id for mark in area.marks.values()))
        mark = Mark(id_, str(id_), pose)
        marks = {**area.marks, mark.number: mark}
        if self.draft:
            self.draft = dataclasses.replace(self.draft, marks=marks)
        else:
            robot.change_map(marks=marks)
        return mark

    def tick(self) -> None:
        """Add the current scan to the map if it is due.

        Do nothing unless the mapping is running and the robot knows its pose.
        """
        grid, robot = self._grid, self._robot
        if grid is None or self._phase is not Phase.RUNNING or not robot.readiness.located:
            return
        pose, before = robot.scan_pose, self._added_pose
        elapsed = robot.scan_time - self._added_time
        turned = abs(math.remainder(pose.theta - before.theta, math.tau))
        stands = pose.distance(before.point) < _MIN_DISTANCE and turned < _MIN_ANGLE
        if elapsed < (_REST_PERIOD if stands else _SCAN_PERIOD) - ROUNDING:
            return
        self._added_time, self._added_pose = robot.scan_time, pose
        laser = robot.laser
        was_full = grid.full
        origin = pose.moved(laser.forward, 0.0, 0.0)
        grid.add_scan(origin, laser.angle_min, laser.increment, robot.scan())
        # The laser does not see the floor under the robot.
        grid.add_floor([pose.moved(x, y, 0.0).point for x, y in robot.outline])
        if grid.full and not was_full:
            _LOG.warning("map %s is full: its outer parts are not recorded", self._map_name)

    def _require_startable(self, scene_name: str, map_name: str) -> None:
        """Raise RefusedError if no mapping can start now, or a name cannot be used."""
        self._require_modes(refusals.MAPPING_OUTSIDE_DEPLOYMENT)
        self._require_settled()
        self.require_none(refusals.MAPPING_RUNS)
        require_name("scene_name", scene_name)
        require_name("map_name", map_name)

    def _require_settled(self) -> None:
        """Raise RefusedError while a mapping is being started, saved or cancelled."""
        if self._phase not in (Phase.NONE, Phase.RUNNING):
            self.require_none(refusals.MAPPING_CHANGES)

    def _require_running(self) -> None:
        """Raise RefusedError unless a mapping is running.

        One that is being started, saved or cancelled does not count.
        """
        if self._phase is Phase.NONE:
            raise RefusedError(
                "no map is being made: send BuildMap with type 1 (add) or 2 (update) first"
            )
        self._require_settled()

    def _require_modes(self, refusal: Refusal) -> None:
        """Raise `refusal` unless the robot is in deployment mode and automatic control."""
        readiness = self._robot.readiness
        automatic = readiness.control == util_robot_pb2.kAuto
        if not automatic or readiness.work != util_robot_pb2.kDeployMode:
            raise RefusedError(refusal)

    def _require_new(self, scene_name: str, map_name: str) -> None:
        """Raise RefusedError if a map of this name cannot be added."""
        scenes = self._robot.scenes
        scene = scenes.get(scene_name)
        if scene is None:
            if len(scenes) >= MAX_SCENES:
                raise RefusedError(refusals.TOO_MANY_SCENES, limit=MAX_SCENES)
        elif scene.map(map_name):
            raise RefusedError(refusals.MAP_EXISTS, scene=scene_name, map=map_name)
        elif len(scene.maps) >= MAX_MAPS:
            raise RefusedError(refusals.TOO_MANY_MAPS, scene=scene_name, limit=MAX_MAPS)

    def _start(self, scene_name: str, map_name: str, *, update: bool) -> float:
        """Schedule the first scan; return the time until the answer to the request, in seconds."""
        robot, profile = self._robot, self._profile
        self._scene_name, self._map_name = scene_name, map_name
        self._phase = Phase.STARTING
        duration = profile.start.sample(robot.rng)
        # the state of the robot shows the mapping before the answer
        robot.after(min(profile.state_after, duration), partial(self._begin_scans, update=update))
        return duration

    def _begin_scans(self, *, update: bool) -> None:
        """Begin to add scans: to the current map if `update` is True, else to a new map."""
        from woosh_robot_agent.simulator.world.growing_grid import GrowingGrid
        from woosh_robot_agent.simulator.world.picture import rasterised

        robot = self._robot
        self._grid = GrowingGrid(rasterised(robot.map) if update else None)
        if not update:
            corner = (0.0, 0.0)
            self.draft = Map(0, self._map_name, robot.map.floor, 1, corner, corner, walls=())
        self._located_before = robot.readiness.located
        # A new map begins where the robot is. To continue a map, the robot must be located in it.
        robot.readiness.located = not update or self._located_before
        self._phase = Phase.RUNNING
        self._added_time = -math.inf
        self.tick()
        self._pictures.add(self._profile.picture_period, self._request_picture)

    def _request_picture(self) -> None:
        """Make a picture of the map due, which is then pushed, and schedule the next one."""
        self.picture_time = self._robot.elapsed
        self._pictures.add(self._profile.picture_period, self._request_picture)

    def _current_grid(self) -> Grid:
        """Return the cells of the map so far; an updated map keeps its keep-out cells."""
        from woosh_robot_agent.simulator.world.grid import Grid

        assert self._grid
        raster = self._grid.raster()
        old = None if self.draft else self._robot.map.grid
        keep_out = old.keep_out_on(raster) if old else None
        return Grid(raster.cells, raster.resolution, raster.low, keep_out)

    def _use_map(self, grid: Grid, draft: Map | None, end: Pose) -> None:
        """Store the finished map in its scene, and switch to it.

        Args:
            grid: cells of the map.
            draft: the new map without cells; None for an update of the current map.
            end: pose of the robot when the saving began.
        """
        robot = self._robot
        area = dataclasses.replace(
            draft or robot.map,
            low=grid.low,
            high=grid.high,
            walls=(),  # the cells show them
            grid=grid,
            end=end,
            ground_truth=robot.ground_truth,
        )
        if draft:
            before = robot.scenes.get(self._scene_name) or Scene(self._scene_name, [])
            scene = with_map(before, area)
            saved = scene.map(area.name)
            assert saved
            robot.switch_map(scene, saved)
        else:
            area = dataclasses.replace(area, version=area.version + 1)
            robot.switch_map(with_map_changed(robot.scene, robot.map, area), area)
        self.draft = None

    def _end(self) -> None:
        """End the mapping. The robot has to be initialised again."""
        readiness = self._robot.readiness
        readiness.initialised = False
        if self._phase is Phase.CANCELLING:
            # The start of a new map made the pose known, but only on that map.
            readiness.located = readiness.located and self._located_before
        self._phase = Phase.NONE
        self._grid = None
