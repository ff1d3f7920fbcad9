"""Meaning of the chassis's status codes, in plain English.

A status code has 12 digits: version, department (1 electrics, 2 embedded control, 3 system,
4 application), 2 of the module, 2 of the submodule, 5 of the function's state, and 1 of the level.
The table comes from the manufacturer's list and was compared with what real robots log.
"""

from __future__ import annotations

import functools
import json
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from woosh_robot_agent.sentences import Said, Sentence

_BOTH = Sentence("{code}: {text} ({meaning})")
_ONE = Sentence("{code}: {text}")
_UNKNOWN = Said("unknown code", "codes.unknown")
TABLE = Path(__file__).with_name("status_codes.json")
"""File of the table: JSON, meanings by code. Generated from tests/facts/status_codes.yaml."""


def meaning(code: int) -> str:
    """Return the meaning of a status code, or an empty string if it is unknown.

    A known meaning is a `Said` whose key is the code in the table.

    Real robots report some codes with another level digit than the table has. Such a code gets the
    meaning of the code in the table that differs only in the level. If the table has several such
    codes, the meaning is unknown, because their meanings are often opposite.
    """
    exact, by_function = _tables()
    return exact.get(code) or by_function.get(code // 10, "")


def explained(code: int, text: str) -> str:
    """Return a status code with its text and its meaning, for a person to read.

    Args:
        code: number of the code.
        text: text that came with the code, in the robot's language; may be empty.

    Returns:
        The number, the text, and in brackets the meaning in English, unless the text contains it.
        Without a text, the number and the meaning.
    """
    known = meaning(code)
    if text and known and known.casefold() not in text.casefold():
        return _BOTH(code=code, text=text, meaning=known)
    return _ONE(code=code, text=text or known or _UNKNOWN)


@functools.cache
def _tables() -> tuple[Mapping[int, str], Mapping[int, str]]:
    """Return the meanings by code, and unambiguous meanings by code without the level digit."""
    table = json.loads(TABLE.read_text("utf-8"))
    exact = {int(code): Said(text, code) for code, text in table.items()}
    levels = Counter(code // 10 for code in exact)
    by_function = {code // 10: text for code, text in exact.items() if levels[code // 10] == 1}
    return exact, by_function
