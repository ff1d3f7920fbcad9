"""The reports about tasks: the TaskProc messages that clients receive."""

from __future__ import annotations

from woosh_robot_agent.pb.robot import robot_pb2
from woosh_robot_agent.pb.util import task_pb2 as util_task_pb2
from woosh_robot_agent.simulator.behaviour.robot import Robot


class TaskReports:
    """Pushes the reports about tasks, and keeps the last one.

    Args:
        robot: Pushes the reports.

    Attributes:
        last: The last report, also if it is withheld.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self.last = self._no_task()
        self._withheld = False
        """True if `last` has not been pushed yet."""

    def withhold(self, task: robot_pb2.TaskProc, state: util_task_pb2.State) -> None:
        """Make the first report about a task without pushing it.

        The next report of the task replaces it if both have the same state, and follows it
        otherwise.
        """
        self.last = self._about(task, state)
        self._withheld = True

    def push(
        self,
        task: robot_pb2.TaskProc,
        state: util_task_pb2.State,
        action: robot_pb2.TaskProc.Action | None = None,
        msg: str = "",
    ) -> None:
        """Push a report about a task.

        Args:
            task: The task.
            state: State of the task in the report.
            action: The task's action in the report, None for none.
            msg: Text of the report, if the profile has texts.
        """
        if self._withheld and state != self.last.state:
            self._robot.emit(self.last)
        self._push(self._about(task, state, action, msg))

    def push_empty(self) -> None:
        """Push the report that there is no task."""
        self._push(self._no_task())

    def _push(self, report: robot_pb2.TaskProc) -> None:
        self._withheld = False
        self.last = report
        self._robot.emit(report)

    def _about(
        self,
        task: robot_pb2.TaskProc,
        state: util_task_pb2.State,
        action: robot_pb2.TaskProc.Action | None = None,
        msg: str = "",
    ) -> robot_pb2.TaskProc:
        """Return a new report about a task."""
        report = robot_pb2.TaskProc()
        report.CopyFrom(task)
        report.state = state
        report.time = int(self._robot.time)
        if self._robot.profile.tasks.messages:
            report.msg = msg
        if action is not None:
            report.action.CopyFrom(action)
        return report

    def _no_task(self) -> robot_pb2.TaskProc:
        """Return a new report that there is no task."""
        report = robot_pb2.TaskProc(robot_id=self._robot.robot_id, time=int(self._robot.time))
        report.action.SetInParent()
        return report
