"""The topics battery_state, plan, footprint and connected."""

from __future__ import annotations

import logging
import math
import struct
from collections.abc import Callable
from functools import partial
from typing import Any

from geometry_msgs.msg import Point32, PolygonStamped
from google.protobuf.message import Message
from nav_msgs.msg import Path
from sensor_msgs.msg import BatteryState
from std_msgs.msg import Bool

from woosh_robot_agent.convert.cdr import HEADER_SIZE, serialize
from woosh_robot_agent.link import Answer, LinkError, LinkState
from woosh_robot_agent.link.tasks import LARGE, offload
from woosh_robot_agent.pb.robot.robot_pb2 import Battery, Model, NavPath, RobotInfo
from woosh_robot_agent.robot.last_known import is_part_of_info, parts_of
from woosh_robot_agent.ros.standard.part import Part, PartContext
from woosh_robot_agent.ros.standard.poses import check_finite
from woosh_robot_agent.ros.subscribers import publish_readiness

_LOG = logging.getLogger(__name__)
_FOOTPRINT_RATE = 2.0
"""Rate of footprint, in Hz."""
_BATTERY_RATE = 1.0
"""Rate of battery_state, in Hz. Robots report the battery every 500 s, and many subscribers, such
as free_fleet's, do not ask for the latched message."""
_CHARGE = {
    Battery.kNot: BatteryState.POWER_SUPPLY_STATUS_DISCHARGING,
    Battery.kManual: BatteryState.POWER_SUPPLY_STATUS_CHARGING,
    Battery.kAuto: BatteryState.POWER_SUPPLY_STATUS_CHARGING,
}
"""Status of the power supply by the chassis's `charge_state`."""


def battery_state(context: PartContext, battery: Battery) -> BatteryState:
    """Return the state of the battery; values that the chassis does not measure are NaN."""
    nan = math.nan
    return BatteryState(
        header=context.header("base"),
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


def plan(context: PartContext, nav_path: NavPath) -> bytes:
    """Return the path that the robot is following as a serialized nav_msgs/Path, in the map frame.

    The message is empty if the robot follows no path. It is serialized directly: a ROS message for
    each pose would take a second for a path of 60,000 poses.

    Raises:
        ValueError: a pose is not finite.
    """
    header = context.header("map")
    pose_header = serialize(header)[HEADER_SIZE:]
    path = bytearray(serialize(Path(header=header)))
    # an empty message ends with the number of its poses, which is 0
    path[-4:] = struct.pack("=I", len(nav_path.path.poses))
    pack = struct.Struct("=7d").pack
    for pose in nav_path.path.poses:
        check_finite("pose", pose.x, pose.y, pose.theta)
        half_yaw = pose.theta / 2
        path += pose_header
        path += bytes((HEADER_SIZE - len(path)) % 8)  # CDR aligns 64-bit numbers after its header
        # x, y, z, and the rotation as the quaternion x, y, z, w
        path += pack(pose.x, pose.y, 0.0, 0.0, 0.0, math.sin(half_yaw), math.cos(half_yaw))
    return bytes(path)


def footprint(context: PartContext, model: Model) -> PolygonStamped:
    """Return the current outline of the robot, in the base frame.

    Raises:
        ValueError: a corner is not finite.
    """
    for point in model.model:
        check_finite("corner", point.x, point.y)
    message = PolygonStamped(header=context.header("base"))
    message.polygon.points = [Point32(x=point.x, y=point.y) for point in model.model]
    return message


class _ValuePart(Part):
    """Publishes one type of value of the chassis as a ROS message.

    On each new link, the value comes from the first RobotInfo, or from a request if RobotInfo has
    no such part. Then each push is published. A value that the ROS message cannot hold is skipped
    and counted.

    Args:
        convert: converts the value into a ROS message, or into a serialized one; raises ValueError
            if that is not possible. A large push is converted in another thread.
        rate: rate at which the last value is repeated with a new stamp while there are
            subscribers, in Hz, e.g. so that viewers draw it at the robot's current pose; 0 for
            never.
    """

    def __init__(
        self,
        context: PartContext,
        name: str,
        proto_class: type[Message],
        convert: Callable[[PartContext, Any], Any],
        rate: float = 0.0,
    ) -> None:
        self._context = context
        self._proto_class = proto_class
        self._convert = convert
        self._rate = rate
        self._last: Message | None = None
        """The last value; None if it is unknown."""
        self._subscribers = context.subscribers()
        self._publisher = context.publisher(name, self._subscribers if rate else None)
        context.chassis.on_snapshot(self._publish_snapshot, self._convert_snapshot)
        if not is_part_of_info(proto_class):
            context.chassis.on_state(self._link_changed)
        context.chassis.subscribe_raw(
            proto_class,
            self._publish_converted,
            lambda body: self._convert_or_error(body.message()),
        )

    async def run(self) -> None:
        if self._rate:
            await self._subscribers.repeat(lambda: self._rate, self._republish)

    async def _republish(self, _now: float) -> None:
        if self._context.chassis.state is LinkState.READY and self._last is not None:
            last = self._last
            convert = self._convert_or_error
            is_large = last.ByteSize() >= LARGE
            converted = await offload(convert, last) if is_large else convert(last)
            if last is self._last:  # otherwise a push was published meanwhile
                self._publish_converted(converted)

    def _convert_snapshot(self, info: RobotInfo) -> list[tuple[Message, Any]]:
        return [
            self._convert_or_error(part)
            for part in parts_of(info)
            if isinstance(part, self._proto_class)
        ]

    def _publish_snapshot(self, converted: list[tuple[Message, Any]]) -> None:
        for each in converted:
            self._publish_converted(each)

    def _link_changed(self, state: LinkState) -> None:
        if state is LinkState.READY:
            self._context.thread.spawn(self._request)

    async def _request(self) -> None:
        """Request the first value of a type that is not part of RobotInfo."""
        request = self._context.requests.empty(self._proto_class)
        try:
            # `first`: ahead of pending requests, regardless of max_in_flight
            await self._context.chassis.request(request, first=True, tap=self._answered)
        except LinkError as error:
            _LOG.debug("cannot request the first %s: %s", self._proto_class.DESCRIPTOR.name, error)

    def _answered(self, answer: Answer) -> None:
        """Publish the first value, in order with the pushes, so that it replaces no newer value."""
        is_usable = answer.ok and not answer.is_outdated
        if is_usable and isinstance(answer.body, self._proto_class):
            self._publish_converted(self._convert_or_error(answer.body))

    def _convert_or_error(self, value: Message) -> tuple[Message, Any]:
        """Return a value, and its serialized ROS message or the ValueError of its conversion.

        The error is returned, because this may run in another thread, and bad values are counted in
        the link thread.
        """
        try:
            message = self._convert(self._context, value)
            return (value, message if isinstance(message, bytes) else serialize(message))
        except ValueError as error:
            return (value, error)

    def _publish_converted(self, converted: tuple[Message, Any]) -> None:
        value, message = converted
        if isinstance(message, ValueError):
            self._context.chassis.count_bad_value(self._proto_class, str(message))
            return
        self._last = value
        self._publisher.publish(message)


battery_part = partial(
    _ValuePart,
    name="battery_state",
    proto_class=Battery,
    convert=battery_state,
    rate=_BATTERY_RATE,
)
plan_part = partial(_ValuePart, name="plan", proto_class=NavPath, convert=plan)
footprint_part = partial(
    _ValuePart, name="footprint", proto_class=Model, convert=footprint, rate=_FOOTPRINT_RATE
)


class Connected(Part):
    """Publishes whether the link is ready on the topic connected."""

    def __init__(self, context: PartContext) -> None:
        publisher = context.publisher("connected")
        publish_readiness(context.chassis, publisher, lambda ready: Bool(data=ready))
