"""Names of ROS packages, types and constants, derived from those of protobuf."""

from __future__ import annotations

import re

from google.protobuf.descriptor import Descriptor, EnumDescriptor, OneofDescriptor

from woosh_robot_agent.interfaces.errors import InterfaceError

PACKAGES = {
    "woosh.action": "woosh_action_msgs",
    "woosh.common": "woosh_common_msgs",
    "woosh.map": "woosh_map_msgs",
    "woosh.map.field": "woosh_map_msgs",
    "woosh.map.mark": "woosh_map_msgs",
    "woosh.map.path": "woosh_map_msgs",
    "woosh.nav": "woosh_nav_msgs",
    "woosh.robot": "woosh_robot_msgs",
    "woosh.robot.count": "woosh_robot_msgs",
    "woosh.robot.setting": "woosh_robot_msgs",
    "woosh.ros": "woosh_ros_msgs",
    "woosh.ros.action": "woosh_ros_msgs",
    "woosh.task": "woosh_task_msgs",
}
"""ROS package of each protobuf package that has ROS messages."""

ANY = "google.protobuf.Any"
"""Full name of the protobuf message that holds a message of any type."""
ANY_MESSAGE = "woosh_common_msgs/AnyProto"
"""The ROS message that stands for `ANY`."""

_WORD_STARTS = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")


def message_name(element: Descriptor | EnumDescriptor) -> str:
    """Return package and name of the ROS message, e.g. `woosh_robot_msgs/BatteryChargeState`.

    Raises:
        InterfaceError: its protobuf package has no ROS package.
    """
    if element.full_name == ANY:
        return ANY_MESSAGE
    package: str = element.file.package
    if package not in PACKAGES:
        raise InterfaceError(
            f"a field or an endpoint needs a message without a ROS package; add one to "
            f"interfaces/names.py: {element.full_name}"
        )
    return f"{PACKAGES[package]}/{element.full_name[len(package) :].replace('.', '')}"


def oneof_message_name(oneof: OneofDescriptor) -> str:
    """Return package and name of the ROS message, e.g. `woosh_ros_msgs/CallActionOneOfAction`."""
    return f"{message_name(oneof.containing_type)}OneOf{_camel_case(oneof.name)}"


def enum_constant(value_name: str) -> str:
    """Return the name of an enum value's constant, e.g. `K_ROS_SUCCESS` for `kRosSuccess`."""
    return _WORD_STARTS.sub("_", value_name).upper()


def presence_constant(field_name: str) -> str:
    """Return the name of the constant for a bit of `has_field`, e.g. `POSE_FIELD_SET`."""
    return f"{field_name.upper()}_FIELD_SET"


def member_constant(oneof: OneofDescriptor, member: str = "") -> str:
    """Return the name of the constant for a member of a oneof; by default of that for none."""
    return f"{oneof.name}_{member}_SET".upper() if member else f"{oneof.name}_NOT_SET".upper()


def _camel_case(name: str) -> str:
    return "".join(word.capitalize() for word in name.split("_"))
