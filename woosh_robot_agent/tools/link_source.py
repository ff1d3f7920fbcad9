"""The monitor's view straight from the chassis, without ROS."""

from __future__ import annotations

import time
from dataclasses import replace

from woosh_robot_agent.endpoints import TOPICS
from woosh_robot_agent.link import ChassisClient, LinkConfig, LinkState
from woosh_robot_agent.pb.ros.ros_pack_pb2 import Feedbacks
from woosh_robot_agent.protos import message_type
from woosh_robot_agent.tools.view import LinkReport, View

_RETRY = 3.0
"""Longest pause in s between attempts to connect: somebody is watching."""


class LinkSource:
    """Listens to one chassis. It asks for RobotInfo when it connects, and never commands.

    Args:
        config: how to reach it.

    Attributes:
        name: its address.
        view: what it has said.
    """

    def __init__(self, config: LinkConfig) -> None:
        self.name = config.address
        self.view = View()
        self._chassis = ChassisClient(config=replace(config, backoff_max=_RETRY))
        self._chassis.on_snapshot(self.view.take)
        for topic in TOPICS:
            self._chassis.subscribe(message_type(topic.push), self.view.take)
        self._chassis.subscribe(Feedbacks, self.view.take)

    async def start(self) -> None:
        """See `Source.start`."""
        self._chassis.start()

    async def close(self) -> None:
        """See `Source.close`."""
        await self._chassis.close()

    def link(self) -> LinkReport:
        """See `Source.link`."""
        chassis, stats = self._chassis, self._chassis.stats
        since = time.strftime("%H:%M:%S", time.localtime(chassis.since))
        if chassis.state is LinkState.READY:
            bad, dropped = stats.bad_frames.total(), stats.dropped_pushes.total()
            counts = f"{stats.rx} frames in, {stats.tx} out, {bad} bad, {dropped} dropped"
            took = "" if stats.round_trip is None else f"{stats.round_trip * 1000:.0f} ms, "
            return LinkReport(True, f"connected since {since}", took + counts)
        lost = "lost" if stats.connects else "not connected"
        why = f": {chassis.last_error}" if chassis.last_error else ""
        remedy = f"`doctor --ip {chassis.config.ip}` says what is wrong"
        return LinkReport(False, f"{lost} since {since}, trying again{why}", remedy)
