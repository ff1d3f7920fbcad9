"""The topics initialpose and goal_pose of RViz: set the robot's pose, and navigate to a pose."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Mapping
from functools import partial
from typing import Any

from std_srvs.srv import Trigger

from woosh_robot_agent.link import LinkError
from woosh_robot_agent.link.reports import LogOnce
from woosh_robot_agent.motion.timeliness import SenderClock
from woosh_robot_agent.pb.robot.robot_pack_pb2 import SetRobotPose
from woosh_robot_agent.pb.ros.action_pb2 import MoveBase, kExecute
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction
from woosh_robot_agent.ros.actions.actions import AgentGoal
from woosh_robot_agent.ros.actions.goal import End, Outcome
from woosh_robot_agent.ros.actions.run import REPLACED
from woosh_robot_agent.ros.bridge import Reply
from woosh_robot_agent.ros.standard.part import Part, PartContext
from woosh_robot_agent.ros.standard.poses import from_pose_in

_LOG = logging.getLogger(__name__)


class InitialPose(Part):
    """Sends SetRobotPose for each message on initialpose. Results and errors are logged."""

    def __init__(self, context: PartContext) -> None:
        self._context = context
        self._log = LogOnce(_LOG)
        context.subscribe("initialpose", self._received)

    def _received(self, message: Any) -> None:
        if reason := self._context.chassis.refusal(SetRobotPose()):
            self._log.warn("not permitted", f"initialpose is ignored: {reason}")
            return
        self._log.clear()
        frame = message.header.frame_id
        try:
            pose = from_pose_in(self._context.frame("map"), frame, message.pose.pose)
        except ValueError as error:
            _LOG.error("initialpose is ignored: %s", error)
            return
        request = SetRobotPose()
        request.pose.x, request.pose.y, request.pose.theta = pose.x, pose.y, pose.theta
        self._context.thread.spawn(partial(self._set, request))

    async def _set(self, request: SetRobotPose) -> None:
        try:
            answer = await self._context.chassis.request(self._context.requests.address(request))
        except LinkError as error:
            _LOG.error("initialpose was not set: %s", error)
            return
        pose = f"({request.pose.x:.2f}, {request.pose.y:.2f}, {request.pose.theta:.2f})"
        if answer.ok:
            _LOG.info("initialpose: set the robot's pose to %s", pose)
        else:
            _LOG.error("the chassis refused initialpose %s: %s", pose, answer.reason)


class GoalPose(Part):
    """Starts a goal MoveBase for each message on goal_pose; it replaces the previous one.

    The outcome is logged, because the sender of a topic gets no answer.
    """

    def __init__(self, context: PartContext) -> None:
        self._context = context
        self._log = LogOnce(_LOG)
        self._goals: list[AgentGoal] = []
        """The goals that have not ended, oldest first. The robot may have refused the newest one,
        and still execute the one before."""
        self._clock = SenderClock()
        """Estimates when a goal_pose was published, because late ones are refused."""
        context.subscribe("goal_pose", self._received, with_info=True)
        context.service("cancel", self._cancel_requested)

    def _received(self, message: Any, info: Mapping[str, Any], taken: float) -> None:
        if reason := self._context.chassis.refusal(CallAction()):
            self._log.warn("not permitted", f"goal_pose is ignored: {reason}")
            return
        self._log.clear()
        published = self._clock.of_message(info, taken)
        if objection := self._context.gate.refusal(published):
            _LOG.error("goal_pose is ignored: %s", objection)
            return
        try:
            pose = from_pose_in(self._context.frame("map"), message.header.frame_id, message.pose)
        except ValueError as error:
            _LOG.error("goal_pose is ignored: %s", error)
            return
        command = MoveBase(action=kExecute)
        target = command.target_pose
        target.x, target.y, target.theta = pose.x, pose.y, pose.theta
        goal = self._context.start_goal(command, published=published)
        self._goals.append(goal)
        goal.ended.add_done_callback(partial(self._ended, goal))

    def _ended(self, goal: AgentGoal, ended: asyncio.Future[End]) -> None:
        """Log that a goal was reached, or was aborted unless a newer one replaces it."""
        self._goals.remove(goal)
        end: Any = ended.result()
        if end.outcome is Outcome.ABORTED and end.result.msg != REPLACED:
            _LOG.error("goal_pose was not reached: %s", end.result.msg)
        elif end.outcome is Outcome.SUCCEEDED:
            _LOG.info("goal_pose was reached")

    def _cancel_requested(self, _request: Any, reply: Reply) -> None:
        self._context.thread.spawn(partial(self._cancel, reply), reply.fail)

    async def _cancel(self, reply: Reply) -> None:
        for goal in self._goals:
            goal.cancel()
        is_active = bool(self._goals)
        text = "cancelling" if is_active else "no goal_pose is active"
        reply.send(Trigger.Response(success=is_active, message=text))
