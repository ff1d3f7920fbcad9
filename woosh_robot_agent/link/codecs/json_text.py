"""JSON texts, read and written with orjson if it is installed."""

from __future__ import annotations

import json
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
