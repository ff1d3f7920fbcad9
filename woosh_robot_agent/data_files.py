"""Read YAML, JSON and other plain data into checked dataclasses; errors say where and what to do.

A dataclass describes a mapping: its fields are the keys, and a field without a default is required.
The types of the fields are `str`, `int`, `float`, `bool`, `Any`, `Literal`, enums (by value),
dataclasses, named tuples (lists of numbers), `tuple[X, ...]`, `Mapping[str, X]`, `X | None`, and
each of these as `Annotated[X, check]`. A check is called with the value, and raises ValueError.
"""

from __future__ import annotations

import json
import math
import re
import reprlib
import types
import typing
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from enum import Enum
from typing import Annotated, Any, Literal, TypeVar

import yaml

try:  # ten times as fast, if PyYAML was built with it
    from yaml import CSafeLoader as _SafeLoader
except ImportError:
    from yaml import SafeLoader as _SafeLoader  # type: ignore[assignment]

T = TypeVar("T")

_MAX_BYTES = 256 * 1024
"""Default maximum size of a file, in bytes. Reading such a file takes some tenths of a second."""

_MAX_DEPTH = 20
"""Maximum nesting depth."""

_MAX_VALUES = 200_000
"""Maximum number of values that `structure` reads. Aliases in YAML count each time: a few lists of
them could expand to any number."""


class DataFileError(ValueError):
    """A file cannot be used. The text names file, place, problem and remedy."""


class _Loader(_SafeLoader):
    """YAML loader that refuses what would be lost, or could grow without limit.

    A key that is used twice would lose its first value. A few merge keys could expand to any size,
    so none are supported.
    """

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        """Check the keys of a mapping; PyYAML calls this for each mapping, to expand merge keys."""
        keys = [key for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
        seen: set[tuple[str, str]] = set()
        for key in keys:
            used = (key.tag, key.value)
            problem = f"the key {key.value} is used twice" if used in seen else ""
            if key.tag == "tag:yaml.org,2002:merge":
                problem = "merge keys (<<) are not supported: repeat the merged keys instead"
            if problem:
                raise yaml.constructor.ConstructorError(
                    problem=problem, problem_mark=key.start_mark
                )
            seen.add(used)


def _check_size(name: str, data: bytes, max_bytes: int) -> None:
    if len(data) > max_bytes:
        raise DataFileError(f"{name}: the file has {len(data)} bytes, more than {max_bytes}")


def load_yaml(name: str, data: bytes, max_bytes: int = _MAX_BYTES) -> Any:
    """Return the content of a YAML file.

    Args:
        name: name of the file, for errors.
        data: content of the file.
        max_bytes: maximum size of the file, in bytes.

    Raises:
        DataFileError: the file is not YAML, too large or too deeply nested.
    """
    _check_size(name, data, max_bytes)
    try:
        depth = 0
        for event in yaml.parse(data, _Loader):
            depth += isinstance(event, yaml.events.CollectionStartEvent)
            depth -= isinstance(event, yaml.events.CollectionEndEvent)
            if depth > _MAX_DEPTH:  # the C loader crashes at a depth of some thousands
                raise DataFileError(f"{name}: nested more than {_MAX_DEPTH} levels deep")
        return yaml.load(data, _Loader)
    except DataFileError:
        raise
    except (yaml.YAMLError, ValueError, LookupError, AttributeError) as error:
        # The loader raises other errors than its own for values such as an invalid date.
        reason = " ".join(str(error).split())
        raise DataFileError(f"{name}: not readable as YAML: {reason[:300]}") from error


def load_json(name: str, data: bytes, max_bytes: int = _MAX_BYTES) -> Any:
    """Return the content of a JSON file; arguments and errors are as for `load_yaml`."""
    _check_size(name, data, max_bytes)
    try:
        return json.loads(data)
    except (ValueError, RecursionError) as error:
        raise DataFileError(f"{name}: not readable as JSON: {error}") from error


_WILDCARDS = {"*": "/[^/]+", "**": "(/[^/]+)*"}
"""Wildcards in the node names of a ROS parameter file, as regular expressions."""


def parameter_sections(content: Any, node: str) -> Iterator[tuple[tuple[str, ...], dict[str, Any]]]:
    """Yield each section of a ROS parameter file that is for a node.

    A section is yielded as the keys that lead to it, and its parameters. If several sections set a
    parameter, ROS takes the value in the last one.

    Args:
        content: content of the file. Names of nodes in it may be nested, or contain slashes.
        node: name of the node with its namespace.

    Raises:
        ValueError: the content is not that of a parameter file. ROS refuses it, too.
    """
    for keys, parameters in _sections(content):
        parts = [part for key in keys for part in key.strip("/").split("/")]
        if re.fullmatch("".join(_WILDCARDS.get(p, f"/{re.escape(p)}") for p in parts), node):
            yield keys, parameters


def _sections(
    content: Any, above: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], dict[str, Any]]]:
    """Yield all sections of the content; `above` has the keys that lead to the content."""
    if not isinstance(content, dict):
        raise ValueError("it is not a parameter file: NODE: {ros__parameters: {NAME: VALUE}}")
    for key, value in content.items():
        if key == "ros__parameters" and isinstance(value, dict):
            yield above, value
        else:
            yield from _sections(value, (*above, str(key)))


_SOURCE = "source"
"""Key in the metadata of a dataclass field that marks it as a `source_field`."""


def source_field() -> Any:
    """Return a dataclass field that gets the place of its object in the file, for errors.

    The field is no key of the mapping.
    """
    return field(default="", kw_only=True, compare=False, repr=False, metadata={_SOURCE: True})


@dataclass(frozen=True)
class Between:
    """Check that a number, or the number of entries of a list, is from `least` to `most`."""

    least: float
    most: float = math.inf

    def __call__(self, value: Any) -> None:
        if isinstance(value, tuple):
            if len(value) < self.least:
                raise ValueError(f"has {len(value)} entries, which is less than {self.least}")
            if len(value) > self.most:
                raise ValueError(f"has {len(value)} entries, which is more than {self.most}")
        elif not self.least <= value <= self.most:
            number = "whole number" if isinstance(value, int) else "number"
            limits = f"of at least {self.least}"
            if self.most < math.inf:
                limits = f"from {self.least} to {self.most}"
            raise ValueError(f"must be a {number} {limits}, not {reprlib.repr(value)}")


NotNegative = Annotated[float, Between(0)]
"""A number of at least 0."""


def structure(
    kind: type[T], value: Any, where: str, *, known_only: bool = True, own: bool = False
) -> T:
    """Return plain data as an object of a type, like `cattrs.structure`.

    Args:
        kind: the type; the docstring of this module lists the possible types.
        value: the data, as YAML or JSON loads them.
        where: name of the file, and the path of the value in it, for errors: `FILE: a.b[2]`.
        known_only: True to refuse keys that no field has, False to ignore them.
        own: True for a file that this package has written, not a person: it may have empty texts,
            and any number of values.

    Raises:
        DataFileError: the data do not fit the type.
    """
    return _Reader(known_only, own).read(kind, value, where)  # type: ignore[no-any-return]


class _Reader:
    """Implementation of `structure`, which describes the arguments."""

    def __init__(self, known_only: bool, own: bool) -> None:
        self._known_only = known_only
        self._own = own
        self._count = 0
        """Number of values read so far."""

    def read(self, kind: Any, value: Any, where: str) -> Any:
        """Return plain data as an object of the type `kind`."""
        self._count += 1
        if self._count > _MAX_VALUES and not self._own:
            raise DataFileError(f"{where}: more than {_MAX_VALUES} values; use fewer aliases (*)")
        origin, arguments = typing.get_origin(kind), typing.get_args(kind)
        if origin is Annotated:
            found = self.read(arguments[0], value, where)
            with _errors_at(where):
                for check in arguments[1:]:
                    check(found)
            return found
        if origin in (types.UnionType, typing.Union):
            if value is None:
                return None
            kind = next(each for each in arguments if each is not types.NoneType)
            return self.read(kind, value, where)
        if origin is tuple:
            _check_type(value, list, "a list", where)
            items = enumerate(value)
            return tuple(self.read(arguments[0], each, f"{where}[{n}]") for n, each in items)
        if origin is Mapping:
            _check_type(value, dict, "a mapping of keys to values", where)
            for key in value:
                if not isinstance(key, str):
                    raise DataFileError(f"{where}: the key {reprlib.repr(key)} must be a text")
            return {k: self.read(arguments[1], v, _below(where, k)) for k, v in value.items()}
        if is_dataclass(kind):
            return self._record(kind, value, where)
        if hasattr(kind, "_fields"):  # a named tuple
            return self._named_tuple(kind, value, where)
        if origin is Literal or (isinstance(kind, type) and issubclass(kind, Enum)):
            choices = arguments or [each.value for each in kind]
            if value not in choices:
                text = f"{reprlib.repr(value)} is not one of {', '.join(map(str, choices))}"
                raise DataFileError(f"{where}: {text}")
            return value if arguments else kind(value)
        if kind is Any or (kind is str and value == "" and self._own):
            return value
        return _scalar(kind, value, where)

    def _record(self, kind: Any, value: Any, where: str) -> Any:
        """Return a mapping as an object of a dataclass."""
        _check_type(value, dict, "a mapping of keys to values", where)
        hints = typing.get_type_hints(kind, include_extras=True)
        keys = [each for each in fields(kind) if _SOURCE not in each.metadata]
        names = [each.name for each in keys]
        unknown = [key for key in value if key not in names]
        if unknown and self._known_only:
            text = f"unknown key {reprlib.repr(unknown[0])}; use one of {', '.join(names)}"
            raise DataFileError(f"{where}: {text}")
        values: dict[str, Any] = {
            each.name: where for each in fields(kind) if _SOURCE in each.metadata
        }
        for each in keys:
            hint, path = hints[each.name], _below(where, each.name)
            if value.get(each.name) is not None:
                values[each.name] = self.read(hint, value[each.name], path)
            elif each.default is not MISSING or each.default_factory is not MISSING:
                continue  # null stands for the default
            elif each.name in value and types.NoneType in typing.get_args(hint):
                values[each.name] = None  # a required key whose value may be null
            else:
                raise DataFileError(f"{where}: {each.name} is missing")
        with _errors_at(where):
            return kind(**values)

    def _named_tuple(self, kind: Any, value: Any, where: str) -> Any:
        """Return a list as a named tuple."""
        names, hints = kind._fields, typing.get_type_hints(kind)
        if not isinstance(value, list) or len(value) != len(names):
            text = f"must be [{', '.join(names)}], not {reprlib.repr(value)}"
            raise DataFileError(f"{where}: {text}")
        items = enumerate(zip(names, value, strict=True))
        return kind(*(self.read(hints[name], each, f"{where}[{n}]") for n, (name, each) in items))


def _below(where: str, key: str) -> str:
    """Return the place of the value of `key` in the mapping at `where`: `FILE: a`, `FILE: a.b`."""
    return f"{where}{'.' if ': ' in where else ': '}{key}"


@contextmanager
def _errors_at(where: str) -> Iterator[None]:
    """Turn a ValueError into a DataFileError that names the place."""
    try:
        yield
    except DataFileError:  # it names its place already
        raise
    except ValueError as error:
        raise DataFileError(f"{where}: {error}") from None


def _check_type(value: Any, kind: type, name: str, where: str) -> None:
    if not isinstance(value, kind):
        raise DataFileError(f"{where}: must be {name}")


def _scalar(kind: type, value: Any, where: str) -> Any:
    """Return a text, number or boolean as the type `kind`; an empty text is refused."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)  # a bool is an int
    if kind is float and is_number and abs(value) < math.inf:  # 1e400 is read as infinity
        try:
            return float(value)
        except OverflowError:  # an integer of hundreds of digits
            pass
    if kind is str and isinstance(value, str) and value:
        return value
    if (kind is bool and isinstance(value, bool)) or (kind is int and type(value) is int):
        return value
    names = {float: "a number", int: "a whole number", bool: "true or false", str: "a text"}
    remedy = "; put numbers into quotes" if kind is str else ""
    raise DataFileError(f"{where}: must be {names[kind]}, not {reprlib.repr(value)}{remedy}")
