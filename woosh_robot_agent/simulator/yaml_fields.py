"""Validation of YAML files, with errors that name the place and the expected value."""

from __future__ import annotations

import math
import reprlib
from collections.abc import Collection, Iterator
from typing import Any

import yaml

try:  # ten times as fast, if PyYAML was built with it
    from yaml import CSafeLoader as _SafeLoader
except ImportError:
    from yaml import SafeLoader as _SafeLoader  # type: ignore[assignment]

_MAX_BYTES = 256 * 1024
"""Default of the maximum size of a file, in bytes. Reading one takes some tenths of a second."""

_MAX_DEPTH = 20
"""Maximum nesting depth."""


class _Loader(_SafeLoader):
    """YAML loader without merge keys, which could expand a few lines to any size."""

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        if any(key.tag == "tag:yaml.org,2002:merge" for key, _ in node.value):
            raise yaml.constructor.ConstructorError(
                problem="merge keys (<<) are not supported: repeat the merged keys instead",
                problem_mark=node.start_mark,
            )


class DataFileError(ValueError):
    """A file of a scene or profile cannot be used. The text names file, problem and remedy."""


class Node:
    """A value in a YAML file.

    Attributes:
        value: The value as YAML loads it.
        where: File name and path of the value in the file, for errors.
    """

    def __init__(self, value: Any, where: str) -> None:
        self.value = value
        self.where = where

    def error(self, text: str) -> DataFileError:
        """Return an error about this value."""
        return DataFileError(f"{self.where}: {text}")

    def preview(self) -> str:
        """Return this value as a text of limited length."""
        return reprlib.repr(self.value)

    def check_keys(self, keys: Collection[str]) -> Node:
        """Check that this is a mapping with no other keys than these, and return it.

        Raises:
            DataFileError: This is not a mapping, or it has another key.
        """
        self._mapping()
        for key in self.value:
            if key not in keys:
                raise self.error(f"unknown key {reprlib.repr(key)}; use one of {', '.join(keys)}")
        return self

    def get(self, key: str) -> Node | None:
        """Return the value of a key of this mapping, or None if it is missing or null.

        Raises:
            DataFileError: This is not a mapping.
        """
        value = self._mapping().get(key)
        separator = ": " if self.where.endswith((".yaml", ".yml")) else "."
        return None if value is None else Node(value, f"{self.where}{separator}{key}")

    def required(self, key: str) -> Node:
        """Return the value of a key of this mapping.

        Raises:
            DataFileError: The key is missing.
        """
        found = self.get(key)
        if found is None:
            raise self.error(f"{key} is missing")
        return found

    def items(self, most: int) -> Iterator[Node]:
        """Return the values of this list.

        Raises:
            DataFileError: This is not a list, or it is longer than `most`.
        """
        if not isinstance(self.value, list):
            raise self.error("must be a list")
        if len(self.value) > most:
            raise self.error(f"has {len(self.value)} entries, which is more than {most}")
        for index, value in enumerate(self.value):
            yield Node(value, f"{self.where}[{index}]")

    def text(self) -> str:
        """Return this text, which must not be empty.

        Raises:
            DataFileError: This is not such a text.
        """
        if not isinstance(self.value, str) or not self.value:
            raise self.error(f"must be a text, not {self.preview()}; put numbers into quotes")
        return self.value

    def number(self) -> float:
        """Return this number.

        Raises:
            DataFileError: This is not a number, or it is infinite or NaN.
        """
        # In Python a bool is an int too. 1e400 is read as infinity.
        if isinstance(self.value, int | float) and not isinstance(self.value, bool):
            try:
                number = float(self.value)
            except OverflowError:
                number = math.inf
            if math.isfinite(number):
                return number
        raise self.error(f"must be a number, not {self.preview()}")

    def integer(self, least: int, most: int) -> int:
        """Return this whole number from `least` to `most`.

        Raises:
            DataFileError: This is not such a number.
        """
        value = self.value
        if isinstance(value, int) and not isinstance(value, bool) and least <= value <= most:
            return value
        raise self.error(f"must be a whole number from {least} to {most}, not {self.preview()}")

    def numbers(self, shape: str) -> list[float]:
        """Return this list of numbers.

        Args:
            shape: Names of the numbers, such as "x, y, theta".

        Raises:
            DataFileError: This is not a list of as many numbers.
        """
        count = shape.count(",") + 1
        if not isinstance(self.value, list) or len(self.value) != count:
            raise self.error(f"must be [{shape}], not {self.preview()}")
        return [item.number() for item in self.items(count)]

    def choice(self, choices: Collection[str]) -> str:
        """Return this text, which must be one of `choices`.

        Raises:
            DataFileError: This is not one of them.
        """
        if not isinstance(self.value, str) or self.value not in choices:
            raise self.error(f"{self.preview()} is not one of {', '.join(choices)}")
        return self.value

    def _mapping(self) -> dict[Any, Any]:
        if not isinstance(self.value, dict):
            raise self.error("must be a mapping of keys to values")
        return self.value


def parse(name: str, data: bytes, max_bytes: int = _MAX_BYTES) -> Node:
    """Parse a YAML file.

    Args:
        name: Name of the file, for errors.
        data: Content of the file.
        max_bytes: Maximum size of the file, in bytes.

    Raises:
        DataFileError: The file is not YAML, too large or too deeply nested.
    """
    if len(data) > max_bytes:
        raise DataFileError(f"{name}: the file has {len(data)} bytes, more than {max_bytes}")
    try:
        depth = 0
        for event in yaml.parse(data, _Loader):
            depth += isinstance(event, yaml.events.CollectionStartEvent)
            depth -= isinstance(event, yaml.events.CollectionEndEvent)
            if depth > _MAX_DEPTH:  # the C loader crashes at a depth of some thousands
                raise DataFileError(f"{name}: nested more than {_MAX_DEPTH} levels deep")
        return Node(yaml.load(data, _Loader), name)
    except DataFileError:
        raise
    except (yaml.YAMLError, ValueError) as error:
        # The loader raises ValueError for an invalid date.
        reason = " ".join(str(error).split())
        raise DataFileError(f"{name}: not readable as YAML: {reason[:300]}") from error
