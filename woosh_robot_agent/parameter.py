"""Description of one ROS parameter: name, default, range and meaning."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor


@dataclass(frozen=True)
class Parameter:
    """A parameter of the agent.

    Attributes:
        name: ROS name.
        default: default, which also determines the type. A tuple of numbers is an array of that
            length, a tuple of strings an array of any number of names.
        description: meaning and unit, one sentence.
        low, high: range of a number or of each number of an array, both ends included.
        read_only: True if it can be set only at start-up.
    """

    name: str
    default: str | bool | int | float | tuple[float, ...] | tuple[str, ...]
    description: str
    low: float = 0
    high: float = 0
    read_only: bool = False

    @property
    def initial(self) -> Any:
        """The default in the form that rclpy takes."""
        return list(self.default) if isinstance(self.default, tuple) else self.default

    @property
    def holds_names(self) -> bool:
        """True if it is an array of names."""
        return isinstance(self.default, tuple) and isinstance(self.default[0], str)

    @property
    def shown(self) -> str:
        """The default as documentation shows it."""
        if isinstance(self.default, bool):
            return str(self.default).lower()
        if isinstance(self.default, tuple):
            return json.dumps(self.default)
        return str(self.initial)

    @property
    def limits(self) -> str:
        """The range as documentation shows it; empty if there is none."""
        if isinstance(self.default, str | bool) or self.holds_names:
            return ""
        if isinstance(self.default, int):
            return f"{int(self.low)} to {int(self.high)}"
        return f"{self.low:g} to {self.high:g}"

    def descriptor(self) -> ParameterDescriptor:
        """Return the ROS descriptor, which tools such as `ros2 param describe` show."""
        descriptor = ParameterDescriptor(
            description=self.description,
            read_only=self.read_only,
            # accept an integer for a floating-point number
            dynamic_typing=isinstance(self.default, float | tuple) and not self.holds_names,
        )
        if isinstance(self.default, bool):
            return descriptor
        if isinstance(self.default, int):
            descriptor.integer_range = [
                IntegerRange(from_value=int(self.low), to_value=int(self.high), step=1)
            ]
        elif isinstance(self.default, float):
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=float(self.low), to_value=float(self.high), step=0.0)
            ]
        return descriptor

    def check(self, value: Any) -> None:
        """Check a value that rclpy does not check because of dynamic typing.

        Raises:
            ValueError: the value is invalid; the text says which one and why.
        """
        if isinstance(self.default, float):
            self._check_number(value)
        elif isinstance(self.default, tuple) and not self.holds_names:
            if not isinstance(value, Sequence) and not hasattr(value, "tolist"):
                raise ValueError(f"{self.name} must be a list of numbers, not {value!r}")
            if len(value) != len(self.default):
                raise ValueError(f"{self.name} must have {len(self.default)} numbers")
            for number in value:
                self._check_number(number)

    def _check_number(self, value: Any) -> None:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError(f"{self.name} must be a number, not {value!r}")
        if not self.low <= value <= self.high or math.isinf(value):  # also refuses NaN
            raise ValueError(
                f"{self.name} must be from {self.low:g} to {self.high:g}, not {value:g}"
            )


def parameter_field(
    default: Any, description: str, low: float = 0, high: float = 0, *, read_only: bool = False
) -> Any:
    """Return a dataclass field that declares a parameter of its name; see `Parameter`."""
    metadata = {
        "default": default,
        "description": description,
        "low": low,
        "high": high,
        "read_only": read_only,
    }
    return dataclasses.field(default=default, metadata=metadata)


def parameters_of(settings_class: Any) -> tuple[Parameter, ...]:
    """Return the parameters that a dataclass declares with `parameter_field`, in order."""
    return tuple(
        Parameter(name=each.name, **each.metadata)
        for each in dataclasses.fields(settings_class)
        if each.metadata
    )
