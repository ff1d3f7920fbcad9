"""goal_pose, as RViz sends it: navigates there by a MoveBase goal, which `cancel` cancels."""

from __future__ import annotations

import logging
from typing import Any

from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from std_srvs.srv import Trigger

from woosh_robot_agent.bridge import Reply
from woosh_robot_agent.endpoints import ACTIONS
from woosh_robot_agent.pb.ros.action_pb2 import MoveBase, kExecute
from woosh_robot_agent.protos import full_name
from woosh_robot_agent.ros_types import class_of
from woosh_robot_agent.standard.part_context import Part, PartContext
from woosh_robot_agent.standard.plane import Plane
from woosh_robot_agent.standard.stamped import plane_in

_LOG = logging.getLogger(__name__)
(_MOVE_BASE,) = (action for action in ACTIONS if action.arg == full_name(MoveBase))


class GoalPose(Part):
    """A client of the agent's own MoveBase action: the newest goal_pose counts.

    Being an ordinary goal it shows in the action's status, and what the chassis says of it reaches
    the log, as RViz waits for no answer. All of it runs in the executor's thread.
    """

    def __init__(self, host: PartContext) -> None:
        self._host = host
        self._action = class_of(_MOVE_BASE.action, "action")
        self._client = ActionClient(host.node, self._action, _MOVE_BASE.name)
        self._newest = 0
        self._handle: Any = None
        self._sending = False
        self._cancels: list[Reply] = []
        """Cancels that wait until the newest goal is known to the action's server."""
        host.subscribe("goal_pose", self._asked, in_executor=True)
        self._service = host.service("cancel", self._cancel_asked)

    def _asked(self, message: Any) -> None:
        try:
            pose = plane_in(self._host.frame("map"), message.header.frame_id, message.pose)
        except ValueError as error:
            _LOG.error("goal_pose is not obeyed: %s", error)
            return
        self._newest += 1
        number = self._newest
        self._sending = True
        sent = self._client.send_goal_async(self._goal(pose))
        sent.add_done_callback(lambda future: self._sent(number, future))

    def _goal(self, pose: Plane) -> Any:
        goal = self._action.Goal()
        goal.arg.action.value = kExecute
        goal.arg.target_pose.x = pose.x
        goal.arg.target_pose.y = pose.y
        goal.arg.target_pose.theta = pose.theta
        return goal

    def _sent(self, number: int, future: Any) -> None:
        handle = future.result()
        if number == self._newest:
            self._sending = False
            self._handle = handle if handle.accepted else None
            waiting, self._cancels = self._cancels, []
            for reply in waiting:
                self._cancel(reply)
        if handle.accepted:  # the agent accepts all, but while it is being shut down
            result = handle.get_result_async()
            result.add_done_callback(lambda future: self._ended(number, handle, future))

    def _ended(self, number: int, handle: Any, future: Any) -> None:
        if handle is self._handle:
            self._handle = None
        response = future.result()
        if response.status == GoalStatus.STATUS_ABORTED and number == self._newest:
            _LOG.error("goal_pose was not reached: %s", response.result.ret.msg)
        elif response.status == GoalStatus.STATUS_SUCCEEDED:
            _LOG.info("goal_pose was reached")

    def _cancel_asked(self, _request: Any, reply: Reply) -> None:
        if self._sending:
            self._cancels.append(reply)
        else:
            self._cancel(reply)

    def _cancel(self, reply: Reply) -> None:
        if self._handle is None:
            reply.send(Trigger.Response(success=False, message="no goal_pose is being driven to"))
            return
        cancel = self._handle.cancel_goal_async()
        cancel.add_done_callback(lambda future: self._cancelled(reply, future))

    @staticmethod
    def _cancelled(reply: Reply, future: Any) -> None:
        taken = bool(future.result().goals_canceling)
        reply.send(
            Trigger.Response(
                success=taken,
                message="the chassis is told to cancel" if taken else "it had ended already",
            )
        )
