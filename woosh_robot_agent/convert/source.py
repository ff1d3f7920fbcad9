"""Python source of one function, put together line by line and compiled once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


class Source:
    """Source of one function that is put together line by line."""

    def __init__(self, head: str) -> None:
        self._function = head.partition("(")[0]
        self._lines = [f"def {head}:"]
        self._names: dict[str, Any] = {}

    def add(self, line: str) -> None:
        """Add a line."""
        self._lines.append("    " + line)

    def bind(self, value: Any) -> str:
        """Make a value known to the function; returns the name under which it is."""
        name = f"_{len(self._names)}"
        self._names[name] = value
        return name

    def bind_as(self, name: str, value: Any) -> None:
        """Make a value known under a name."""
        self._names[name] = value

    def compile(self) -> Callable[..., Any]:
        """The function."""
        if len(self._lines) == 1:
            self.add("pass")
        exec("\n".join(self._lines), self._names)
        function: Callable[..., Any] = self._names[self._function]
        return function
