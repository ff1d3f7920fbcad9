"""JSON texts, read with orjson if it is installed."""

from __future__ import annotations

import json
from typing import Any

try:
    import orjson
except ImportError:  # no rosdep key has it; the standard library takes several times as long
    ORJSON: Any = None
else:
    ORJSON = orjson


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
