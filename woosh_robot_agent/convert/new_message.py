"""Creation of ROS messages without their constructor.

The constructor creates all nested messages, only for the caller to replace them. That takes longer
than the rest of a conversion, so fields are set directly in the slots behind the properties. The
constructor and the properties are used if ROS checks fields (`ROS_PYTHON_CHECK_FIELDS=1`), or if a
class has unexpected slots.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from woosh_robot_agent.convert.source import Source


def filled(ros_class: Any, **fields: Any) -> Any:
    """Return a new message. `fields` must name all fields of its class."""
    if not has_known_slots(ros_class):
        return ros_class(**fields)
    message = object.__new__(ros_class)
    message._check_fields = False
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
        self._slot = "_" if has_known_slots(ros_class) else ""
        bound = source.bind(ros_class)
        if self._slot:
            source.add(f"{variable} = {source.bind(object.__new__)}({bound})")
            source.add(f"{variable}._check_fields = False")
        else:
            source.add(f"{variable} = {bound}()")

    def set(self, name: str, expression: str) -> None:
        """Add source that sets a field."""
        self.source.add(f"{self._variable}.{self._slot}{name} = {expression}")


@cache
def has_known_slots(ros_class: Any) -> bool:
    """Return True if a class has the slots that ROS Jazzy generates, and does not check fields."""
    fields = {f"_{name}" for name in ros_class.get_fields_and_field_types()}
    unchecked = getattr(ros_class(), "_check_fields", None) is False
    return unchecked and set(ros_class.__slots__) == fields | {"_check_fields"}
