"""What a person wrote into a YAML file, read with errors that say where and what is needed."""

from __future__ import annotations

import math
import reprlib
from collections.abc import Collection, Iterator
from typing import Any

import yaml

try:  # ten times faster, where PyYAML was built with it
    from yaml import CSafeLoader as _SafeLoader
except ImportError:
    from yaml import SafeLoader as _SafeLoader  # type: ignore[assignment]

#: Bytes of the largest file: one of this size takes some tenths of a second.
_MOST_BYTES = 256 * 1024
_DEEPEST = 20


class _Loader(_SafeLoader):
    """Reads plain YAML, without merge keys: a few lines of them can grow without bounds."""

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        if any(key.tag == "tag:yaml.org,2002:merge" for key, _ in node.value):
            raise yaml.constructor.ConstructorError(
                problem="merge keys (<<) are not supported: repeat what is to be merged",
                problem_mark=node.start_mark,
            )


class SceneError(ValueError):
    """A file of a scene cannot be used; the text names the file, the fault and the remedy."""


class Node:
    """A value in a YAML file, and where in it the value stands."""

    def __init__(self, value: Any, where: str) -> None:
        self.value = value
        self.where = where

    def error(self, text: str) -> SceneError:
        """An error about this value."""
        return SceneError(f"{self.where}: {text}")

    def shown(self) -> str:
        """This value for people, however long it is."""
        return reprlib.repr(self.value)

    def only(self, keys: Collection[str]) -> Node:
        """This value, which must be a mapping without other keys than these.

        Raises:
            SceneError: It is not.
        """
        self._mapping()
        for key in self.value:
            if key not in keys:
                raise self.error(f"unknown key {reprlib.repr(key)}; known are {', '.join(keys)}")
        return self

    def get(self, key: str) -> Node | None:
        """The value of a key of this mapping, None if it is missing or empty.

        Raises:
            SceneError: This is no mapping.
        """
        value = self._mapping().get(key)
        separator = ": " if self.where.endswith((".yaml", ".yml")) else "."
        return None if value is None else Node(value, f"{self.where}{separator}{key}")

    def need(self, key: str) -> Node:
        """The value of a key of this mapping.

        Raises:
            SceneError: It is missing.
        """
        found = self.get(key)
        if found is None:
            raise self.error(f"{key} is missing")
        return found

    def items(self, most: int) -> Iterator[Node]:
        """The values of this list.

        Raises:
            SceneError: It is no list, or longer than `most`.
        """
        if not isinstance(self.value, list):
            raise self.error("a list is needed")
        if len(self.value) > most:
            raise self.error(f"{len(self.value)} entries are more than {most}")
        for index, value in enumerate(self.value):
            yield Node(value, f"{self.where}[{index}]")

    def text(self) -> str:
        """This text, which must not be empty.

        Raises:
            SceneError: It is something else.
        """
        if not isinstance(self.value, str) or not self.value:
            raise self.error(f"a text is needed, not {self.shown()}; put numbers into quotes")
        return self.value

    def number(self) -> float:
        """This number.

        Raises:
            SceneError: It is something else, infinite or NaN.
        """
        # A bool is an int to Python, and 1e400 an infinity.
        if isinstance(self.value, int | float) and not isinstance(self.value, bool):
            try:
                number = float(self.value)
            except OverflowError:
                number = math.inf
            if math.isfinite(number):
                return number
        raise self.error(f"a number is needed, not {self.shown()}")

    def integer(self, least: int, most: int) -> int:
        """This whole number from `least` to `most`.

        Raises:
            SceneError: It is something else.
        """
        value = self.value
        if isinstance(value, int) and not isinstance(value, bool) and least <= value <= most:
            return value
        raise self.error(f"a whole number from {least} to {most} is needed, not {self.shown()}")

    def numbers(self, shape: str) -> list[float]:
        """As many numbers as `shape` names, which is like "x, y, theta".

        Raises:
            SceneError: They are others, or not as many.
        """
        count = shape.count(",") + 1
        if not isinstance(self.value, list) or len(self.value) != count:
            raise self.error(f"[{shape}] is needed, not {self.shown()}")
        return [item.number() for item in self.items(count)]

    def choice(self, choices: Collection[str]) -> str:
        """This text, one of these.

        Raises:
            SceneError: It is something else.
        """
        if not isinstance(self.value, str) or self.value not in choices:
            raise self.error(f"{self.shown()} is none of {', '.join(choices)}")
        return self.value

    def _mapping(self) -> dict[Any, Any]:
        if not isinstance(self.value, dict):
            raise self.error("a mapping of keys to values is needed")
        return self.value


def parse(name: str, data: bytes) -> Node:
    """The content of a YAML file.

    Args:
        name: The file's name, for errors.
        data: Its bytes.

    Raises:
        SceneError: It is no YAML, or too much of it.
    """
    if len(data) > _MOST_BYTES:
        raise SceneError(f"{name}: {len(data)} bytes are more than {_MOST_BYTES}")
    try:
        depth = 0
        for event in yaml.parse(data, _Loader):
            depth += isinstance(event, yaml.events.CollectionStartEvent)
            depth -= isinstance(event, yaml.events.CollectionEndEvent)
            if depth > _DEEPEST:  # the C loader would crash on thousands
                raise SceneError(f"{name}: nested more than {_DEEPEST} levels deep")
        return Node(yaml.load(data, _Loader), name)
    except SceneError:
        raise
    except (yaml.YAMLError, ValueError) as error:
        # A ValueError comes from what looks like a date and is none.
        reason = " ".join(str(error).split())
        raise SceneError(f"{name}: not readable as YAML: {reason[:300]}") from error
