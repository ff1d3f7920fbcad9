"""Generated Python functions: source that is built line by line and compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


class Source:
    """Source of one function.

    Args:
        head: name and arguments of the function, e.g. `fill(p, r)`.
    """

    def __init__(self, head: str) -> None:
        self._function = head.partition("(")[0]
        self._lines = [f"def {head}:"]
        self._names: dict[str, Any] = {}

    def add(self, line: str) -> None:
        """Append a line to the function's body."""
        self._lines.append("    " + line)

    def bind(self, value: Any) -> str:
        """Make a value available to the function; return its generated name."""
        name = f"_{len(self._names)}"
        self._names[name] = value
        return name

    def bind_as(self, name: str, value: Any) -> None:
        """Make a value available to the function under a given name."""
        self._names[name] = value

    def compile(self) -> Callable[..., Any]:
        """Compile and return the function."""
        if len(self._lines) == 1:
            self.add("pass")
        exec("\n".join(self._lines), self._names)
        function: Callable[..., Any] = self._names[self._function]
        return function
