"""Definitions of ROS types in the form in which rosbag2 stores them."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

_TYPE = re.compile(r"(\w+)/(\w+)")
"""Package and name of a message type within the type of a field."""
_SEPARATOR = "=" * 80


class DefinitionError(Exception):
    """The definition of a type is not installed."""


def definition(name: str) -> str:
    """Return the definition of a message type, followed by those of all types that it uses.

    Args:
        name: Package and name of the type, e.g. `nav_msgs/Odometry`.

    Raises:
        DefinitionError: The package of one of the types is not installed.
    """
    from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

    parts: list[str] = []
    for each in _with_used(name):
        package, short = each.split("/")
        try:
            path = Path(get_package_share_directory(package)) / "msg" / f"{short}.msg"
            text = path.read_text("utf-8")
        except (PackageNotFoundError, OSError) as error:
            raise DefinitionError(f"the definition of {each} cannot be read: {error}") from None
        parts.append(f"{_SEPARATOR}\nMSG: {each}\n{text}" if parts else text)
    return "\n".join(parts)


def _with_used(name: str) -> list[str]:
    """Return a type and all types that it uses, each once."""
    from woosh_robot_agent.ros_types import class_of

    found = [name]
    for each in found:  # which grows
        try:
            cls: Any = class_of(each)
        except (ImportError, AttributeError) as error:
            raise DefinitionError(f"the type {each} is not installed: {error}") from None
        for field in cls.get_fields_and_field_types().values():
            used = _TYPE.search(field)
            if used and used[0] not in found:
                found.append(used[0])
    return found
