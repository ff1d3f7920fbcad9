"""What a parameter is: a name, a default, a range and a meaning."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor


@dataclass(frozen=True)
class Parameter:
    """One parameter.

    Attributes:
        name: its ROS name.
        default: its default, which also gives its type; a tuple is an array, of so many numbers or
            of any names.
        description: meaning and unit.
        low, high: range of a number, or of each number of an array, both ends included.
        link_field: field of `LinkConfig` that it sets, in s, bytes or pieces; empty for none.
        fixed: whether it can be set at the start only.
    """

    name: str
    default: str | bool | int | float | tuple[float, ...] | tuple[str, ...]
    description: str
    low: float = 0
    high: float = 0
    link_field: str = ""
    fixed: bool = False

    @property
    def initial(self) -> Any:
        """The default as rclpy takes it."""
        return list(self.default) if isinstance(self.default, tuple) else self.default

    @property
    def holds_names(self) -> bool:
        """Whether it is an array of names."""
        return isinstance(self.default, tuple) and isinstance(self.default[0], str)

    @property
    def shown(self) -> str:
        """The default as people write it."""
        if isinstance(self.default, bool):
            return str(self.default).lower()
        if isinstance(self.default, tuple):
            return json.dumps(self.default)
        return str(self.initial)

    @property
    def limits(self) -> str:
        """The range as people read it; empty where there is none."""
        if isinstance(self.default, str | bool) or self.holds_names:
            return ""
        if isinstance(self.default, int):
            return f"{int(self.low)} to {int(self.high)}"
        return f"{self.low:g} to {self.high:g}"

    def descriptor(self) -> ParameterDescriptor:
        """As ROS's tools show it."""
        descriptor = ParameterDescriptor(
            description=self.description,
            read_only=self.fixed,
            # a whole number is accepted where a fractional one is meant
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
        """Look at what rclpy lets through because the type is open: floats.

        Raises:
            ValueError: the value makes no sense; the text says which and why.
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
        if not self.low <= value <= self.high or math.isinf(value):  # nor is NaN
            raise ValueError(f"{self.name} must be in {self.low:g}..{self.high:g}, not {value:g}")
