"""Lookup of ROS message, service and action classes by name, and what differs in them."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from functools import cache
from typing import Any


@cache
def class_of(name: str, kind: str = "msg") -> Any:
    """Return the class of a ROS type.

    Args:
        name: package and type, e.g. `woosh_robot_msgs/Twist`.
        kind: `msg`, `srv` or `action`.
    """
    package, short = name.split("/")
    return getattr(importlib.import_module(f"{package}.{kind}"), short)


@cache
def extra_slots(ros_class: Any) -> Mapping[str, Any] | None:
    """Return the values of the slots that a message has besides those of its fields.

    The classes of Jazzy and Kilted have the slot `_check_fields`, and those of Humble have none.

    Returns:
        Values by name, for messages whose slots are set directly; None if that is not possible,
        because ROS checks fields (`ROS_PYTHON_CHECK_FIELDS=1`) or the class has unexpected slots.
    """
    fields = {f"_{name}" for name in ros_class.get_fields_and_field_types()}
    extra = set(ros_class.__slots__) - fields
    if not extra:
        return {} if fields == set(ros_class.__slots__) else None
    if extra != {"_check_fields"} or ros_class()._check_fields:
        return None
    return {"_check_fields": False}
