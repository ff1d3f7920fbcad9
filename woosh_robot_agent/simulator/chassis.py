"""The simulated chassis itself: one state, stepped in simulated time."""

from __future__ import annotations

import random
from collections import deque

from google.protobuf.message import Message

from woosh_robot_agent.pb.robot import robot_count_pb2, robot_pb2, robot_setting_pb2
from woosh_robot_agent.pb.task import woosh_task_pb2
from woosh_robot_agent.pb.util import robot_pb2 as util_robot_pb2
from woosh_robot_agent.pb.util import task_pb2 as util_task_pb2
from woosh_robot_agent.simulator.behaviour.actions import Actions
from woosh_robot_agent.simulator.behaviour.auto_tasks import Errands
from woosh_robot_agent.simulator.behaviour.following import Follower
from woosh_robot_agent.simulator.behaviour.jobs import Device
from woosh_robot_agent.simulator.behaviour.navigation import Navigate
from woosh_robot_agent.simulator.behaviour.tasks import TaskOrder, Tasks
from woosh_robot_agent.simulator.behaviour.teleop import Teleop
from woosh_robot_agent.simulator.body.base import Base
from woosh_robot_agent.simulator.body.battery import Battery
from woosh_robot_agent.simulator.body.codes import (
    BATTERY_LOW,
    EMERGENCY_STOP,
    IMPEDED,
    KEY_AT_MANUAL,
    LOCALISATION_LOST,
    Codes,
)
from woosh_robot_agent.simulator.body.lift import Lift
from woosh_robot_agent.simulator.body.readiness import Readiness
from woosh_robot_agent.simulator.body.wifi import WiFi
from woosh_robot_agent.simulator.config import SimulatorConfig
from woosh_robot_agent.simulator.errors import Refused
from woosh_robot_agent.simulator.scenes import library as scenes
from woosh_robot_agent.simulator.scenes.yaml_fields import SceneError
from woosh_robot_agent.simulator.world.collision import Bumper
from woosh_robot_agent.simulator.world.footprints import FOOTPRINTS
from woosh_robot_agent.simulator.world.geometry import Pose, Wall
from woosh_robot_agent.simulator.world.laser import Laser
from woosh_robot_agent.simulator.world.maps import Map, MarkKind, Scene
from woosh_robot_agent.simulator.world.obstacles import Obstacles

#: Simulated seconds per step, and so the period of PoseSpeed pushes while moving.
STEP_S = 0.05

_CHARGER_REACH_M = 0.3
_SPOKEN_KEPT = 50

_Level = robot_count_pb2.StatusCode


class Chassis:
    """Everything a chassis knows and does.

    It has neither sockets nor a clock of its own: `tick` moves simulated time on, requests change
    the state between ticks, and whatever must be reported message by message is in `take_events`.

    Args:
        config: The options.

    Raises:
        SceneError: A file of a scene cannot be used.

    Attributes:
        time: Simulated Unix time in s.
        elapsed: Simulated time since the start in s.
        footprint: The `woosh.robot.FootPrint` in use.
        obstacles: What stands in the way without being in the map.
        setting: The settings, as the getter reports them.
        spoken: What it was told to say lately.
    """

    def __init__(self, config: SimulatorConfig) -> None:
        self.robot_id = config.robot_id
        self.omnidirectional = config.omnidirectional
        self.elapsed = 0.0
        self._start_time = config.start_time()
        self._seed = random.randrange(2**32) if config.seed is None else config.seed
        self._events: list[Message] = []
        self._last_task_id = 0

        self.scenes, self.scene = scenes.known_scenes(config.scenes)
        self.map, start = scenes.start(self.scene)
        self.obstacles = Obstacles()
        self._bumper = Bumper()

        self.base = Base(start, odometer=1204.0)
        self.laser = Laser()
        self.battery = Battery(93.0)
        self.jack = Lift("lift", Device.JACK, travel=0.06, usual_speed=0.02)
        self.column = Lift("lift column", Device.COLUMN, travel=1.0, usual_speed=0.2)
        self.wifi = WiFi()
        self.readiness = Readiness(initialised=config.initialised, located=config.initialised)
        self.occupied = False
        self.call_muted = False
        self.program_muted = False
        self.footprint: util_robot_pb2.FootPrint = util_robot_pb2.kOriginal
        self.spoken: deque[str] = deque(maxlen=_SPOKEN_KEPT)
        self.setting = robot_pb2.Setting(
            robot_id=self.robot_id,
            identity=robot_setting_pb2.Identity(name=str(self.robot_id)),
            server=robot_setting_pb2.Server(ip="172.20.8.85", port=5420),
            power=robot_setting_pb2.Power(alarm=5, low=20, idle=80, full=98),
            sound=robot_setting_pb2.Sound(mute=False, volume=50),
            allow=robot_pb2.Setting.Allow(auto_charge=True, auto_park=True, goods_check=True),
        )

        self.teleop = Teleop()
        self.follower = Follower()
        self.errands = Errands(config.charge_after, config.park_after)
        self.codes = Codes(self._stamp)
        self.tasks = Tasks(self)
        self.actions = Actions(self)

        if not self._fits(start):
            raise SceneError(
                f"scene {self.scene.name}: the robot cannot start at {start} on map "
                f"{self.map.name}, which is not free floor: name another pose under start"
            )

    @property
    def time(self) -> float:
        """Simulated Unix time in s."""
        return self._start_time + self.elapsed

    @property
    def taskable(self) -> bool:
        """Whether it would take a task now."""
        return not self.readiness.objections()

    @property
    def predefined(self) -> woosh_task_pb2.RepeatTasks:
        """The task sets of the scene that ExecPreTask can start."""
        return self.scene.predefined

    @property
    def calls(self) -> woosh_task_pb2.CallTasks:
        """The task sets of the scene that call buttons start."""
        return self.scene.calls

    @property
    def driver(self) -> str:
        """The task or the action that uses the wheels now, empty if none does."""
        if self.tasks.uses(Device.WHEELS):
            return f"task {self.tasks.proc.robot_task_id}"
        return self.actions.user(Device.WHEELS)

    @property
    def navigation(self) -> Navigate | None:
        """The navigation of what drives, or of a paused task or action if nothing drives."""
        job = self.tasks.job
        if self.tasks.paused and self.actions.user(Device.WHEELS):
            return self.actions.navigation
        return job if isinstance(job, Navigate) else self.actions.navigation

    @property
    def impeded(self) -> bool:
        """Whether an obstacle stands in the way of what drives now."""
        return self.tasks.impeded or self.actions.impeded

    @property
    def walls(self) -> tuple[Wall, ...]:
        """The walls of the map and the sides of the obstacles."""
        return self.map.walls + self.obstacles.walls

    @property
    def state(self) -> util_robot_pb2.State:
        """What the chassis says it is doing."""
        readiness = self.readiness
        if readiness.emergency_stop or (readiness.initialised and not readiness.located):
            return util_robot_pb2.kFault
        if not readiness.initialised:
            return util_robot_pb2.kUninit
        if self.battery.charges:
            return util_robot_pb2.kCharging
        if self.follower.active:
            return util_robot_pb2.kFollowing
        if self.tasks.active:
            parking = self.tasks.proc.type == util_task_pb2.kParking
            return util_robot_pb2.kParking if parking else util_robot_pb2.kTask
        return util_robot_pb2.kWarning if self.codes.abnormal else util_robot_pb2.kIdle

    def tick(self, dt: float) -> None:
        """Let `dt` seconds pass."""
        # Rounded, so that summing up leaves no dust: whole seconds stay whole.
        self.elapsed = round(self.elapsed + dt, 6)
        self._watch()
        self.errands.tick(self, dt)
        self.teleop.tick(self.base, dt)
        self.follower.tick(self, dt)
        self.tasks.tick(dt)
        self.actions.tick(dt)
        driven = self.base.odometer
        self.base.tick(dt, self.gap)
        self.battery.tick(dt, self.base.odometer - driven)
        if self.base.moving:
            self.actions.clear(Device.CHARGER, "robot drove away")
            self.battery.charging = robot_pb2.Battery.kNot

    def clearance(self, x: float, y: float) -> float:
        """How far the nearest wall or obstacle is from (x, y), in m."""
        return min(self.map.clearance(x, y), self.obstacles.clearance(x, y))

    def gap(self, pose: Pose) -> float:
        """How far in m the outline at `pose` is from touching anything; negative if it does."""
        return self._bumper.gap(FOOTPRINTS[self.footprint], pose, self.map, self.obstacles)

    def emit(self, event: Message) -> None:
        """Report a message of which each one counts; it must not change any more."""
        self._events.append(event)

    def take_events(self) -> list[Message]:
        """What was emitted since the last call, in order."""
        events, self._events = self._events, []
        return events

    def require_ready(self) -> None:
        """Make sure that the chassis may move by itself.

        Raises:
            Refused: It may not, with the first reason.
        """
        objections = self.readiness.objections()
        if objections:
            raise Refused(objections[0])

    def claim_wheels(self, user: str) -> None:
        """Make sure that nothing drives but following and remote control, which give way.

        Args:
            user: What wants to drive, for the report of an errand that it ends.

        Raises:
            Refused: A task or an action of a client drives.
        """
        self.tasks.give_way(f"replaced by {user}")
        if self.driver:
            raise Refused(f"{self.driver} is driving: pause or cancel it first")
        self.follower.stop()

    def stop_wheels(self, reason: str) -> None:
        """Stop at once, whatever drives: a task or an action is paused until it is resumed."""
        self.tasks.give_way(reason)
        if self.tasks.uses(Device.WHEELS):
            self.tasks.pause(reason)
        self.actions.pause_on(Device.WHEELS, reason)
        self.follower.stop()
        self.teleop.release()
        self.base.halt()

    def take_tasks(self, orders: list[TaskOrder]) -> None:
        """Start a task or those of a set, in place of whatever uses the wheels.

        Raises:
            Refused: The chassis is not ready for tasks.
        """
        self.require_ready()
        self.free_wheels(f"replaced by task {orders[0].id}")
        self.tasks.start(orders)

    def free_wheels(self, reason: str) -> None:
        """End following, remote control and every action that drives or charges."""
        self.follower.stop()
        self.teleop.release()
        self.actions.clear(Device.WHEELS, reason)
        self.actions.clear(Device.CHARGER, reason)

    def fresh_task_id(self) -> int:
        """An id for a task that came without one: the time in s, and never the same twice."""
        self._last_task_id = max(int(self.time), self._last_task_id + 1)
        return self._last_task_id

    def localise(self, pose: Pose) -> None:
        """Take `pose` for where it is.

        Raises:
            Refused: It cannot be there.
        """
        if not self.map.contains(pose.x, pose.y):
            raise Refused(f"pose {pose} is outside of map {self.map.name}: choose one inside")
        if self.gap(pose) < 0.0:
            raise Refused(
                f"pose {pose} is inside a wall of map {self.map.name}: choose one on free floor"
            )
        self.base.place(pose)
        self.readiness.located = True
        if self.navigation:
            self.navigation.replan()

    def enter(self, scene: Scene, area: Map) -> None:
        """Work in another scene or map, at the same coordinates, while there is no task."""
        self.scenes[scene.name] = scene
        self.scene, self.map = scene, area
        if not self._fits(self.base.pose):
            self.readiness.located = False
        self.tasks.forget_failed()

    def at_charger(self) -> bool:
        """Whether it stands at a charger."""
        pose = self.base.pose
        return any(
            mark.kind is MarkKind.CHARGER and pose.distance(mark.pose.point) <= _CHARGER_REACH_M
            for mark in self.map.marks.values()
        )

    def set_emergency_stop(self, pressed: bool) -> None:
        """Press or release the emergency stop button."""
        self.readiness.emergency_stop = pressed
        self._watch()

    def set_key_switch(self, manual: bool) -> None:
        """Turn the key switch to manual, which overrules the control mode, or to automatic."""
        if manual and not self.readiness.key_manual:
            self.codes.report(KEY_AT_MANUAL, _Level.kTips)
        self.readiness.key_manual = manual
        self._watch()

    def lose_localisation(self) -> None:
        """Forget where it is, as after having been carried away: it has to be told."""
        self.readiness.located = False
        self._watch()

    def scan(self) -> list[float]:
        """One scan of the laser, in m."""
        # Noise by time, not by how often somebody asked: equal seeds see equal scans.
        rng = random.Random(f"{self._seed}:{self.elapsed:.3f}")
        return self.laser.scan(self.base.pose, self.walls, rng, self.map.grid)

    def _fits(self, pose: Pose) -> bool:
        """Whether the robot can stand there."""
        return self.map.contains(*pose.point) and self.gap(pose) >= 0.0

    def _watch(self) -> None:
        """Notice what is wrong, and stop what must not go on."""
        readiness = self.readiness
        readiness.battery_empty = self.battery.level <= 0.0
        self.codes.watch(EMERGENCY_STOP, _Level.kFault, present=readiness.emergency_stop)
        lost = readiness.initialised and not readiness.located
        self.codes.watch(LOCALISATION_LOST, _Level.kFault, present=lost)
        low = self.battery.percent <= self.setting.power.alarm
        self.codes.watch(BATTERY_LOW, _Level.kWarn, present=low)
        self.codes.watch(IMPEDED, _Level.kWarn, present=self.impeded)
        if readiness.emergency_stop:
            self.base.halt()
            self.teleop.release()
        objections = readiness.objections()
        if objections:
            reason = objections[0].partition(":")[0]
            self.follower.stop()
            self.actions.abort(reason)
            self.tasks.give_way(reason)
            if self.tasks.active:
                self.tasks.pause(reason)

    def _stamp(self, status: robot_count_pb2.StatusCode) -> None:
        status.robot_id = self.robot_id
        status.time = round(self.time * 1000)
        status.state = self.state
        if self.tasks.active:
            status.robot_task_id = self.tasks.proc.robot_task_id
        self.emit(status)
