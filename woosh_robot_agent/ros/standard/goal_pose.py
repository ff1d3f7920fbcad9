"""The topics initialpose and goal_pose of RViz: set the robot's pose, and navigate to a pose."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from functools import partial
from typing import Any

from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from std_srvs.srv import Trigger

from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.endpoints import ACTIONS
from woosh_robot_agent.link import LinkError
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.link.reports import LogOnce
from woosh_robot_agent.motion.timeliness import SenderClock
from woosh_robot_agent.pb.robot.robot_pack_pb2 import SetRobotPose
from woosh_robot_agent.pb.ros.action_pb2 import MoveBase, kExecute
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction
from woosh_robot_agent.ros.actions.run import REPLACED
from woosh_robot_agent.ros.bridge import Reply
from woosh_robot_agent.ros.logs import log_as
from woosh_robot_agent.ros.standard.part import Part, PartContext
from woosh_robot_agent.ros.standard.poses import Pose2D, from_pose_in

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


(_MOVE_BASE,) = (action for action in ACTIONS if action.arg == full_name(MoveBase))
"""The agent's action that navigates to a pose."""


class GoalPose(Part):
    """Client of the agent's own action MoveBase; a new goal_pose replaces the previous one.

    The goal is an ordinary goal of the action, visible in the action's status. Its outcome is
    logged, because the sender of a topic gets no answer. All methods run in the executor thread.
    """

    def __init__(self, context: PartContext) -> None:
        self._context = context
        self._log = LogOnce(_LOG)
        self._action = class_of(_MOVE_BASE.action, "action")
        self._client = ActionClient(context.node, self._action, _MOVE_BASE.name)
        self._handles: list[Any] = []
        """rclpy's handles of the active goals, oldest first. The robot may have refused the newest
        one, and still execute the one before."""
        self._sending: Any = None
        """rclpy's future of the answer to the newest goal; None once it has come."""
        self._waiting_cancels: list[Reply] = []
        """Cancel requests that wait until the action server has answered the newest goal."""
        self._clock = SenderClock()
        """Estimates when a goal_pose was published, because late ones are refused."""
        context.subscribe("goal_pose", self._received, in_executor=True, with_info=True)
        context.service("cancel", self._cancel_requested)

    def close(self) -> None:
        self._client.destroy()  # `Node.destroy_node` leaves it: the node would stay in the graph

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
        if not self._client.server_is_ready():  # the goal would be lost without an answer
            _LOG.error("goal_pose is ignored: the agent is still starting; send it again")
            return
        self._sending = self._client.send_goal_async(self._goal(pose))
        self._sending.add_done_callback(self._goal_answered)

    def _goal(self, pose: Pose2D) -> Any:
        goal = self._action.Goal()
        goal.arg.action.value = kExecute
        goal.arg.target_pose.x = pose.x
        goal.arg.target_pose.y = pose.y
        goal.arg.target_pose.theta = pose.theta
        return goal

    def _goal_answered(self, future: Any) -> None:
        """Keep an accepted goal until it ends; run the cancels that waited for the newest goal."""
        handle = future.result()
        if handle.accepted:
            self._handles.append(handle)
        if future is self._sending:
            self._sending = None
            for reply in self._waiting_cancels:
                self._cancel(reply)
            self._waiting_cancels.clear()
        if handle.accepted:  # always true, except during shutdown
            result = handle.get_result_async()
            result.add_done_callback(lambda future: self._ended(handle, future))

    def _ended(self, handle: Any, future: Any) -> None:
        """Log that a goal was reached, or was aborted unless a newer one replaces it."""
        log_as(self._context.node.get_logger())
        self._handles.remove(handle)
        response = future.result()
        reason = response.result.ret.msg
        if response.status == GoalStatus.STATUS_ABORTED and reason != REPLACED:
            _LOG.error("goal_pose was not reached: %s", reason)
        elif response.status == GoalStatus.STATUS_SUCCEEDED:
            _LOG.info("goal_pose was reached")

    def _cancel_requested(self, _request: Any, reply: Reply) -> None:
        if self._sending is not None:
            self._waiting_cancels.append(reply)
        else:
            self._cancel(reply)

    def _cancel(self, reply: Reply) -> None:
        if not self._handles:
            reply.send(Trigger.Response(success=False, message="no goal_pose is active"))
            return
        # all are cancelled, and the reply tells whether the newest one is
        *_, newest = [handle.cancel_goal_async() for handle in self._handles]
        newest.add_done_callback(lambda future: self._cancelled(reply, future))

    @staticmethod
    def _cancelled(reply: Reply, future: Any) -> None:
        accepted = bool(future.result().goals_canceling)
        reply.send(
            Trigger.Response(
                success=accepted,
                message="cancelling" if accepted else "the goal has ended already",
            )
        )
