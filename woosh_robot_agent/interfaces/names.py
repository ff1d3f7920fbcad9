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
"""ROS package of each protobuf package whose messages and enums all have a ROS message."""
OTHERS = {
    "woosh.device.RfRemoteController": "woosh_robot_msgs/RfRemoteController",
    "woosh.map.mark.storage.Create": "woosh_map_msgs/StorageCreate",
    "woosh.map.mark.storage.Delete": "woosh_map_msgs/StorageDelete",
    "woosh.map.mark.storage.Find": "woosh_map_msgs/StorageFind",
    "woosh.map.mark.storage.Storages": "woosh_map_msgs/StorageStorages",
    "woosh.map.mark.storage.Update": "woosh_map_msgs/StorageUpdate",
}
"""ROS messages of the messages of other protobuf packages that endpoints need."""

ANY = "google.protobuf.Any"
"""Full name of the protobuf message that holds a message of any type."""
ANY_MESSAGE = "woosh_common_msgs/AnyProto"
"""The ROS message that stands for `ANY`."""

_WORD_STARTS = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")


def has_ros_message(element: Descriptor | EnumDescriptor) -> bool:
    """Return True if a message or an enum has a ROS message of its own."""
    return element.full_name in OTHERS or element.file.package in PACKAGES


def message_name(element: Descriptor | EnumDescriptor) -> str:
    """Return package and name of the ROS message, e.g. `woosh_robot_msgs/BatteryChargeState`.

    Raises:
        InterfaceError: it has no ROS message.
    """
    if element.full_name == ANY:
        return ANY_MESSAGE
    if element.full_name in OTHERS:
        return OTHERS[element.full_name]
    package: str = element.file.package
    if package not in PACKAGES:
        raise InterfaceError(
            f"a field or an endpoint needs a message that has no ROS message; name one in "
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
