"""initialpose: sets the robot's pose in the map, e.g. from RViz."""

from __future__ import annotations

import logging
from functools import partial
from typing import Any

from woosh_robot_agent.link import LinkError
from woosh_robot_agent.link.log_once import LogOnce
from woosh_robot_agent.pb.robot.robot_pack_pb2 import SetRobotPose
from woosh_robot_agent.standard.part import Part
from woosh_robot_agent.standard.part_context import PartContext
from woosh_robot_agent.standard.pose_messages import from_pose_in

_LOG = logging.getLogger(__name__)


class InitialPose(Part):
    """Sends SetRobotPose for each message on initialpose. Results and errors are logged."""

    def __init__(self, context: PartContext) -> None:
        self._context = context
        self._log = LogOnce(_LOG)
        context.subscribe("initialpose", self._received)

    def _received(self, message: Any) -> None:
        if reason := self._context.robot.chassis.refusal(SetRobotPose()):
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
        self._context.robot.thread.spawn(partial(self._set, request))

    async def _set(self, request: SetRobotPose) -> None:
        try:
            answer = await self._context.robot.chassis.request(
                self._context.robot.requests.address(request)
            )
        except LinkError as error:
            _LOG.error("initialpose was not set: %s", error)
            return
        pose = f"({request.pose.x:.2f}, {request.pose.y:.2f}, {request.pose.theta:.2f})"
        if answer.ok:
            _LOG.info("initialpose: set the robot's pose to %s", pose)
        else:
            _LOG.error("the chassis refused initialpose %s: %s", pose, answer.msg)
