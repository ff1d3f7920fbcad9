"""What a fault can be told: typed values, the same for command line, scenario file and Python."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from woosh_robot_agent.protos import message_types

Value = int | float | str

#: A number beyond this is a mistake, infinity included.
_MOST = 1e300


class FaultError(ValueError):
    """A fault that does not exist, or cannot be as it was asked for; the text says what can."""


@dataclass(frozen=True)
class Parameter:
    """One argument of a fault.

    Attributes:
        name: As people write it.
        kind: The type of its values.
        default: What it is when left out; None is shown as "-" and stays None.
        description: For people.
        unit: Of a number.
        low: The least number allowed.
        high: The greatest number allowed.
        choices: The texts allowed, if not all are.
        is_message: The text is the full name of a protobuf message, or empty.
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
        """The value that a text on the command line stands for, unchecked.

        What stands for none is left as it is, for `check` to complain of.
        """
        try:
            return self.kind(text)
        except ValueError:
            return text

    def check(self, value: object) -> Value:
        """`value` in the parameter's type.

        Raises:
            FaultError: It does not fit.
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
        if not (self.low <= value <= self.high and abs(value) <= _MOST):
            raise self._wrong(value)
        return self.kind(value)

    @property
    def allowed(self) -> str:
        """What its values are, for people."""
        if self.choices:
            return " or ".join(self.choices)
        if self.is_message:
            return "message type"
        text = {int: "integer", float: "number", str: "text"}[self.kind]
        if math.isfinite(self.low):
            text += f" from {_number(self.low)}"
        if math.isfinite(self.high):
            text += f" to {_number(self.high)}"
        return f"{text} {self.unit}".rstrip()

    def _wrong(self, value: object) -> FaultError:
        return FaultError(f"{self.name}: {value!r} is not {_article(self.allowed)}")


def resolve(
    what: str, parameters: Sequence[Parameter], given: Mapping[str, object]
) -> dict[str, Any]:
    """The arguments with all defaults put in.

    Args:
        what: What they are for, for the text of an error.
        parameters: Those that there are.
        given: What was said. A trailing underscore, as in `for_`, does not count.

    Raises:
        FaultError: One is unknown or does not fit.
    """
    known = {parameter.name: parameter for parameter in parameters}
    arguments: dict[str, Any] = {name: known[name].default for name in known}
    for key, value in given.items():
        name = key.removesuffix("_")
        if name not in known:
            names = ", ".join(known) or "none"
            raise FaultError(f"{what} has no argument {name!r}; its arguments are: {names}")
        if value is None and known[name].default is None:
            continue
        try:
            arguments[name] = known[name].check(value)
        except FaultError as error:
            raise FaultError(f"{what}: {error}") from None
    return arguments


def _number(value: float) -> str:
    return f"{int(value)}" if value == int(value) else f"{value:g}"


def _article(text: str) -> str:
    if " or " in text:
        return text
    return f"{'an' if text[0] in 'aeiou' else 'a'} {text}"
