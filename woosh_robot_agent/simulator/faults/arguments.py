"""Arguments of faults: name, type and range, the same for command line, scenario and Python."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from woosh_robot_agent.protos import message_types

Value = int | float | str

_MAX_NUMBER = 1e300
"""Maximum absolute value of a number, which excludes infinity."""


class FaultError(ValueError):
    """A fault does not exist, or an argument is invalid. The text says what is valid."""


@dataclass(frozen=True)
class Argument:
    """An argument that a fault takes.

    Attributes:
        name: Name of the argument.
        kind: Type of the value.
        default: Default value; None for an optional argument without a default.
        description: Meaning of the argument, for the documentation.
        unit: Unit of a number.
        low: Minimum of a number.
        high: Maximum of a number.
        choices: Valid texts; empty if all texts are valid.
        is_message: The text must be empty or the full name of a protobuf message.
    """

    name: str
    kind: type[int] | type[float] | type[str]
    default: Value | None
    description: str
    unit: str = ""
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()
    is_message: bool = False

    def parse(self, text: str) -> Value:
        """Convert a text of the command line, without checking the value.

        A text that cannot be converted is returned unchanged, and `check` rejects it.
        """
        try:
            return self.kind(text)
        except ValueError:
            return text

    def check(self, value: object) -> Value:
        """Return `value` in the type of the argument.

        Raises:
            FaultError: The value is invalid.
        """
        if self.kind is str:
            if not isinstance(value, str) or (self.choices and value not in self.choices):
                raise self._wrong(value)
            if self.is_message and value and value not in message_types():
                raise FaultError(f"{self.name}: no message has the type {value!r}")
            return value
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self._wrong(value)
        if self.kind is int and not isinstance(value, int):
            raise self._wrong(value)
        if not (self.low <= value <= self.high and abs(value) <= _MAX_NUMBER):
            raise self._wrong(value)
        return self.kind(value)

    @property
    def allowed(self) -> str:
        """Description of the valid values."""
        if self.choices:
            return " or ".join(self.choices)
        if self.is_message:
            return "message type"
        text = {int: "integer", float: "number", str: "text"}[self.kind]
        low, high = math.isfinite(self.low), math.isfinite(self.high)
        if low and high:
            text += f" from {_number(self.low)} to {_number(self.high)}"
        elif low:
            text += f" of at least {_number(self.low)}"
        elif high:
            text += f" of at most {_number(self.high)}"
        return f"{text}, in {self.unit}" if self.unit else text

    def _wrong(self, value: object) -> FaultError:
        return FaultError(f"{self.name}: {value!r} is not {_article(self.allowed)}")


def resolve(
    fault: str, declared: Sequence[Argument], given: Mapping[str, object]
) -> dict[str, Any]:
    """Return the checked arguments, with all defaults filled in.

    Args:
        fault: Name of the fault, for errors.
        declared: All arguments that it takes.
        given: The given arguments. A trailing underscore, as in `for_`, is ignored.

    Raises:
        FaultError: An argument is unknown or invalid.
    """
    known = {argument.name: argument for argument in declared}
    arguments: dict[str, Any] = {name: known[name].default for name in known}
    for key, value in given.items():
        name = key.removesuffix("_")
        if name not in known:
            names = ", ".join(known) or "none"
            raise FaultError(f"{fault} has no argument {name!r}; its arguments are: {names}")
        if value is None and known[name].default is None:
            continue
        try:
            arguments[name] = known[name].check(value)
        except FaultError as error:
            raise FaultError(f"{fault}: {error}") from None
    return arguments


def _number(value: float) -> str:
    return f"{int(value)}" if value == int(value) else f"{value:g}"


def _article(text: str) -> str:
    if " or " in text:
        return text
    return f"{'an' if text[0] in 'aeiou' else 'a'} {text}"
