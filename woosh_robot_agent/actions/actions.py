"""All actions of the table, put together."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.actions.call_actions import CallActionRun
from woosh_robot_agent.actions.events import CancelAsked, Event, LinkChanged, Report
from woosh_robot_agent.actions.run import STOPPING, Context, GoalRun, Runs
from woosh_robot_agent.actions.server import Goal, GoalServer
from woosh_robot_agent.actions.tasks import FreshIds, TaskRun
from woosh_robot_agent.bridge import LinkThread
from woosh_robot_agent.convert import converter
from woosh_robot_agent.endpoints import ACTIONS
from woosh_robot_agent.last_known import LastKnown
from woosh_robot_agent.link import ChassisClient, LinkState
from woosh_robot_agent.motion.gate import MotionGate
from woosh_robot_agent.pb.robot.robot_pb2 import TaskProc
from woosh_robot_agent.pb.ros.ros_pack_pb2 import Feedback, Feedbacks
from woosh_robot_agent.protos import message_type
from woosh_robot_agent.requests import RequestMaker
from woosh_robot_agent.ros_types import class_of


class Actions:
    """All action servers, and the runs of their goals.

    Args:
        node: owner of the servers.
        thread: runs the link and the goals.
        chassis: to be used in the link's thread only.
        gate: passes commands on.
        known: what the chassis last said.
        requests: makes the chassis's messages of the clients'.
        link_timeout: gives the s for which a goal stays open without a link.
        result_timeout: s for which results are kept.
    """

    def __init__(
        self,
        node: Any,
        thread: LinkThread,
        chassis: ChassisClient,
        gate: MotionGate,
        known: LastKnown,
        requests: RequestMaker,
        link_timeout: Callable[[], float],
        result_timeout: int,
    ) -> None:
        self._thread = thread
        self._chassis = chassis
        self._runs: list[Runs] = []
        self._tasks: set[asyncio.Task[None]] = set()
        self._ready = False
        self._stopping = False
        self._feedbacks: dict[str, Feedback] = {}
        self.servers: list[GoalServer] = []
        ids = FreshIds()
        for action in ACTIONS:
            action_class = class_of(action.action, "action")
            arg, fb = (
                converter(_field_class(part, name), message_type(proto_name))
                for part, name, proto_name in (
                    (action_class.Goal, "arg", action.arg),
                    (action_class.Feedback, "fb", action.feedback),
                )
            )
            runs = Runs()
            self._runs.append(runs)
            to_proto = partial(requests.make, arg)
            context = Context(
                chassis, gate, runs, link_timeout, to_proto, requests.empty, fb.to_ros
            )
            make = (
                partial(
                    CallActionRun,
                    context=context,
                    member=action.member,
                    action=action.arg,
                    known=self._feedbacks,
                )
                if action.member
                else partial(TaskRun, context=context, ids=ids, known=known)
            )
            self.servers.append(
                GoalServer(
                    node, action_class, action.name, partial(self._start, make), result_timeout
                )
            )
        for report in (TaskProc, Feedbacks):
            chassis.subscribe(report, self._reported)
        chassis.on_state(self._link_changed)

    async def stop(self) -> None:
        """Abort the open goals, and any that still come; in the link's thread."""
        self._stopping = True
        tasks = tuple(self._tasks)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    def destroy(self) -> None:
        """Take the servers off the graph; rclpy's `destroy_node` leaves them there."""
        for server in self.servers:
            server.destroy()

    @property
    def open_goals(self) -> int:
        """Goals that have not ended yet, their results included."""
        return sum(server.open_goals for server in self.servers)

    @property
    def running_goals(self) -> int:
        """Goals that the robot may be at work on; in the link's thread."""
        return sum(len(runs.open) for runs in self._runs)

    def _start(self, make: Callable[[Goal], GoalRun], goal: Goal) -> None:
        self._thread.spawn(partial(self._run, make, goal))

    async def _run(self, make: Callable[[Goal], GoalRun], goal: Goal) -> None:
        run = make(goal)
        goal.on_cancel(partial(self._thread.call, run.post, CancelAsked()))
        if self._stopping:
            run.finish(run.aborted(STOPPING))
            return
        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)
        try:
            await run.run()
        finally:
            self._tasks.discard(task)

    def _reported(self, message: Message) -> None:
        self._post(Report(message))
        if isinstance(message, Feedbacks):
            self._feedbacks.update((feedback.action, feedback) for feedback in message.fbs)

    def _link_changed(self, state: LinkState) -> None:
        ready = state is LinkState.READY
        if ready != self._ready:
            self._ready = ready
            self._post(LinkChanged(ready))

    def _post(self, event: Event) -> None:
        for runs in self._runs:
            runs.post(event)


def _field_class(part: Any, name: str) -> Any:
    return class_of(part.get_fields_and_field_types()[name], "msg")
