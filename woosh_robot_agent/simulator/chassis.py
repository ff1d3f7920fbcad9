"""The simulated robot: one consistent state, advanced in simulated time."""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Callable

from google.protobuf.message import Message

from woosh_robot_agent.data_files import DataFileError
from woosh_robot_agent.pb.device import device_pb2
from woosh_robot_agent.pb.robot import (
    robot_count_pb2,
    robot_pack_pb2,
    robot_pb2,
    robot_setting_pb2,
)
from woosh_robot_agent.pb.util import robot_pb2 as util_robot_pb2
from woosh_robot_agent.simulator import refusals, status_codes
from woosh_robot_agent.simulator.agenda import ROUNDING, Agenda
from woosh_robot_agent.simulator.behaviour.actions import Actions
from woosh_robot_agent.simulator.behaviour.auto_tasks import AutoTasks
from woosh_robot_agent.simulator.behaviour.deployment import Deployment
from woosh_robot_agent.simulator.behaviour.mapping import Mapping
from woosh_robot_agent.simulator.behaviour.ownership import Follower, Ownership, Teleop
from woosh_robot_agent.simulator.behaviour.robot import DelayedCalls
from woosh_robot_agent.simulator.behaviour.tasks import Tasks
from woosh_robot_agent.simulator.body.base import Base, displacement
from woosh_robot_agent.simulator.body.devices import Battery, Device, Lift
from woosh_robot_agent.simulator.body.readiness import Readiness
from woosh_robot_agent.simulator.body.statistics import Codes, Statistics
from woosh_robot_agent.simulator.body.wifi import WiFi
from woosh_robot_agent.simulator.config import SimulatorConfig
from woosh_robot_agent.simulator.profile import load_profile
from woosh_robot_agent.simulator.refusals import RefusedError
from woosh_robot_agent.simulator.scenes import files
from woosh_robot_agent.simulator.scenes.scene import Scene, with_map_changed
from woosh_robot_agent.simulator.world.collision import CollisionDetector, Obstacles
from woosh_robot_agent.simulator.world.geometry import Outline, Pose, Wall, footprints
from woosh_robot_agent.simulator.world.laser import Laser
from woosh_robot_agent.simulator.world.maps import Map, MarkKind

TIME_STEP = 0.05
"""Simulated time per step of the motion, in seconds."""

_CHARGER_DISTANCE = 0.3
"""Distance to a charger at which the robot can charge, in metres."""

_MAX_SPOKEN = 50
"""Number of spoken texts that are kept."""


class Chassis:
    """The model of the robot, without sockets and without a clock of its own.

    `tick` advances the simulated time by a step, and makes the scheduled calls that are due in it.
    Within a step, `run_until` makes them at their exact times. Requests change the state at any
    time. Events, which must all be pushed, are collected until `take_events` returns them.

    Args:
        config: The options.

    Raises:
        DataFileError: The file of the profile or of a scene cannot be used.

    Attributes:
        profile: How a robot of this model behaves.
        robot_id: Number of the robot.
        omnidirectional: The base can move sideways.
        elapsed: Simulated time since the start, in seconds.
        clock_offset: Difference between the clock of the robot and the real one, in seconds.
        stepped: The time up to which the motion is computed, in seconds.
        agenda: Scheduled calls.
        on_change: Called after each of these calls.
        chance: Random number generator for everything that varies.
        answer_delay: Time until the current request is answered, in seconds. Its handler may
            change it.
        state_first: The changes that the current request causes are pushed before its answer.
        scenes: Known scenes, by name.
        scene: Current scene.
        map: Current map.
        obstacles: Obstacles that are not in the map.
        base: The driven base.
        laser: The laser.
        battery: The battery.
        jack: The lift of LiftControl, which carries goods.
        column: The lift of LiftControl2 and LiftControl3.
        wifi: The Wi-Fi.
        readiness: Modes and conditions.
        occupied: A client has reserved the robot.
        call_muted: Flag that SetMuteCall sets. It only shows in DeviceState.
        program_muted: Flag that SetProgramMute sets. It only shows in DeviceState.
        scan_time: Simulated time of the last scan of the laser, in seconds.
        scan_pose: Pose of the robot at this scan.
        pushed_scan_time: Simulated time of the last scan that is pushed, in seconds.
        footprint: The `woosh.robot.FootPrint` in use.
        footprints: Outlines of the robot by `woosh.robot.FootPrint`.
        setting: Settings, as reported to clients.
        spoken: The last texts that the robot was told to say.
        lights: Settings of the lights, by submodule.
        remote_controller: Address of the radio remote controller, and the keys that are held down.
        statistics: Records of what the robot did.
        codes: Status codes.
        teleop: Remote control.
        follower: Following of a leader.
        tasks: The current task, and the ended ones.
        actions: The current actions.
        ownership: Starts and resumes jobs.
        auto_tasks: Starts the tasks that the robot does by itself.
        mapping: Makes maps.
        deployment: Collects marks.
    """

    def __init__(self, config: SimulatorConfig) -> None:
        self.profile = load_profile(config.profile)
        self.robot_id = config.robot_id
        self.omnidirectional = config.omnidirectional
        self.elapsed = 0.0
        self.clock_offset = config.clock_offset
        self.stepped = 0.0
        self.agenda = Agenda()
        self.on_change: Callable[[], object] = lambda: None
        self.answer_delay = 0.0
        self.state_first = False
        self._initialisation = DelayedCalls(self)
        """The end of the current initialisation."""
        self._start_time = config.start_time()
        """Unix time at which the simulated clock started, in seconds."""
        self._seed = random.randrange(2**32) if config.seed is None else config.seed
        self._events: list[Message] = []
        """Messages that were emitted since the last call of `take_events`, in order."""
        self.chance = random.Random(f"{self._seed}:chance")

        self.scenes, self.scene = files.known_scenes(config.scenes)
        self.map, start = files.start(self.scene)
        self.obstacles = Obstacles()
        self._collisions = CollisionDetector()

        driving = self.profile.driving
        self.base = Base(
            start, odometer=1204.0, rolls_for=driving.rolls_for, stops_below=driving.stops_below
        )
        self.laser = Laser()
        self.scan_pose = start
        self.scan_time: float = 0.0
        self.pushed_scan_time: float = 0.0
        self._ranges: list[float] = []
        """Ranges of the last scan in metres, empty until they are needed."""
        self.battery = Battery(93.0, self.profile.battery)
        self.jack = Lift("lift", Device.JACK, travel=0.06, default_speed=0.02)
        self.column = Lift("lift column", Device.COLUMN, travel=1.0, default_speed=0.2)
        self.wifi = WiFi()
        self.readiness = Readiness(initialised=config.initialised, located=config.initialised)
        self.occupied = False
        self.call_muted = False
        self.program_muted = False
        self.footprint: util_robot_pb2.FootPrint = util_robot_pb2.kOriginal
        self.footprints = footprints(self.profile.model.outline)
        self.spoken: deque[str] = deque(maxlen=_MAX_SPOKEN)
        self.lights: dict[int, robot_pack_pb2.LED] = {}
        self.remote_controller = device_pb2.RfRemoteController()
        self.setting = robot_pb2.Setting(
            robot_id=self.robot_id,
            identity=robot_setting_pb2.Identity(name=str(self.robot_id)),
            server=robot_setting_pb2.Server(ip="172.20.8.85", port=5420),
            power=robot_setting_pb2.Power(alarm=5, low=20, idle=80, full=98),
            sound=robot_setting_pb2.Sound(mute=False, volume=50),
            allow=robot_pb2.Setting.Allow(auto_charge=True, auto_park=True, goods_check=True),
        )

        language = config.code_language or self.profile.status_codes.language
        self.statistics = Statistics(self, self.base.odometer, self.profile.rates.operation)
        self.codes = Codes(language, self._publish_code, self.statistics)
        self._reported_mode = self.readiness.control
        """Control mode that was reported last."""
        self.teleop = Teleop(driving.start_delay)
        self.follower = Follower()
        self.tasks = Tasks(self)
        self.actions = Actions(self)
        self.ownership = Ownership(self, self.tasks, self.actions, self.follower, self.teleop)
        self.auto_tasks = AutoTasks(
            self, self.tasks, self.ownership, config.charge_after, config.park_after
        )

        self.mapping: Mapping = Mapping(self)
        self.deployment = Deployment(self, self.mapping)

        if not self._can_stand(start):
            raise DataFileError(
                f"scene {self.scene.name}: the robot cannot start at {start} on map "
                f"{self.map.name}, which is not free floor: name another pose under start"
            )

    @property
    def time(self) -> float:
        """Clock of the robot: simulated Unix time, in seconds."""
        return self._start_time + self.clock_offset + self.elapsed

    @property
    def outline(self) -> Outline:
        """Outline of the robot with the footprint in use."""
        return self.footprints[self.footprint]

    @property
    def impeded(self) -> bool:
        """True if an obstacle blocks the task or action that drives."""
        return self.tasks.impeded or self.actions.impeded

    @property
    def ground_truth(self) -> Map:
        """The hall in which the robot is, with its real walls."""
        return self.map.ground_truth or self.map

    @property
    def walls(self) -> tuple[Wall, ...]:
        """The walls of the hall and the sides of the obstacles."""
        return self.ground_truth.walls + self.obstacles.walls

    @property
    def lost(self) -> bool:
        """True if the robot has to know its pose but does not."""
        return not self.readiness.located and (self.readiness.initialised or self.mapping.active)

    @property
    def state(self) -> util_robot_pb2.State:
        """State of the robot, as reported to clients."""
        readiness = self.readiness
        if readiness.emergency_stop or self.lost:
            return util_robot_pb2.kFault
        if self.mapping.active:
            return util_robot_pb2.kMapping
        if not readiness.initialised:
            return util_robot_pb2.kUninit
        until_full = self.profile.charging.confirmed_after is None
        if self.battery.charges and (until_full or not self.tasks.state):
            return util_robot_pb2.kCharging
        if self.follower.active:
            return util_robot_pb2.kFollowing
        if self.tasks.state:
            warns = self.tasks.impeded and self.profile.tasks.pause_at_obstacle
            return util_robot_pb2.kWarning if warns else self.tasks.state
        return util_robot_pb2.kWarning if self.codes.abnormal else util_robot_pb2.kIdle

    @property
    def pose(self) -> Pose:
        """Pose at this moment, also between two steps of the motion."""
        base, dt = self.base, self.elapsed - self.stepped
        return base.pose.moved(*displacement(base.velocity, dt)) if base.moving else base.pose

    def after(self, delay: float, call: Callable[[], object]) -> None:
        """Schedule a call in `delay` seconds of simulated time, or call now if that is 0."""
        if delay > 0.0:
            self.agenda.add(self.elapsed + delay, call)
        else:
            call()

    def begin_request(self, type_name: str) -> None:
        """Choose how long the answer to a request takes, given the full name of its type."""
        answers = self.profile.answers
        times = answers.requests.get(type_name, answers.default)
        self.answer_delay = times.at(self.chance.random())
        self.state_first = self.chance.random() < self.profile.tasks.state_first

    def run_until(self, time: float) -> None:
        """Advance the simulated time within a step, and make the scheduled calls that are due."""
        while self.agenda.next_time <= time:
            self.elapsed = max(self.elapsed, self.agenda.next_time)
            self.agenda.pop()()
            self.on_change()
        self.elapsed = max(self.elapsed, time)

    def tick(self, dt: float) -> None:
        """Advance the simulated time to `dt` seconds after the last step."""
        # Rounded so that errors do not add up: whole seconds stay whole.
        end = round(self.stepped + dt, 6)
        self.run_until(end)
        self.elapsed = self.stepped = end
        self._check_conditions()
        self.auto_tasks.tick(dt)
        self.teleop.tick(self.base, dt)
        self.follower.tick(self, dt)
        self.ownership.tick(dt)
        odometer = self.base.odometer
        if not self.readiness.motors_on:
            self.base.halt()
        self.base.tick(dt, self.gap)
        self.battery.tick(dt, self.base.odometer - odometer)
        self.statistics.tick(self.base.odometer)
        if self.base.moving:
            self.actions.clear(Device.CHARGER, "robot drove away")
            self.battery.charging = robot_pb2.Battery.kNot
        self._look()
        self.mapping.tick()

    def clearance(self, x: float, y: float) -> float:
        """Return the distance from (x, y) to the nearest wall or obstacle, in metres."""
        return min(self.ground_truth.clearance(x, y), self.obstacles.clearance(x, y))

    def gap(self, pose: Pose) -> float:
        """Return the gap in metres between the robot at `pose` and walls and obstacles.

        It is negative if they overlap.
        """
        return self._collisions.gap(self.outline, pose, self.ground_truth, self.obstacles)

    def emit(self, event: Message) -> None:
        """Send a message to all its subscribers. It must not be modified afterwards."""
        self._events.append(event)

    def take_events(self) -> list[Message]:
        """Return the messages that were emitted since the last call, in order."""
        events, self._events = self._events, []
        return events

    def localise(self, pose: Pose) -> None:
        """Set the pose of the robot in the map.

        Raises:
            RefusedError: The pose is outside the map, or the robot would overlap a wall.
        """
        self.require_room(pose)
        self.base.place(pose)
        self.readiness.located = True
        navigation = self.ownership.navigation
        if navigation:
            navigation.replan()

    def require_room(self, pose: Pose) -> None:
        """Check that the robot can stand at a pose of the map.

        Raises:
            RefusedError: The pose is outside the map, or the robot would overlap a wall.
        """
        if not self.map.contains(pose.x, pose.y):
            raise RefusedError(refusals.POSE_OUTSIDE_MAP, pose=pose, map=self.map.name)
        if self.gap(pose) < 0.0:
            raise RefusedError(refusals.POSE_IN_WALL, pose=pose, map=self.map.name)

    def initialise(self) -> float:
        """Initialise the robot, and return how long that takes, in seconds."""
        duration = self.profile.answers.initialisation.at(self.chance.random())
        self.readiness.initialised = False

        def finish() -> None:
            self.readiness.initialised = True

        self._initialisation.cancel_all()
        self._initialisation.add(duration, finish)
        return duration

    def enter(self, scene: Scene, area: Map) -> None:
        """Switch to another scene or map while there is no task. The coordinates stay the same."""
        self.scenes[scene.name] = scene
        self.scene, self.map = scene, area
        if not self._can_stand(self.base.pose):
            self.readiness.located = False
        self.tasks.forget_failed()

    def replace_scene(self, old: Scene | None, new: Scene, map_name: str = "") -> None:
        """Store a scene, in place of another one or in addition.

        Args:
            old: The scene to replace, None for none.
            new: The scene. It may have another name than the old one.
            map_name: If `old` is the current scene: name of the current map in `new`; empty if it
                has not changed.
        """
        if old is self.scene:
            area = new.map(map_name or self.map.name)
            assert area is not None
            if area.same_ground(self.map):  # another name or other marks
                self.scenes[new.name] = self.scene = new
                self.map = area
            else:
                self.enter(new, area)
        else:
            self.scenes[new.name] = new
        if old and old.name != new.name:
            del self.scenes[old.name]

    def change_map(self, area: Map) -> None:
        """Replace the current map by a changed one."""
        self.replace_scene(self.scene, with_map_changed(self.scene, self.map, area))

    def at_charger(self) -> bool:
        """Return True if the robot stands at a charger."""
        pose = self.base.pose
        return any(
            mark.kind is MarkKind.CHARGER and pose.distance(mark.pose.point) <= _CHARGER_DISTANCE
            for mark in self.map.marks.values()
        )

    def set_emergency_stop(self, pressed: bool) -> None:
        """Press or release the emergency stop button."""
        self.readiness.emergency_stop = pressed
        self._check_conditions()

    def set_key_switch(self, manual: bool, *, accept: bool = False) -> None:
        """Turn the key switch to manual, or to automatic.

        At manual it overrides the control mode and switches the motors off.

        Args:
            manual: True for manual, False for automatic.
            accept: At manual, accept requests instead of refusing them. The motors stay off.
        """
        self.readiness.key_manual = manual
        self.readiness.key_accepts = accept
        self._check_conditions()

    def hold_remote_keys(self, keys: int, address: int) -> None:
        """Hold down keys of a radio remote controller.

        Args:
            keys: One bit for each key, 0 if all are released.
            address: Address of the controller.
        """
        self.remote_controller = device_pb2.RfRemoteController(address=address, keys=keys)

    def lose_localisation(self) -> None:
        """Lose the localisation. A client must then send the pose."""
        self.readiness.located = False
        self._check_conditions()

    def scan(self) -> list[float]:
        """Return the ranges of one scan of the laser, in metres."""
        self._look()
        if not self._ranges:
            # The noise depends on the time, not on the number of scans: equal seeds give equal
            # scans.
            rng = random.Random(f"{self._seed}:{self.scan_time:.3f}")
            self._ranges = self.laser.scan(self.scan_pose, self.walls, rng, self.ground_truth.grid)
        return self._ranges

    def _look(self) -> None:
        """Begin a new scan of the laser if it is due."""
        rates = self.profile.rates
        if self.stepped - self.scan_time >= rates.scan - ROUNDING:
            self.scan_time, self.scan_pose, self._ranges = self.stepped, self.base.pose, []
            if self.scan_time - self.pushed_scan_time >= rates.scan_push - ROUNDING:
                self.pushed_scan_time = self.scan_time

    def _can_stand(self, pose: Pose) -> bool:
        """Return True if the robot can stand at `pose`."""
        return self.map.contains(*pose.point) and self.gap(pose) >= 0.0

    def _check_conditions(self) -> None:
        """Report problems, and stop jobs that must not continue."""
        readiness = self.readiness
        readiness.battery_empty = self.battery.level <= 0.0
        self._report_control_mode()
        self.codes.watch(status_codes.EMERGENCY_STOP, present=readiness.emergency_stop)
        self.codes.watch(status_codes.LOCALISATION_LOST, present=self.lost)
        low = self.battery.percent <= self.setting.power.alarm
        self.codes.watch(status_codes.BATTERY_LOW, present=low)
        self.codes.watch(status_codes.OBSTACLE_IN_THE_WAY, present=self.impeded)
        if readiness.emergency_stop:
            self.base.halt()
            self.teleop.release()
        if readiness.obstruction:
            self.ownership.suspend_all(readiness.obstruction.reason)

    def _report_control_mode(self) -> None:
        """Report the control mode if it has changed."""
        mode = self.readiness.control
        if mode != self._reported_mode:
            self._reported_mode = mode
            self.codes.report(status_codes.CONTROL_MODES[mode])

    def _publish_code(self, status: robot_count_pb2.StatusCode) -> None:
        status.robot_id = self.robot_id
        status.time = round(self.time * 1000)
        status.state = self.state
        if self.tasks.active:
            status.robot_task_id = self.tasks.proc.robot_task_id
        self.emit(status)
