"""Actions that dock the robot at a charger and undock it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.motion.wheel_owner import is_unfinished
from woosh_robot_agent.pb.map import storage_edit_pb2
from woosh_robot_agent.pb.map.mark_pb2 import Storages
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ActionOrder, ExecTask
from woosh_robot_agent.pb.robot.robot_pb2 import Battery, TaskProc
from woosh_robot_agent.pb.ros.action_pb2 import ChargeControl, kExecute
from woosh_robot_agent.pb.util import action_pb2 as action
from woosh_robot_agent.pb.util import task_pb2 as task
from woosh_robot_agent.robot.readiness import is_charging
from woosh_robot_agent.ros.nav2.action import Nav2Action
from woosh_robot_agent.ros.nav2.goals import GoalEnd, Nav2Context, Nav2Goal, to_duration
from woosh_robot_agent.ros.nav2.navigation import transform_all
from woosh_robot_agent.ros.standard.poses import Pose2D, from_pose

_NEAR = 1.0
"""Maximum distance between `dock_pose`, or a robot that charges, and its charger, in metres."""
_DOCKED = 0.3
"""Maximum distance between a docked robot and its charger, in metres. A robot that has backed
out is farther away."""
_PHASES = {
    action.kNav: ("NAV_TO_STAGING_POSE", "FAILED_TO_STAGE"),
    action.kSecondposEnter: ("INITIAL_PERCEPTION", "FAILED_TO_DETECT_DOCK"),
    action.kStepCtrl: ("CONTROLLING", "FAILED_TO_CONTROL"),
    action.kCharge: ("WAIT_FOR_CHARGE", "FAILED_TO_CHARGE"),
}
"""Phases of docking, by the action of the charging task that the chassis executes: the name of the
state in the feedback, and of the error code if the goal fails in this phase."""


async def _find_chargers(context: Nav2Context) -> dict[str, tuple[float, float]]:
    """Return the positions of the chargers in the map, by their marks; {} if none are listed.

    Raises:
        LinkError: the chassis does not answer.
    """
    answer = await context.chassis.request(context.requests.address(storage_edit_pb2.Storages()))
    positions: dict[str, tuple[float, float]] = {}
    for charger in answer.body.chargers if isinstance(answer.body, Storages) else ():
        pose = charger.pose.dock if charger.pose.HasField("dock") else charger.pose.real
        positions[charger.identity.no] = (pose.x, pose.y)
    return positions


class DockRobot(Nav2Action):
    """Docks the robot at a charger by a task of the chassis; succeeds when the robot charges."""

    name = "dock_robot"
    is_paused_by_emergency_stop = True

    @property
    def is_charging(self) -> bool:
        """True if the robot reports that it is charging."""
        battery = self.context.last_known.value(Battery)
        return battery is not None and is_charging(battery)

    async def check(self, request: Any) -> None:
        if not request.use_dock_id:
            await transform_all(self.context.frames, [request.dock_pose])
        self.log_unused(request, "dock_type")
        self.log_unused(request, "navigate_to_staging_pose", True)

    async def execute(self, goal: Nav2Goal) -> None:
        chargers = await goal.run(_find_chargers(self.context), "chargers")
        mark = self._find_mark(goal.request, chargers)
        if not self._is_docked(mark, chargers):
            await self._dock(goal, mark)

    def _is_docked(self, mark: str, chargers: Mapping[str, tuple[float, float]]) -> bool:
        """Return True if the robot charges at a charger, given by its mark."""
        here = self.context.pose.pose
        if here is None or not self.is_charging:
            return False
        distance, nearest = _nearest(chargers, here)
        return distance <= _NEAR and nearest == mark

    async def _dock(self, goal: Nav2Goal, mark: str) -> None:
        """Let the chassis execute a charging task, until the robot charges.

        Args:
            mark: mark of the charger; empty if the robot must choose a charger.
        """
        seconds = float(goal.request.max_staging_time)
        late = f"the robot has not come to the charger within max_staging_time, {seconds:g} s"
        goal.set_timeout(seconds, GoalEnd(late, "FAILED_TO_STAGE"))
        phase = action.kNav
        is_paused = False

        def on_report(report: Message) -> None:
            nonlocal phase, is_paused
            if not isinstance(report, TaskProc):
                return
            is_paused = report.state == task.kPaused
            if report.action.type in _PHASES:
                phase = report.action.type
                if phase != action.kNav:
                    goal.clear_timeout()

        def tick() -> None:
            reasons = self.context.objections_except_busy
            # also if the service `stop` is ending the goal: it may only have paused the task
            if is_paused and reasons and not goal.is_stopped:
                # the task could stay paused for ever, or the robot could later drive on by itself
                goal.stop(GoalEnd("; ".join(map(str, reasons))))
            state, _ = _PHASES[phase]
            goal.feedback(
                state=getattr(self.action_type.Feedback, state),
                docking_time=to_duration(goal.elapsed),
            )

        try:
            await goal.run_command(
                ExecTask(type=task.kCharge, mark_no=mark),
                tick=tick,
                on_report=on_report,
                is_done=lambda: phase == action.kCharge and self.is_charging,
            )
        except GoalEnd as end:
            if end.code == "UNKNOWN":
                _, end.code = _PHASES[phase]
            raise

    def _find_mark(self, request: Any, chargers: Mapping[str, tuple[float, float]]) -> str:
        """Return the mark of the requested charger; empty if the robot must choose a charger.

        Raises:
            GoalEnd: there is no such charger.
        """
        if not request.use_dock_id:
            pose = from_pose(request.dock_pose.pose)
            distance, mark = _nearest(chargers, pose)
            if distance > _NEAR:
                raise GoalEnd(
                    f"there is no charger within {_NEAR:g} m of dock_pose, at ({pose.x:.2f}, "
                    f"{pose.y:.2f})",
                    "DOCK_NOT_IN_DB",
                )
            return mark
        if not request.dock_id:
            here = self.context.pose.pose
            return "" if here is None else _nearest(chargers, here)[1]
        # if the chassis lists no chargers, let it find the mark
        if chargers and request.dock_id not in chargers:
            known = ", ".join(sorted(chargers))
            raise GoalEnd(
                f"there is no charger {request.dock_id!r}; there are {known}", "DOCK_NOT_IN_DB"
            )
        return str(request.dock_id)


def _nearest(chargers: Mapping[str, tuple[float, float]], pose: Pose2D) -> tuple[float, str]:
    """Return the distance to the nearest charger, and its mark; (inf, "") without chargers."""
    distances = [(math.hypot(x - pose.x, y - pose.y), mark) for mark, (x, y) in chargers.items()]
    return min(distances, default=(math.inf, ""))


class UndockRobot(Nav2Action):
    """Ends a charging task, and backs the robot out of the charger."""

    name = "undock_robot"

    async def check(self, request: Any) -> None:
        self.log_unused(request, "dock_type")

    async def execute(self, goal: Nav2Goal) -> None:
        seconds = float(goal.request.max_undocking_time)
        late = f"undocking has taken longer than max_undocking_time, {seconds:g} s"
        goal.set_timeout(seconds, GoalEnd(late, "TIMEOUT"))
        await goal.run(self._check_docked(), "chargers")
        await self._end_task(goal)
        command = ChargeControl(execute_mode=ChargeControl.kExit, action=kExecute)
        try:
            await goal.run_command(command)
        except GoalEnd as end:
            if end.code == "UNKNOWN":
                end.code = "FAILED_TO_CONTROL"
            raise

    async def _check_docked(self) -> None:
        """Check that the robot is in a charger.

        It is if it charges by itself (`kAuto`). Otherwise, its place decides: a full robot does not
        charge in a charger, and a robot that a person has plugged in may charge anywhere.

        Raises:
            GoalEnd: the robot is in no charger, or its pose is unknown.
            LinkError: the chassis does not answer.
        """
        battery = self.context.last_known.value(Battery)
        if battery is not None and battery.charge_state == Battery.kAuto:
            return
        here = self.context.pose.pose
        if here is None:
            raise GoalEnd("the robot's pose is not known: wait for the link to the robot")
        distance, _ = _nearest(await _find_chargers(self.context), here)
        if distance > _DOCKED:
            raise GoalEnd(
                "the robot is in no charger: it does not charge by itself, and no charger is "
                f"within {_DOCKED:g} m of it",
                "DOCK_NOT_VALID",
            )

    async def _end_task(self, goal: Nav2Goal) -> None:
        """Cancel a charging task, and wait for its end.

        Raises:
            GoalEnd: the chassis does not cancel the task, or the goal has ended before.
            LinkError: the chassis does not answer.
        """
        if not self._has_charging_task():
            return
        answer = await goal.run(
            self.context.gate.request(ActionOrder(order=action.kCancel)),
            "cancel of the charging task",
        )
        if not answer.ok and self._has_charging_task():
            raise GoalEnd(f"the chassis refused to end the charging task: {answer.reason}")
        await goal.wait_until(lambda: not self._has_charging_task())

    def _has_charging_task(self) -> bool:
        """Return True while the chassis executes a charging task."""
        report = self.context.last_known.value(TaskProc)
        return report is not None and report.type == task.kCharge and is_unfinished(report)
