"""battery_state, plan, footprint and connected: the chassis's state in ROS's own messages."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import Point32, PolygonStamped
from google.protobuf.message import Message
from nav_msgs.msg import Path
from sensor_msgs.msg import BatteryState
from std_msgs.msg import Bool

from woosh_robot_agent.last_known import is_part_of_info, parts_of
from woosh_robot_agent.link import LinkError, LinkState
from woosh_robot_agent.pb.robot.robot_pb2 import Battery, Model, NavPath, RobotInfo
from woosh_robot_agent.standard.audience import Audience
from woosh_robot_agent.standard.part_context import Part, PartContext
from woosh_robot_agent.standard.plane import Plane
from woosh_robot_agent.standard.stamped import stamped

_LOG = logging.getLogger(__name__)
_FOOTPRINT_HZ = 2.0
_CHARGE = {
    Battery.kNot: BatteryState.POWER_SUPPLY_STATUS_DISCHARGING,
    Battery.kManual: BatteryState.POWER_SUPPLY_STATUS_CHARGING,
    Battery.kAuto: BatteryState.POWER_SUPPLY_STATUS_CHARGING,
}


def battery_state(host: PartContext, battery: Battery) -> BatteryState:
    """The battery; what the chassis does not measure is NaN."""
    nan = math.nan
    message = BatteryState(
        voltage=nan,
        temperature=nan,
        current=nan,
        charge=nan,
        capacity=nan,
        design_capacity=nan,
        percentage=min(battery.power, 100) / 100.0,
        power_supply_status=_CHARGE.get(
            battery.charge_state, BatteryState.POWER_SUPPLY_STATUS_UNKNOWN
        ),
        power_supply_technology=BatteryState.POWER_SUPPLY_TECHNOLOGY_UNKNOWN,
        present=True,
    )
    message.header.stamp = host.now()
    message.header.frame_id = host.frame("base")
    return message


def plan(host: PartContext, nav_path: NavPath) -> Path:
    """The path that is driven, in the map's frame; empty when there is none."""
    stamp, frame = host.now(), host.frame("map")
    message = Path(poses=[stamped(Plane.of(pose), frame, stamp) for pose in nav_path.path.poses])
    message.header.stamp = stamp
    message.header.frame_id = frame
    return message


def footprint(host: PartContext, model: Model) -> PolygonStamped:
    """The outline in use, in the robot's frame."""
    message = PolygonStamped()
    message.header.stamp = host.now()
    message.header.frame_id = host.frame("base")
    message.polygon.points = [Point32(x=point.x, y=point.y) for point in model.model]
    return message


class _State(Part):
    """Publishes a message of the chassis in another form: the first value, and each push.

    Args:
        host: see `PartContext`.
        name: the topic.
        cls: the chassis's message.
        convert: makes the one of the other.
        rate: Hz at which the last one is published again while somebody subscribes, with a new
            stamp, so that viewers can draw it where the robot is now; 0 for never.
    """

    def __init__(
        self,
        host: PartContext,
        name: str,
        cls: type[Message],
        convert: Callable[[PartContext, Any], Any],
        rate: float = 0.0,
    ) -> None:
        self._host = host
        self._cls = cls
        self._convert = convert
        self._rate = rate
        self._last: Message | None = None
        self._audience = Audience(host)
        self._publisher = self._audience.publisher(name) if rate else host.publisher(name)
        host.chassis.on_snapshot(self._snapshot)
        if not is_part_of_info(cls):
            host.chassis.on_state(self._ask_when_ready)
        host.chassis.subscribe(cls, self._publish)

    async def run(self) -> None:
        """See `Part.run`."""
        if not self._rate:
            return
        async for _ in self._audience.times(lambda: self._rate):
            if self._host.chassis.state is LinkState.READY and self._last is not None:
                self._publish(self._last)

    def _snapshot(self, info: RobotInfo) -> None:
        for part in parts_of(info):
            if isinstance(part, self._cls):
                self._publish(part)

    def _ask_when_ready(self, state: LinkState) -> None:
        if state is LinkState.READY:
            self._host.thread.spawn(self._ask)

    async def _ask(self) -> None:
        """What RobotInfo does not have."""
        question = self._host.requests.empty(self._cls)
        try:  # it takes no client's room among the requests
            answer = await self._host.chassis.request(question, first=True)
        except LinkError as error:
            _LOG.debug("no first %s: %s", self._cls.DESCRIPTOR.name, error)
            return
        if answer.ok and isinstance(answer.body, self._cls):
            self._publish(answer.body)

    def _publish(self, message: Message) -> None:
        self._last = message
        self._publisher.publish(self._convert(self._host, message))


def battery_part(host: PartContext) -> _State:
    """Makes the part that publishes battery_state."""
    return _State(host, "battery_state", Battery, battery_state)


def plan_part(host: PartContext) -> _State:
    """Makes the part that publishes plan."""
    return _State(host, "plan", NavPath, plan)


def footprint_part(host: PartContext) -> _State:
    """Makes the part that publishes footprint."""
    return _State(host, "footprint", Model, footprint, rate=_FOOTPRINT_HZ)


class Connected(Part):
    """Publishes whether the link is ready, when that changes and at the start."""

    def __init__(self, host: PartContext) -> None:
        self._publisher = host.publisher("connected")
        self._last: bool | None = None
        host.chassis.on_state(self._changed)

    async def run(self) -> None:
        """See `Part.run`: tell those who come before there ever was a link."""
        if self._last is None:
            self._publish(False)

    def _changed(self, state: LinkState) -> None:
        self._publish(state is LinkState.READY)

    def _publish(self, connected: bool) -> None:
        if connected != self._last:
            self._last = connected
            self._publisher.publish(Bool(data=connected))
