"""Creation of ROS messages without their constructor.

The constructor creates all nested messages, only for the caller to replace them. That takes longer
than the rest of a conversion, so fields are set directly in the slots behind the properties. The
constructor and the properties are used if ROS checks fields (`ROS_PYTHON_CHECK_FIELDS=1`), or if a
class has unexpected slots.
"""

from __future__ import annotations

from typing import Any

from woosh_robot_agent.convert.source import Source
from woosh_robot_agent.ros_types import extra_slots


def filled(ros_class: Any, **fields: Any) -> Any:
    """Return a new message. `fields` must name all fields of its class."""
    extra = extra_slots(ros_class)
    if extra is None:
        return ros_class(**fields)
    message = object.__new__(ros_class)
    for name, value in extra.items():
        setattr(message, name, value)
    for name, value in fields.items():
        setattr(message, f"_{name}", value)
    return message


class NewMessage:
    """Generator of source that creates a message and sets its fields.

    Args:
        source: function that the source is added to.
        variable: variable that holds the message.
        ros_class: class of the message.
    """

    def __init__(self, source: Source, variable: str, ros_class: Any) -> None:
        self.source = source
        self._variable = variable
        extra = extra_slots(ros_class)
        self._slot = "" if extra is None else "_"
        bound = source.bind(ros_class)
        if extra is None:
            source.add(f"{variable} = {bound}()")
            return
        source.add(f"{variable} = {source.bind(object.__new__)}({bound})")
        for name, value in extra.items():
            source.add(f"{variable}.{name} = {value!r}")

    def set(self, name: str, expression: str) -> None:
        """Add source that sets a field."""
        self.source.add(f"{self._variable}.{self._slot}{name} = {expression}")
