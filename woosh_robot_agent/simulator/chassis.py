"""The simulated robot with its behaviour, advanced step by step in simulated time."""

from __future__ import annotations

from collections import deque

from woosh_robot_agent.pb.device import device_pb2
from woosh_robot_agent.pb.robot import robot_count_pb2, robot_pack_pb2, robot_pb2
from woosh_robot_agent.pb.util import robot_pb2 as util_robot_pb2
from woosh_robot_agent.simulator import refusals, status_codes
from woosh_robot_agent.simulator.behaviour.actions import Actions
from woosh_robot_agent.simulator.behaviour.auto_tasks import AutoTasks
from woosh_robot_agent.simulator.behaviour.manual_driving import Follower, Teleop
from woosh_robot_agent.simulator.behaviour.mapping import MapBuilder
from woosh_robot_agent.simulator.behaviour.ownership import Ownership
from woosh_robot_agent.simulator.behaviour.tasks import Tasks
from woosh_robot_agent.simulator.body.devices import Device
from woosh_robot_agent.simulator.config import SimulatorConfig
from woosh_robot_agent.simulator.robot import Robot
from woosh_robot_agent.simulator.scenes.scene import Scene
from woosh_robot_agent.simulator.timeline import DelayedCalls
from woosh_robot_agent.simulator.world.geometry import Pose
from woosh_robot_agent.simulator.world.maps import Map

TIME_STEP = 0.05
"""Simulated time per step of the motion, in seconds."""

_MAX_SPOKEN = 50
"""Number of spoken texts that are kept."""


class Chassis(Robot):
    """The robot with everything that it does, without sockets and without a clock of its own.

    `tick` advances the simulated time by a step. `run_until` makes the scheduled calls between two
    steps at their exact times. Requests change the state at any time. `take_events` returns the
    messages to push.

    Raises:
        DataFileError: the file of the profile or of a scene cannot be used.

    Attributes:
        call_muted: flag that SetMuteCall sets. It only shows in DeviceState.
        program_muted: flag that SetProgramMute sets. It only shows in DeviceState.
        spoken: the last texts that the robot was told to say.
        lights: last request for each submodule of the lights.
        remote_controller: address of the radio remote controller, and the keys that are held down.
    """

    def __init__(self, config: SimulatorConfig) -> None:
        super().__init__(config)
        self.call_muted = False
        self.program_muted = False
        self.spoken: deque[str] = deque(maxlen=_MAX_SPOKEN)
        self.lights: dict[int, robot_pack_pb2.LED] = {}
        self.remote_controller = device_pb2.RfRemoteController()
        self._initialisation = DelayedCalls(self)
        """The scheduled end of the current initialisation."""
        self._reported_mode = self.readiness.control
        """Control mode that was reported last."""
        self.teleop = Teleop(self.profile.driving.start_delay)
        self.follower = Follower()
        self.tasks = Tasks(self)
        self.actions = Actions(self)
        self.ownership = Ownership(self, self.tasks, self.actions, self.follower, self.teleop)
        self.auto_tasks = AutoTasks(self, self.tasks, self.ownership, config)
        self.mapping = MapBuilder(self)

    @property
    def impeded(self) -> bool:
        """True if an obstacle blocks the task or action that drives."""
        return self.tasks.impeded or self.actions.impeded

    @property
    def lost(self) -> bool:
        """True if the robot has lost its localisation.

        An uninitialised robot has none that it could lose, except while it makes a map.
        """
        return not self.readiness.located and (self.readiness.initialised or self.mapping.active)

    @property
    def state(self) -> util_robot_pb2.State:
        """State of the robot, as reported to clients."""
        readiness = self.readiness
        in_maintenance = readiness.control == util_robot_pb2.kMaintain
        if readiness.emergency_stop or self.lost or in_maintenance:
            return util_robot_pb2.kFault
        if self.mapping.active:
            return util_robot_pb2.kMapping
        if not readiness.initialised:
            return util_robot_pb2.kUninit
        # With `confirmed_after`, a charge task ends after some seconds, and the battery goes on
        # charging. Until the task ends, the robot has the state of the task.
        tasks_last_until_full = self.profile.charging.confirmed_after is None
        if self.battery.charges and (tasks_last_until_full or not self.tasks.state):
            return util_robot_pb2.kCharging
        if self.follower.active:
            return util_robot_pb2.kFollowing
        if self.tasks.state:
            warns = self.tasks.impeded and self.profile.tasks.pause_at_obstacle
            return util_robot_pb2.kWarning if warns else self.tasks.state
        return util_robot_pb2.kWarning if self.codes.abnormal else util_robot_pb2.kIdle

    def begin_request(self, type_name: str) -> None:
        """Choose when a request is answered, and if a new state is pushed before its answer.

        Args:
            type_name: full name of the type of the request.
        """
        answers = self.profile.answers
        times = answers.requests.get(type_name, answers.default)
        self.answer_delay = times.sample(self.rng)
        self.state_first = self.rng.random() < self.profile.tasks.state_first

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
        if self.base.moving:
            self.actions.cancel_on(Device.CHARGER, "robot drove away")
            self.battery.charging = robot_pb2.Battery.kNot
        self.begin_due_scan()
        self.mapping.tick()

    def localise(self, pose: Pose) -> None:
        """Set the pose of the robot in the map; raise RefusedError if it cannot stand there."""
        self.require_room(pose)
        self.base.place(pose)
        self.readiness.located = True
        navigation = self.ownership.navigation
        if navigation:
            navigation.replan()

    def initialise(self) -> float:
        """Begin to initialise the robot; return how long it will take, in simulated seconds."""
        duration = self.profile.answers.initialisation.sample(self.rng)
        self.readiness.initialised = False

        def finish() -> None:
            self.readiness.initialised = True

        self._initialisation.cancel_all()
        self._initialisation.add(duration, finish)
        return duration

    def switch_map(self, scene: Scene, area: Map) -> None:
        super().switch_map(scene, area)
        self.tasks.forget_failed()  # the target of a failed task is on the old map

    def set_emergency_stop(self, pressed: bool) -> None:
        """Press or release the emergency stop button."""
        self.readiness.emergency_stop = pressed
        self._check_conditions()

    def set_key_switch(self, manual: bool, *, accept: bool = False) -> None:
        """Turn the key switch to manual, where the motors are off, or to automatic (False).

        With `accept`, the robot accepts requests at manual, although nothing moves.
        """
        self.readiness.key_manual = manual
        self.readiness.key_accepts = accept
        self._check_conditions()

    def lose_localisation(self) -> None:
        """Lose the localisation, until a client sends the pose."""
        self.readiness.located = False
        self._check_conditions()

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
        if readiness.refusal:
            self.ownership.stop_jobs(readiness.refusal.reason)

    def _report_control_mode(self) -> None:
        """Report the control mode if it has changed.

        Maintenance makes the task fail, and afterwards the robot must be initialised.
        """
        mode = self.readiness.control
        if mode == self._reported_mode:
            return
        self._reported_mode = mode
        self.codes.report(status_codes.CONTROL_MODES[mode])
        if mode == util_robot_pb2.kMaintain:
            self.readiness.initialised = False
            if self.tasks.active:
                self.tasks.fail(refusals.MAINTENANCE_MODE.reason)

    def publish_code(self, status: robot_count_pb2.StatusCode) -> None:
        """Also add the state and the task of the robot to a new status code, then send it."""
        status.state = self.state
        if self.tasks.active:
            status.robot_task_id = self.tasks.proc.robot_task_id
        super().publish_code(status)
