"""Reads profiles from YAML files.

The shipped profiles are in the folder `data/profiles/`. Their comments describe the keys.
"""

from __future__ import annotations

import dataclasses
import types
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from woosh_robot_agent.simulator.profile import Corner, Profile, Range, Spread
from woosh_robot_agent.simulator.yaml_fields import DataFileError, Node, parse

SHIPPED_FOLDER = Path(__file__).parent / "data" / "profiles"
"""Folder of the shipped profiles."""

SHIPPED = tuple(sorted(path.stem for path in SHIPPED_FOLDER.glob("*.yaml")))
"""Names of the shipped profiles."""

_MAX_ITEMS = 100
"""Maximum number of items of a list."""

_MAX_INTEGER = 2**31 - 1

_T = TypeVar("_T")


def load_profile(source: str | Path | Profile) -> Profile:
    """Return a profile.

    Args:
        source: Name of a shipped profile, path of a file, or a profile, which is returned.

    Raises:
        DataFileError: There is no such profile, or its file cannot be used.
    """
    if isinstance(source, Profile):
        return source
    if str(source) in SHIPPED:
        return _shipped(str(source))
    return _read(Path(source))


@lru_cache
def _shipped(name: str) -> Profile:
    return _read(SHIPPED_FOLDER / f"{name}.yaml")


def _read(path: Path) -> Profile:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise DataFileError(
            f"profile {path}: {error.strerror or error}; give a YAML file, or one of "
            + ", ".join(SHIPPED)
        ) from error
    found: Profile = _section(parse(path.name, data), Profile, name=path.stem)
    return found


def _section(node: Node, kind: type[_T], **given: Any) -> _T:
    """Return a section of the file as an object of the dataclass `kind`.

    Args:
        node: The section, with exactly the attributes of the dataclass as keys.
        kind: The dataclass.
        given: Attributes that are not in the file.
    """
    hints = get_type_hints(kind)
    names = [
        field.name
        for field in dataclasses.fields(kind)  # type: ignore[arg-type]
        if field.name not in given
    ]
    node.check_keys(names)
    values = {name: _value(node, name, hints[name]) for name in names}
    try:
        return kind(**given, **values)
    except ValueError as error:
        raise node.error(str(error)) from None


def _value(section: Node, name: str, kind: Any) -> Any:
    """Return the value of a key, converted to its type."""
    if get_origin(kind) is types.UnionType:
        if name in section.value and section.value[name] is None:
            return None
        kind = next(each for each in get_args(kind) if each is not type(None))
    return _converted(section.required(name), kind)


def _converted(node: Node, kind: Any) -> Any:
    if dataclasses.is_dataclass(kind) and isinstance(kind, type):
        return _section(node, kind)
    if kind is Corner:
        return Corner(*node.numbers("x, y"))
    if kind in (Spread, Range):
        numbers = [_converted(item, float) for item in node.items(len(kind._fields))]
        if len(numbers) < len(kind._fields) or numbers != sorted(numbers):
            raise node.error(f"must be [{', '.join(kind._fields)}], not {node.preview()}")
        return kind(*numbers)
    if get_origin(kind) is tuple:
        return tuple(_converted(item, get_args(kind)[0]) for item in node.items(_MAX_ITEMS))
    if get_origin(kind) is Mapping:
        node.check_keys([key for key in node.value if isinstance(key, str)] if node.value else [])
        return {key: _converted(node.required(key), get_args(kind)[1]) for key in node.value}
    if get_origin(kind) is Literal:
        if node.value not in get_args(kind):
            raise node.error(f"must be one of {', '.join(get_args(kind))}, not {node.preview()}")
        return node.value
    if kind is bool:
        if not isinstance(node.value, bool):
            raise node.error(f"must be true or false, not {node.preview()}")
        return node.value
    if kind is str:
        return node.text()
    if kind is int:
        return node.integer(0, _MAX_INTEGER)
    number = node.number()
    if number < 0.0:
        raise node.error(f"must not be negative, but is {node.preview()}")
    return number
