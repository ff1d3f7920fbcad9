"""The error for a JSON value that does not fit its protobuf field."""

from __future__ import annotations

import reprlib

BAD_VALUE = (ValueError, TypeError, OverflowError)
"""Exceptions that a setter or a converter raises for a value that does not fit."""

_LONGEST_VALUE = 60
_LONGEST_REASON = 100
_REPR = reprlib.Repr()  # plain repr() takes seconds for a map, and fails on deep nesting
_REPR.maxlevel = 3
_REPR.maxstring = _REPR.maxother = 40


class FieldError(ValueError):
    """A value that does not fit its field.

    Attributes:
        path: path of the field inside the message, e.g. `pose.x` or `steps[2].mode`.
        reason: the text without the path.
    """

    def __init__(self, path: str, reason: str) -> None:
        super().__init__(f"{path}: {reason}" if path else reason)
        self.path = path
        self.reason = reason

    def below(self, outer: str) -> FieldError:
        """Return the same error with the field or the list index `outer` put before its path."""
        separator = "" if not self.path or self.path.startswith("[") else "."
        return FieldError(f"{outer}{separator}{self.path}", self.reason)


def misfit(path: str, value: object, error: Exception) -> FieldError:
    """Return the error for `value`, which was refused with `error`."""
    why = _cut(str(error), _LONGEST_REASON)  # `float()` repeats a value of many MiB in its text
    return FieldError(path, f"{brief_repr(value)} does not fit ({why})")


def brief_repr(value: object) -> str:
    """Return the start of a value's representation, for an error text."""
    return _cut(_REPR.repr(value), _LONGEST_VALUE)


def _cut(text: str, limit: int) -> str:
    return text if len(text) <= limit else text[: limit - 3] + "..."
