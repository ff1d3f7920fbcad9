"""Tasks that the robot starts by itself: charging and parking."""

from __future__ import annotations

from woosh_robot_agent.pb.util import task_pb2 as util_task_pb2
from woosh_robot_agent.simulator.behaviour.ownership import Ownership
from woosh_robot_agent.simulator.behaviour.task_jobs import task_jobs
from woosh_robot_agent.simulator.behaviour.tasks import TaskOrder, Tasks
from woosh_robot_agent.simulator.config import SimulatorConfig
from woosh_robot_agent.simulator.robot import Robot
from woosh_robot_agent.simulator.world.maps import MarkKind

_PARKED_DISTANCE = 0.3
"""Distance from a parking place up to which a robot counts as parked, in metres."""


class AutoTasks:
    """Starts an automatic task, i.e. charging or parking, when the robot is idle for long enough.

    The robot is idle while it is ready, has no task or action, stands still, does not charge, and
    is not reserved by a client. A command of a client restarts the idle time.

    Args:
        ownership: starts the automatic tasks.
        config: has the idle times, `charge_after` and `park_after`.
    """

    def __init__(
        self, robot: Robot, tasks: Tasks, ownership: Ownership, config: SimulatorConfig
    ) -> None:
        self._robot = robot
        self._tasks = tasks
        self._ownership = ownership
        self._config = config
        self._idle_time = 0.0
        """Simulated time since the robot became idle or got a command, in seconds."""

    def postpone(self) -> None:
        """Restart the idle time, because a client has sent a command."""
        self._idle_time = 0.0

    def tick(self, dt: float) -> None:
        """Let `dt` seconds pass. Start an automatic task if it is due, or end a forbidden one."""
        if not self._idle():
            self._idle_time = 0.0
            self._end_forbidden()
            return
        self._idle_time += dt
        setting, battery = self._robot.setting, self._robot.battery
        low = battery.percent <= setting.power.low
        if low and setting.allow.auto_charge and self._idle_time >= self._config.charge_after:
            self._start(MarkKind.CHARGER, util_task_pb2.kCharge)
        parks = setting.allow.auto_park and self._idle_time >= self._config.park_after
        if parks and not self._ownership.busy:  # it may just have begun to charge
            self._start(MarkKind.PARKSPOT, util_task_pb2.kParking)

    def _idle(self) -> bool:
        robot = self._robot
        busy = self._ownership.busy or robot.base.moving or robot.battery.charges or robot.occupied
        return robot.readiness.ready and not busy

    def _end_forbidden(self) -> None:
        """Cancel an automatic task that the settings no longer allow."""
        if not self._tasks.automatic:
            return
        allow, kind = self._robot.setting.allow, self._tasks.proc.type
        if kind == util_task_pb2.kCharge and not allow.auto_charge:
            self._tasks.cancel("automatic charging is no longer allowed")
        elif kind == util_task_pb2.kParking and not allow.auto_park:
            self._tasks.cancel("automatic parking is no longer allowed")

    def _start(self, mark_kind: MarkKind, kind: util_task_pb2.Type) -> None:
        """Start a task at the nearest mark of a kind.

        Do nothing if the map has no such mark, the scene has no actions for the task, or the robot
        already stands at the parking place.
        """
        robot = self._robot
        mark = robot.nearest_mark(mark_kind)
        actions = robot.scene.action_groups.actions(kind, 0)
        if mark is None or actions is None:
            return
        distance = robot.pose.distance(mark.pose.point)
        if kind == util_task_pb2.kParking and distance <= _PARKED_DISTANCE:
            return
        jobs = task_jobs(robot, actions, util_task_pb2.kDirectionUndefined, mark)
        number = self._tasks.new_id()
        order = TaskOrder(number, kind, mark.number, jobs=lambda: jobs, automatic=True, own_id=True)
        self._ownership.start_tasks([order])
