"""Lookup of ROS message, service and action classes by name."""

from __future__ import annotations

import importlib
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
