"""The log of a robot's tasks, including the tasks from other programs, for the page."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from woosh_robot_agent.link import LinkState
from woosh_robot_agent.link.protos import enum_name
from woosh_robot_agent.link.reports import RecentDict
from woosh_robot_agent.motion.wheel_owner import is_unfinished
from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode
from woosh_robot_agent.pb.robot.robot_pb2 import NavPath, RobotInfo, TaskProc
from woosh_robot_agent.pb.util import action_pb2 as action
from woosh_robot_agent.pb.util import task_pb2 as task
from woosh_robot_agent.robot.who_drives import Driver
from woosh_robot_agent.tools.dashboard import part_data
from woosh_robot_agent.tools.dashboard.robot import Robot

_MAX_TASKS = 100
"""Number of tasks that are remembered: twice as many as a robot's own history has. With 50, the
tasks of the history would displace the running one."""
_SAME_MOMENT = 2.0
"""Maximum time between the end of a task and its status code, in seconds."""


@dataclass
class _Task:
    """A task in the log.

    Attributes:
        command: name and arguments of the page's command that gave the task; empty for other tasks.
        by: source of the task: the viewer's name, or a name as in `Driver`; empty if unknown.
        known: True if the robot has accepted or reported the task.
        report: last report about the task. Its state is `kStateUndefined` before the first report,
            and also if the task has ended without a report of its end; then `changed` is set.
        place: destination, in metres; None if unknown, e.g. if the robot reported only the number
            of a mark.
        map: the map that the robot used when the task was given or first seen, from `map_data`;
            with empty values if the task was first seen after its end.
        begun: Unix time at which the task was given or first seen, in milliseconds; 0 if unknown.
        changed: Unix time at which the task got its present state, or at which its unreported end
            was noticed, in milliseconds; 0 before.
    """

    command: Mapping[str, Any] = field(default_factory=dict)
    by: str = ""
    known: bool = False
    report: TaskProc = field(default_factory=TaskProc)
    place: tuple[float, float] | None = None
    map: dict[str, str] = field(default_factory=lambda: {"scene": "", "map": "", "version": ""})
    begun: int = 0
    changed: int = 0

    @property
    def runs(self) -> bool:
        """True if the last report says that the task is unfinished; False before any report."""
        return is_unfinished(self.report)


class TaskLog:
    """Follows the tasks of a robot, and adds the part `tasks`: a list, the newest first.

    A real robot reports the end of a task for a few milliseconds only. Tasks that ended while there
    was no link are taken from the robot's history.

    `driver` returns what drives the robot now.
    """

    def __init__(self, robot: Robot, driver: Callable[[], Driver]) -> None:
        self._robot = robot
        self._driver = driver
        self._tasks: RecentDict[int, _Task] = RecentDict(_MAX_TASKS)
        """The tasks by id, in the order in which they were given or first seen."""
        robot.chassis.on_snapshot(self._snapshot)
        robot.chassis.subscribe(TaskProc, self._reported)
        robot.chassis.subscribe(NavPath, self._path_reported)
        robot.parts.add("tasks", self._data)

    def given(self, task_id: int, by: str, command: str, args: Mapping[str, Any]) -> None:
        """Note a task that is being sent to the robot by a command of the viewer `by`."""
        given = _Task({"name": command, "args": dict(args)}, by, begun=part_data.now())
        if command == "go":
            given.place = args["x"], args["y"]
        given.map = part_data.map_data(self._robot.view.info.scene)
        self._tasks[task_id] = given

    def running(self) -> dict[str, Any] | None:
        """Return the running task as in the part `tasks`; None without one."""
        for task_id, each in self._tasks.items():
            if each.known and each.runs:
                return self._entry(task_id, each)
        return None

    def answered(self, task_id: int, ok: bool) -> None:
        """Note that the robot has accepted or refused a task."""
        if not ok:
            self._tasks.pop(task_id, None)
        elif given := self._tasks.get(task_id):  # newer tasks may have removed it meanwhile
            given.known = True
        self._robot.parts.changed()

    def _snapshot(self, info: RobotInfo) -> None:
        """Note the tasks that the robot reports at the beginning of a link."""
        offset = self._robot.chassis.stats.clock_offset or 0.0
        running = info.task_proc.robot_task_id if is_unfinished(info.task_proc) else 0
        for report in info.task_history.tes:
            if report.robot_task_id == running:  # the end of an earlier task with the same id
                continue
            known = self._tasks.get(report.robot_task_id)
            if known is None or known.report.state != report.state:
                self._update(report, int(1000.0 * (report.time - offset)))
        self._reported(info.task_proc)
        for each in self._tasks.values():
            if each.known and each.report.state == task.kStateUndefined and not each.changed:
                each.changed = part_data.now()  # it was accepted, and ended without a link

    def _reported(self, report: TaskProc) -> None:
        """Note a report; it is empty if the robot has no task."""
        if report.robot_task_id and report.state != task.kStateUndefined:
            self._update(report, part_data.now())
        for task_id, each in self._tasks.items():
            # a robot has one task at a time, so all others have ended
            if task_id != report.robot_task_id and each.runs:
                known = each.report
                each.report = TaskProc(robot_task_id=task_id, type=known.type, dest=known.dest)
                each.changed = part_data.now()
        self._robot.parts.changed()

    def _update(self, report: TaskProc, reported: int) -> None:
        """Note a report about a task; `reported` is its Unix time, in milliseconds."""
        known = self._tasks.get(report.robot_task_id)
        # sets repeat their ids; a robot may also retry a task that failed
        begins_again = (
            known is not None
            and is_unfinished(report)
            and known.report.state in (task.kCompleted, task.kCanceled)
        )
        if known is None or begins_again:
            known = self._tasks[report.robot_task_id] = _Task()
            if is_unfinished(report):
                known.begun = reported
                known.map = part_data.map_data(self._robot.view.info.scene)
                # after the other consumers of this report, which know who drives
                asyncio.get_running_loop().call_soon(self._note_driver, known)
        if known.report.state != report.state:
            known.changed = reported
        known.known, known.report = True, report

    def _path_reported(self, path: NavPath) -> None:
        """Note the destination of the running task: the end of its path."""
        end = part_data.points_data(path.path.poses[-1:])
        if not end:
            return
        for each in self._tasks.values():
            navigates = each.runs and each.report.action.type == action.kNav
            if navigates and each.command.get("name") != "go":  # a go has its place already
                each.place = end[0][0], end[0][1]
                self._robot.parts.changed()

    def _note_driver(self, begun: _Task) -> None:
        if begun.runs and self._robot.chassis.state is LinkState.READY:
            begun.by = self._driver().name
            self._robot.parts.changed()

    def _data(self) -> list[dict[str, Any]]:
        known = [(task_id, each) for task_id, each in self._tasks.items() if each.known]
        known.sort(key=lambda entry: entry[1].changed or entry[1].begun, reverse=True)
        return [self._entry(task_id, each) for task_id, each in known]

    def _entry(self, task_id: int, each: _Task) -> dict[str, Any]:
        report = each.report
        unseen = report.state == task.kStateUndefined and each.changed
        failed = report.state == task.kFailed
        return {
            "id": str(task_id),
            "type": enum_name(task.Type, report.type),
            "to": report.dest,
            "place": each.place,
            "state": "unseen" if unseen else part_data.task_state(report),
            "running": each.runs,
            "text": report.msg,
            "code": self._failure(report) if failed else None,
            **each.map,
            "begun": each.begun,
            "changed": each.changed,
            "by": each.by,
            "command": each.command,
        }

    def _failure(self, report: TaskProc) -> dict[str, Any] | None:
        """Return the status code that gives the reason of a failed task; None if unknown."""
        for code in reversed(self._robot.view.codes.values()):
            of_task = code.robot_task_id == report.robot_task_id
            at_its_end = not code.robot_task_id and (
                abs(code.time / 1000.0 - report.time) < _SAME_MOMENT
            )
            if code.level in (StatusCode.kWarn, StatusCode.kFault) and (of_task or at_its_end):
                return part_data.code_data(code)
        return None
