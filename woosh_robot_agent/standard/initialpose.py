"""initialpose, as RViz sends it: tells the chassis where it is."""

from __future__ import annotations

import logging
from functools import partial
from typing import Any

from woosh_robot_agent.link import LinkError
from woosh_robot_agent.pb.robot.robot_pack_pb2 import SetRobotPose
from woosh_robot_agent.standard.part_context import Part, PartContext
from woosh_robot_agent.standard.stamped import plane_in

_LOG = logging.getLogger(__name__)


class InitialPose(Part):
    """Does SetRobotPose for each initialpose. Its sender gets no answer, so the log tells."""

    def __init__(self, host: PartContext) -> None:
        self._host = host
        host.subscribe("initialpose", self._asked)

    def _asked(self, message: Any) -> None:
        try:
            pose = plane_in(self._host.frame("map"), message.header.frame_id, message.pose.pose)
        except ValueError as error:
            _LOG.error("initialpose is not obeyed: %s", error)
            return
        request = SetRobotPose()
        request.pose.x, request.pose.y, request.pose.theta = pose.x, pose.y, pose.theta
        self._host.thread.spawn(partial(self._set, request))

    async def _set(self, request: SetRobotPose) -> None:
        try:
            answer = await self._host.chassis.request(self._host.requests.address(request))
        except LinkError as error:
            _LOG.error("initialpose was not set: %s", error)
            return
        where = f"({request.pose.x:.2f}, {request.pose.y:.2f}, {request.pose.theta:.2f})"
        if answer.ok:
            _LOG.info("initialpose: the robot is at %s now", where)
        else:
            _LOG.error("the chassis refused initialpose %s: %s", where, answer.msg)
