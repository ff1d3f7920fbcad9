"""The action servers of all actions in the table, and the goals that they accepted."""

from __future__ import annotations

import asyncio
from collections import defaultdict
from collections.abc import Awaitable, Callable
from dataclasses import replace
from functools import partial
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.convert import Converter, converter, filled
from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.endpoints import ACTIONS
from woosh_robot_agent.link import LinkState
from woosh_robot_agent.link.protos import message_type
from woosh_robot_agent.link.tasks import start_task
from woosh_robot_agent.pb.robot.robot_pb2 import RobotState, TaskProc
from woosh_robot_agent.pb.ros.ros_pack_pb2 import Feedback, Feedbacks
from woosh_robot_agent.ros.actions.calls import CallActionGoal
from woosh_robot_agent.ros.actions.goal import (
    CancelRequested,
    Event,
    GivenUp,
    GoalKind,
    GoalTiming,
    LinkChanged,
    Pushed,
)
from woosh_robot_agent.ros.actions.run import STOPPING, Context, GoalRun, OpenGoals
from woosh_robot_agent.ros.actions.server import Goal, GoalServer
from woosh_robot_agent.ros.actions.tasks import LastReports, TaskGoal, TaskIds, TaskSetGoal
from woosh_robot_agent.ros.context import RobotContext


class Actions:
    """All action servers and their goals.

    Args:
        robot: the objects of the robot. Its link thread also runs the goals.
        explain: returns why the chassis has just refused a request, given its type.
        link_timeout: returns `GoalTiming.link_timeout`, in seconds.
        result_timeout: time for which results are kept, in seconds.

    Attributes:
        servers: the action servers.
        timing: timing of the goals that start from now on, except for `link_timeout`.
    """

    def __init__(
        self,
        robot: RobotContext,
        explain: Callable[[str], Awaitable[str]],
        link_timeout: Callable[[], float],
        result_timeout: int,
    ) -> None:
        self._link_timeout = link_timeout
        self._open_goals: defaultdict[str, OpenGoals] = defaultdict(OpenGoals)
        """The open goals of each member of CallAction; all tasks have the key ""."""
        self._runs: dict[asyncio.Task[None], GoalRun] = {}
        """The goals that have not ended, by the task of each."""
        self._is_link_ready = False
        self._is_stopping = False
        self._last_feedback: dict[str, Feedback] = {}
        """The last feedback on each call action, by its protobuf full name."""
        self.servers: list[GoalServer] = []
        self.timing = GoalTiming()
        self._last_reports = LastReports()
        task_ids = TaskIds()
        for action in ACTIONS:
            action_class = class_of(action.action, "action")
            arg, fb = (
                converter(_field_class(part, name), message_type(proto_name))
                for part, name, proto_name in (
                    (action_class.Goal, "arg", action.arg),
                    (action_class.Feedback, "fb", action.feedback),
                )
            )
            context = Context(
                robot.chassis,
                robot.gate,
                self._open_goals[action.member],
                self._timing,
                partial(robot.requests.make, arg),
                robot.requests.empty,
                partial(_wrapped, action_class.Feedback, "fb", fb),
                partial(_wrapped, action_class.Result, "ret", fb),
                explain,
            )
            make_kind: Callable[[Any], GoalKind]
            if action.member:
                make_kind = partial(
                    CallActionGoal,
                    context=context,
                    member=action.member,
                    action=action.arg,
                    last_feedback=self._last_feedback,
                )
            elif action.arg == TaskSetGoal.request_type:
                make_kind = partial(TaskSetGoal, context=context, last_known=robot.last_known)
            else:
                make_kind = partial(
                    TaskGoal,
                    context=context,
                    ids=task_ids,
                    last_known=robot.last_known,
                    last_reports=self._last_reports,
                )
            start = partial(self._start, make_kind, context)
            self.servers.append(
                GoalServer(
                    robot.node, robot.thread, action_class, action.name, start, result_timeout
                )
            )
        for report in (TaskProc, RobotState, Feedbacks):
            robot.chassis.subscribe(report, self._pushed)
        robot.chassis.on_state(self._link_changed)

    async def stop(self) -> None:
        """Abort the open goals, and all that arrive later. Call it in the link thread."""
        self._is_stopping = True
        runs = dict(self._runs)
        for task in runs:
            task.cancel()
        await asyncio.gather(*runs, return_exceptions=True)
        for run in runs.values():  # a task that had not started has ended no goal
            run.abort(STOPPING)

    def give_up(self, reason: str) -> None:
        """Abort the open goals with `reason` in their results. Call it in the link thread."""
        self._post(GivenUp(reason))

    @property
    def open_goals(self) -> int:
        """Number of goals that have not ended."""
        return sum(server.open_goals for server in self.servers)

    @property
    def running_goals(self) -> int:
        """Number of goals that the robot may be executing; in the link thread."""
        return sum(len(open_goals) for open_goals in self._open_goals.values())

    @property
    def accepted_goals(self) -> list[str]:
        """Names of the goals that the chassis has accepted; in the link thread."""
        open_goals = self._open_goals.values()
        return [name for each in open_goals for name in each.accepted_names]

    def _timing(self) -> GoalTiming:
        return replace(self.timing, link_timeout=self._link_timeout())

    def _start(self, make_kind: Callable[[Any], GoalKind], context: Context, goal: Goal) -> None:
        run = GoalRun(goal, make_kind(goal.request.arg), context)
        goal.on_cancel(partial(run.post, CancelRequested()))
        if self._is_stopping:
            run.abort(STOPPING)
            return
        task = start_task(run.run(), name=f"goal: {run.name}")
        self._runs[task] = run
        task.add_done_callback(self._runs.pop)

    def _pushed(self, message: Message) -> None:
        self._post(Pushed(message))
        if isinstance(message, Feedbacks):
            self._last_feedback.update((feedback.action, feedback) for feedback in message.fbs)
        elif isinstance(message, TaskProc):
            self._last_reports.add(message)

    def _link_changed(self, state: LinkState) -> None:
        ready = state is LinkState.READY
        if ready != self._is_link_ready:
            self._is_link_ready = ready
            self._post(LinkChanged(ready))

    def _post(self, event: Event) -> None:
        for open_goals in self._open_goals.values():
            open_goals.post(event)


def _wrapped(ros_class: Any, field: str, convert: Converter, report: Message) -> Any:
    """Return a report as the only field of a ROS message."""
    return filled(ros_class, **{field: convert.to_ros(report)})


def _field_class(part: Any, name: str) -> Any:
    return class_of(part.get_fields_and_field_types()[name], "msg")
