"""Monitor data received directly from the chassis, without ROS."""

from __future__ import annotations

from dataclasses import replace

from woosh_robot_agent.endpoints import TOPICS
from woosh_robot_agent.link import ChassisClient, LinkConfig
from woosh_robot_agent.pb.ros.ros_pack_pb2 import Feedbacks
from woosh_robot_agent.protos import message_type
from woosh_robot_agent.tools.link_report import LinkReport, link_report
from woosh_robot_agent.tools.robot_view import RobotView

_MAX_BACKOFF = 3.0
"""Longest pause between attempts to connect, in seconds; short, because a user is watching."""


class LinkSource:
    """Receives from one chassis; implements `Source`.

    It requests RobotInfo with each connection and never commands the robot.

    Args:
        config: Address and timeouts of the chassis.

    Attributes:
        name: Address of the chassis.
        view: State of the robot as received so far.
    """

    def __init__(self, config: LinkConfig) -> None:
        self.name = config.address
        self.view = RobotView()
        self._chassis = ChassisClient(config=replace(config, backoff_max=_MAX_BACKOFF))
        self._chassis.on_snapshot(self.view.update)
        for topic in TOPICS:
            if not topic.on_demand:
                self._chassis.subscribe(message_type(topic.push), self.view.update)
        self._chassis.subscribe(Feedbacks, self.view.update)

    async def start(self) -> None:
        self._chassis.start()

    async def close(self) -> None:
        await self._chassis.close()

    def is_complete(self) -> bool:
        return self.view.has_robot_info

    def link(self) -> LinkReport:
        return link_report(self._chassis)
