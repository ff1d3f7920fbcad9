"""JSON texts, read and written with orjson if it is installed."""

from __future__ import annotations

import json
import re
from typing import Any

try:
    import orjson
except ImportError:  # no rosdep key has it; the standard library takes several times as long
    ORJSON: Any = None
else:
    ORJSON = orjson

_ENCODER = json.JSONEncoder(ensure_ascii=False, separators=(",", ":"), allow_nan=False)


def parse(text: str | bytes) -> Any:
    """Return the value of a JSON text; bytes are UTF-8.

    What orjson refuses is left to the standard library: it also accepts NaN, infinity, numbers
    beyond the range of a double, half a surrogate pair and deeper nesting, and its errors name the
    place.

    Raises:
        UnicodeDecodeError: bytes are not UTF-8.
        ValueError: it is not JSON.
        RecursionError: it is nested too deeply.
    """
    if ORJSON is not None:
        try:
            return ORJSON.loads(text)
        except ORJSON.JSONDecodeError:
            pass
    return json.loads(text if isinstance(text, str) else text.decode())


def parse_in_pieces(text: str | bytes) -> Any:
    """Return the value of a long JSON text, as `parse` does.

    A JSON parser keeps all other threads from running until it has finished. Here it gets pieces,
    with a chance for the others after each.

    Raises:
        UnicodeDecodeError: bytes are not UTF-8.
        ValueError: it is not JSON.
        RecursionError: it is nested too deeply.
    """
    text = text if isinstance(text, str) else text.decode()
    value, end = _value(text, _after_space(text, 0))
    if _after_space(text, end) != len(text):
        raise json.JSONDecodeError("Extra data", text, end)
    return value


_PIECE = 32 * 1024
"""Length of the pieces, in characters. A parser takes about 0.5 ms for one."""
_DECODER = json.JSONDecoder()
_SPACE = re.compile(r"[ \t\n\r]*")
_CLOSING = {"{": "},", "[": "],"}
"""End of an item and the comma after it, by the first character of the items of a list."""
_CUTS = 4
"""Number of places at which a piece of a list may be cut off before its items are parsed singly."""


def _after_space(text: str, at: int) -> int:
    found = _SPACE.match(text, at)
    return at if found is None else found.end()


def _value(text: str, at: int) -> tuple[Any, int]:
    """Return the value that begins at a place of the text, and the place of its end."""
    first = text[at : at + 1]
    if first not in ("{", "["):
        return _scan(text, at)
    try:
        value, length = _scan(text[at : at + _PIECE], 0)
    except json.JSONDecodeError:  # it is longer than a piece, or no JSON
        return _object(text, at) if first == "{" else _list(text, at)
    return value, at + length


def _scan(text: str, at: int) -> tuple[Any, int]:
    return _DECODER.raw_decode(text, at)


def _object(text: str, at: int) -> tuple[dict[str, Any], int]:
    found: dict[str, Any] = {}
    at = _after_space(text, at + 1)
    while text[at : at + 1] != "}":
        if text[at : at + 1] != '"':
            raise json.JSONDecodeError("Expecting property name", text, at)
        name, at = _scan(text, at)
        at = _after_space(text, at)
        if text[at : at + 1] != ":":
            raise json.JSONDecodeError("Expecting ':' delimiter", text, at)
        found[name], at = _value(text, _after_space(text, at + 1))
        at = _after_comma(text, at, "}")
    return found, at + 1


def _list(text: str, at: int) -> tuple[list[Any], int]:
    found: list[Any] = []
    at = _after_space(text, at + 1)
    while text[at : at + 1] != "]":
        items, at = _items(text, at)
        found += items
        at = _after_comma(text, at, "]")
    return found, at + 1


def _items(text: str, at: int) -> tuple[list[Any], int]:
    """Return the next items of a list, at least one, and the place of the end of the last one."""
    closing = _CLOSING.get(text[at : at + 1], ",")
    end = at + _PIECE
    for _ in range(_CUTS):
        end = text.rfind(closing, at, end)
        if end < 0:
            break
        end += len(closing) - 1  # the comma
        if end == at:
            break
        try:
            # If this is a list, the cut was between two of its items, and not inside of one.
            return json.loads(f"[{text[at:end]}]"), end
        except json.JSONDecodeError:
            end -= len(closing) - 1
    item, end = _value(text, at)
    return [item], end


def _after_comma(text: str, at: int, closing: str) -> int:
    """Return the place of the next item or of the closing bracket."""
    at = _after_space(text, at)
    if text[at : at + 1] == ",":
        at = _after_space(text, at + 1)
        if text[at : at + 1] == closing:
            raise json.JSONDecodeError("Illegal trailing comma", text, at)
    elif text[at : at + 1] != closing:
        raise json.JSONDecodeError("Expecting ',' delimiter", text, at)
    return at


def write(value: Any) -> str:
    """Return a value as JSON text without spaces.

    What orjson refuses is left to the standard library: numbers of more than 64 bits, half a
    surrogate pair and deep nesting.

    Args:
        value: a value without NaN and infinity, which JSON does not have.

    Raises:
        TypeError: JSON has no such type.
        RecursionError: it is nested too deeply.
    """
    if ORJSON is not None:
        try:
            text: str = ORJSON.dumps(value).decode()
        except ORJSON.JSONEncodeError:
            pass
        else:
            return text
    return _ENCODER.encode(value)
