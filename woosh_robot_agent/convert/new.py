"""New ROS messages without their constructor.

It makes each message inside the new one, and then the caller puts another one in its place; that
takes longer than all the rest. So fields are set in the slots behind the properties. Where ROS
checks fields (`ROS_PYTHON_CHECK_FIELDS=1`), or where a class has other slots than expected, the
constructor and the properties are used.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from woosh_robot_agent.convert.source import Source


def filled(ros_class: Any, **fields: Any) -> Any:
    """A new message with these fields, which must be all that its class has."""
    if not has_known_slots(ros_class):
        return ros_class(**fields)
    message = object.__new__(ros_class)
    message._check_fields = False
    for name, value in fields.items():
        setattr(message, f"_{name}", value)
    return message


class New:
    """Source that makes a message and sets its fields.

    Args:
        source: where it goes.
        variable: name of the message in it.
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
        """Set a field."""
        self.source.add(f"{self._variable}.{self._slot}{name} = {expression}")


@cache
def has_known_slots(ros_class: Any) -> bool:
    """Whether the fields of a class are where today's ROS has them, and not to be checked."""
    fields = {f"_{name}" for name in ros_class.get_fields_and_field_types()}
    unchecked = getattr(ros_class(), "_check_fields", None) is False
    return unchecked and set(ros_class.__slots__) == fields | {"_check_fields"}
