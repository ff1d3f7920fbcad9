"""The action servers of all actions in `ACTIONS`, and the goals that they accepted."""

from __future__ import annotations

import asyncio
from collections import defaultdict
from collections.abc import Awaitable, Callable
from dataclasses import replace
from functools import partial
from itertools import chain
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.convert import Converter, converter, new_message
from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.endpoints import ACTIONS, Action
from woosh_robot_agent.link import LinkState
from woosh_robot_agent.link.protos import full_name, message_type
from woosh_robot_agent.link.reports import RecentDict
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
from woosh_robot_agent.ros.actions.run import STOPPING, GoalContext, GoalRun, OpenGoals
from woosh_robot_agent.ros.actions.server import Goal, GoalServer
from woosh_robot_agent.ros.actions.tasks import TaskGoal, TaskSetGoal, unused_task_ids
from woosh_robot_agent.ros.context import RobotContext

_COMMANDS = frozenset(action.arg for action in ACTIONS)
"""Full names of the commands of all actions."""
_MAX_REPORTS = 100
"""Maximum number of tasks whose last report is remembered."""


class AgentGoal:
    """A goal that the agent itself has started, e.g. for a goal of Nav2. Use it in the link thread.

    Args:
        on_report: called with each report of the chassis on the goal.
        published: as in `Actions.start`, which also sets the attributes `accepted` and `cancel`.

    Attributes:
        accepted: future; True once the chassis has accepted the goal, False if it never will.
        cancel: cancels the goal at the chassis; the goal ends when the chassis reports its end.
        ended: future of the end of the goal.
    """

    accepted: asyncio.Future[bool]
    cancel: Callable[[], None]

    def __init__(self, on_report: Callable[[Message], None], published: float | None) -> None:
        self.published = published
        self.ended: asyncio.Future[End] = asyncio.get_running_loop().create_future()
        self.feedback = on_report

    def on_cancel(self, callback: Callable[[], None]) -> None:
        self.cancel = callback

    def finish(self, end: End) -> None:
        if not self.ended.done():
            self.ended.set_result(end)


class _RosClient:
    """The client of a goal of an action server: wraps reports in the messages of the action.

    Args:
        convert: converts reports to the type of the fields `fb` and `ret`.
    """

    def __init__(self, action_class: Any, convert: Converter, goal: Goal) -> None:
        self.published = goal.published
        self.on_cancel = goal.on_cancel
        self._action_class = action_class
        self._convert = convert
        self._goal = goal

    def feedback(self, report: Message) -> None:
        feedback = new_message(self._action_class.Feedback, fb=self._convert.to_ros(report))
        self._goal.feedback(feedback)

    def finish(self, end: End) -> None:
        result = new_message(self._action_class.Result, ret=self._convert.to_ros(end.result))
        self._goal.finish(end.outcome, result)


class Actions:
    """All action servers and their goals.

    Args:
        robot: the objects of the robot. Its link thread also runs the goals.
        explain: returns why the chassis has just refused a request, given its type.
        link_timeout: returns `GoalTiming.link_timeout`, in seconds.
        result_timeout: time for which results are kept, in seconds.

    Attributes:
        timing: timing of the goals that start from now on, except for `link_timeout`.
    """

    def __init__(
        self,
        robot: RobotContext,
        explain: Callable[[str], Awaitable[str]],
        link_timeout: Callable[[], float],
        result_timeout: int,
    ) -> None:
        self._open_goals: defaultdict[str, OpenGoals] = defaultdict(OpenGoals)
        """The open goals of each member of CallAction; tasks and task sets share the key ""."""
        self._runs: dict[asyncio.Task[None], GoalRun] = {}
        """The goals that have not ended, by the asyncio task that runs the goal."""
        self._is_link_ready = False
        self._is_stopping = False
        self._last_feedback: dict[str, Feedback] = {}
        """The last feedback on each action of CallAction, by the full name of its command."""
        self.servers: list[GoalServer] = []
        self.timing = GoalTiming()
        self._starters: dict[str, Callable[[GoalClient, Message], GoalRun]] = {}
        """Functions that start the goals of the agent itself, by the protobuf full name of their
        command."""
        self._last_reports: RecentDict[int, TaskProc] = RecentDict(_MAX_REPORTS)
        """The last report on each of the latest tasks, by task id."""
        task_ids = unused_task_ids()
        for action in ACTIONS:
            context = GoalContext(
                robot.node,
                robot.thread,
                robot.chassis,
                robot.gate,
                robot.last_known,
                robot.requests,
                open_goals=self._open_goals[action.member],
                timing=lambda: replace(self.timing, link_timeout=link_timeout()),
                # the command of a goal of the agent itself is a protobuf message already
                to_proto=robot.requests.address,
                explain=explain,
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
                make_kind = TaskSetGoal
            else:
                make_kind = partial(TaskGoal, unused_ids=task_ids, last_reports=self._last_reports)
            self._starters[action.arg] = partial(self._start, make_kind, context)
            self.servers.append(self._create_server(action, make_kind, context, result_timeout))
        for pushed in (TaskProc, RobotState, Feedbacks):
            robot.chassis.subscribe(pushed, self._pushed)
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
        on_report: Callable[[Message], None] = lambda _report: None,
        published: float | None = None,
    ) -> AgentGoal:
        """Start a goal of the agent itself. Call it in the link thread.

        Args:
            command: the command of one of the actions, e.g. MoveBase.
            on_report: called with each report of the chassis on the goal.
            published: loop time at which a ROS client sent the message or goal that this goal
                carries out, as far as that is known; None if the agent starts it by itself.
        """
        goal = AgentGoal(on_report, published)
        goal.accepted = self._starters[full_name(command)](goal, command).accepted
        return goal

    @property
    def open_goals(self) -> int:
        """Number of goals of the action servers that have not ended."""
        return sum(server.open_goals for server in self.servers)

    @property
    def running_goals(self) -> int:
        """Number of goals that the robot may be executing, also paused; in the link thread."""
        return sum(len(open_goals) for open_goals in self._open_goals.values())

    @property
    def accepted_goals(self) -> list[str]:
        """Names of the open goals that the chassis has accepted; in the link thread."""
        open_goals = chain.from_iterable(self._open_goals.values())
        return [goal.name for goal in open_goals if goal.was_accepted]

    def _create_server(
        self,
        action: Action,
        make_kind: Callable[..., GoalKind],
        context: GoalContext,
        result_timeout: int,
    ) -> GoalServer:
        """Create the action server of an action; it starts a goal for each goal of a ROS client."""
        action_class = class_of(action.action, "action")
        command = converter(_field_class(action_class.Goal, "arg"), message_type(action.arg))
        report = converter(_field_class(action_class.Feedback, "fb"), message_type(action.feedback))
        context = replace(context, to_proto=partial(context.requests.make, command))

        def start(goal: Goal) -> None:
            client = _RosClient(action_class, report, goal)
            self._start(make_kind, context, client, goal.request.arg)

        return GoalServer(
            context.node, context.thread, action_class, action.name, start, result_timeout
        )

    def _start(
        self,
        make_kind: Callable[..., GoalKind],
        context: GoalContext,
        client: GoalClient,
        command: Any,
    ) -> GoalRun:
        """Start a goal, or abort it if the agent is stopping.

        Args:
            make_kind: makes the `GoalKind` of the goal from its command and the context.
            command: a ROS message; a protobuf message if the agent itself starts the goal.
        """
        run = GoalRun(client, make_kind(command, context=context), context)
        client.on_cancel(partial(run.post, CancelRequested()))
        if self._is_stopping:
            run.abort(STOPPING)
            return run
        # not in `run`: before Python 3.12, it begins later, and the next goal must count this one
        context.open_goals.append(run)
        task = start_task(run.run(), name=f"goal: {run.name}")
        self._runs[task] = run
        task.add_done_callback(self._runs.pop)
        return run

    def _pushed(self, message: Message) -> None:
        self._post(Pushed(message))
        if isinstance(message, Feedbacks):
            self._last_feedback.update(
                (feedback.action, feedback)
                for feedback in message.fbs
                if feedback.action in _COMMANDS
            )
        elif isinstance(message, TaskProc) and message.robot_task_id:  # not an empty report
            self._last_reports[message.robot_task_id] = message

    def _link_changed(self, state: LinkState) -> None:
        is_ready = state is LinkState.READY
        if is_ready != self._is_link_ready:
            self._is_link_ready = is_ready
            self._post(LinkChanged(is_ready))

    def _post(self, event: Event) -> None:
        for goal in chain.from_iterable(self._open_goals.values()):
            goal.post(event)


def _field_class(message_class: Any, name: str) -> Any:
    """Return the ROS class of a field of a message class, whose type is a message, too."""
    return class_of(message_class.get_fields_and_field_types()[name], "msg")
