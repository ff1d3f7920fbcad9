"""The publisher of /diagnostics."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray

from woosh_robot_agent.link import LinkState
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo
from woosh_robot_agent.standard.diagnostics.agents_status import agents_status
from woosh_robot_agent.standard.diagnostics.battery_status import battery_status
from woosh_robot_agent.standard.diagnostics.chassis_status import chassis_status
from woosh_robot_agent.standard.diagnostics.clock_status import clock_status
from woosh_robot_agent.standard.diagnostics.codes_status import codes_status
from woosh_robot_agent.standard.diagnostics.hardware_status import hardware_status
from woosh_robot_agent.standard.diagnostics.link_status import link_status
from woosh_robot_agent.standard.diagnostics.motion_status import motion_status
from woosh_robot_agent.standard.diagnostics.status import STALE
from woosh_robot_agent.standard.part import Part
from woosh_robot_agent.standard.part_context import PartContext
from woosh_robot_agent.standard.subscribers import Subscribers

_RATE = 1.0
"""Rate of /diagnostics, in Hz."""


class Diagnostics(Part):
    """Publishes /diagnostics at 1 Hz while there are subscribers. Sends no requests."""

    def __init__(self, context: PartContext) -> None:
        self._context = context
        self._subscribers = Subscribers(context)
        self._publisher = self._subscribers.publisher("/diagnostics")

    async def run(self) -> None:
        await self._subscribers.repeat(lambda: _RATE, self._publish)

    async def _publish(self, _now: float) -> None:
        self._publisher.publish(self._message())

    def _message(self) -> DiagnosticArray:
        chassis = self._context.robot.chassis
        info = self._context.robot.last_known.value(RobotInfo)
        robot = self._context.robot
        statuses = [link_status(chassis, robot.gate.superseded, robot.thread.held)]
        serial = ""
        if info is not None:
            serial = str(info.robot_id or info.genral.serial_number)
            of_robot = [
                chassis_status(info),
                battery_status(info),
                hardware_status(info.hardware_state),
                codes_status(info),
                motion_status(self._context.watch),
                clock_status(chassis.stats.clock_offset),
            ]
            if chassis.state is not LinkState.READY:
                for status in of_robot:
                    status.level = STALE
                    status.texts.insert(0, "no link; last known values")
            statuses += of_robot
        statuses.append(agents_status(self._context.second_agent))
        prefix = self._context.robot.node.get_fully_qualified_name().lstrip("/")
        message = DiagnosticArray(status=[each.message(prefix, serial) for each in statuses])
        message.header.stamp = self._context.now()
        return message
