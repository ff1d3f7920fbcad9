"""The action servers of all actions in the table, and the goals that they accepted."""

from __future__ import annotations

import asyncio
from collections import defaultdict
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.convert import Converter, converter, new_message
from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.endpoints import ACTIONS
from woosh_robot_agent.link import LinkState
from woosh_robot_agent.link.protos import full_name, message_type
from woosh_robot_agent.link.tasks import start_task
from woosh_robot_agent.pb.robot.robot_pb2 import RobotState, TaskProc
from woosh_robot_agent.pb.ros.ros_pack_pb2 import Feedback, Feedbacks
from woosh_robot_agent.ros.actions.calls import CallActionGoal
from woosh_robot_agent.ros.actions.goal import (
    CancelRequested,
    End,
    Event,
    GivenUp,
    GoalClient,
    GoalKind,
    GoalTiming,
    LinkChanged,
    Pushed,
)
from woosh_robot_agent.ros.actions.run import STOPPING, Context, GoalRun, OpenGoals
from woosh_robot_agent.ros.actions.server import Goal, GoalServer
from woosh_robot_agent.ros.actions.tasks import LastReports, TaskGoal, TaskIds, TaskSetGoal
from woosh_robot_agent.ros.context import RobotContext


def _ignore(_report: Message) -> None:
    """Ignore a report."""


class AgentGoal:
    """A goal that the agent itself has started, e.g. for goal_pose. Use it in the link thread.

    Args:
        on_report: called with each report of the chassis on the goal.
        published: loop time at which a ROS client sent the message or goal that this goal carries
            out, as far as that is known; None if the agent starts the goal by itself.

    Attributes:
        accepted: future; True when the chassis accepts the goal, False when it no longer can.
        ended: future of the end.
    """

    accepted: asyncio.Future[bool]

    def __init__(self, on_report: Callable[[Message], None], published: float | None) -> None:
        self.published = published
        self.ended: asyncio.Future[End] = asyncio.get_running_loop().create_future()
        self._on_report = on_report
        self._on_cancel: Callable[[], None] = lambda: None

    def cancel(self) -> None:
        """Cancel the goal at the chassis. The goal ends when the chassis reports its end."""
        self._on_cancel()

    def on_cancel(self, callback: Callable[[], None]) -> None:
        """Call `callback` when the goal is to be cancelled."""
        self._on_cancel = callback

    def feedback(self, report: Message) -> None:
        self._on_report(report)

    def finish(self, end: End) -> None:
        if not self.ended.done():
            self.ended.set_result(end)


class _RosClient:
    """The client of a goal of an action server: converts reports to the messages of the action.

    Args:
        feedback: converts a report to the action's feedback.
        result: converts the last report to the action's result.
        goal: the goal in the action server.
    """

    def __init__(
        self, feedback: Callable[[Message], Any], result: Callable[[Message], Any], goal: Goal
    ) -> None:
        self.published = goal.published
        self.on_cancel = goal.on_cancel
        self._feedback = feedback
        self._result = result
        self._goal = goal

    def feedback(self, report: Message) -> None:
        self._goal.feedback(self._feedback(report))

    def finish(self, end: End) -> None:
        self._goal.finish(end.outcome, self._result(end.result))


@dataclass(frozen=True)
class _Action:
    """The objects that the goals of one action share, whoever starts them."""

    make_kind: Callable[..., GoalKind]
    """Makes the kind of a goal from its command."""
    context: Context
    """Objects shared by the goals whose commands are messages of the chassis."""


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
        """The goals that have not ended, by the asyncio task that runs the goal."""
        self._is_link_ready = False
        self._is_stopping = False
        self._last_feedback: dict[str, Feedback] = {}
        """The last feedback on each call action, by its protobuf full name."""
        self.servers: list[GoalServer] = []
        self.timing = GoalTiming()
        self._actions: dict[str, _Action] = {}
        """All actions, by the protobuf full name of their command."""
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
                explain,
            )
            make_kind: Callable[..., GoalKind]
            if action.member:
                make_kind = partial(
                    CallActionGoal,
                    member=action.member,
                    action=action.arg,
                    last_feedback=self._last_feedback,
                )
            elif action.arg == TaskSetGoal.request_type:
                make_kind = partial(TaskSetGoal, last_known=robot.last_known)
            else:
                make_kind = partial(
                    TaskGoal,
                    ids=task_ids,
                    last_known=robot.last_known,
                    last_reports=self._last_reports,
                )
            self._actions[action.arg] = _Action(
                make_kind, replace(context, to_proto=robot.requests.address)
            )
            accepted = partial(
                self._accepted,
                make_kind,
                context,
                partial(
                    _RosClient,
                    partial(_wrapped, action_class.Feedback, "fb", fb),
                    partial(_wrapped, action_class.Result, "ret", fb),
                ),
            )
            self.servers.append(
                GoalServer(
                    robot.node, robot.thread, action_class, action.name, accepted, result_timeout
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

    def start(
        self,
        command: Message,
        on_report: Callable[[Message], None] = _ignore,
        published: float | None = None,
    ) -> AgentGoal:
        """Start a goal of the agent itself. Call it in the link thread.

        Args:
            command: the command of one of the actions, e.g. MoveBase.
            on_report: called with each report of the chassis on the goal.
            published: as in `AgentGoal`.
        """
        action = self._actions[full_name(command)]
        goal = AgentGoal(on_report, published)
        run = self._start(goal, action.make_kind(command, context=action.context), action.context)
        goal.accepted = run.accepted
        return goal

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

    def _accepted(
        self,
        make_kind: Callable[..., GoalKind],
        context: Context,
        make_client: Callable[[Goal], _RosClient],
        goal: Goal,
    ) -> None:
        self._start(make_client(goal), make_kind(goal.request.arg, context=context), context)

    def _start(self, client: GoalClient, kind: GoalKind, context: Context) -> GoalRun:
        run = GoalRun(client, kind, context)
        client.on_cancel(partial(run.post, CancelRequested()))
        if self._is_stopping:
            run.abort(STOPPING)
            return run
        task = start_task(run.run(), name=f"goal: {run.name}")
        self._runs[task] = run
        task.add_done_callback(self._runs.pop)
        return run

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
    """Return a ROS message whose only field is the converted report."""
    return new_message(ros_class, **{field: convert.to_ros(report)})


def _field_class(part: Any, name: str) -> Any:
    return class_of(part.get_fields_and_field_types()[name], "msg")
