"""Sentences for people: in English, with what a program needs to say them in another language."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping
from typing import Any

SENTENCES: dict[str, str] = {}
"""The English patterns of all sentences of the modules that are imported, by key."""
_NONE: Mapping[str, str | int] = {}  # can be copied and pickled, unlike a MappingProxyType


class Said(str):
    """A sentence in English.

    Attributes:
        key: key of its pattern.
        values: what was put into it, by the names in braces; some are sentences too.
    """

    key: str
    values: Mapping[str, str | int]

    def __new__(cls, english: str, key: str = "", values: Mapping[str, str | int] = _NONE) -> Said:
        """Make a sentence."""
        said = super().__new__(cls, english)
        said.key, said.values = key, values
        return said


class Sentence:
    """A pattern of sentences. Call it with the values to get one.

    Args:
        key: key of the pattern, which no other one has.
        english: the pattern, with names in braces.
    """

    def __init__(self, key: str, english: str) -> None:
        self._key = key
        self._english = english
        SENTENCES[key] = english

    def __call__(self, **values: str | int) -> Said:
        """Return the sentence with these values."""
        return Said(self._english.format_map(values), self._key, values)


AND = Sentence("said.and", "{one}, {other}")
"""Two parts of a list."""
THEN = Sentence("said.then", "{one}; {other}")
"""Two statements."""
REFUSED = Sentence("refusal.refused", "refused")
"""A refusal without a reason."""
NOT_SENT = Sentence("said.notSent", "not sent: {reason}")
"""Reason for which something was not sent."""


def joined(pattern: Sentence, parts: Iterable[str]) -> str:
    """Return several parts as one, with `AND` or `THEN`; empty without any."""
    found = list(parts)
    return functools.reduce(lambda one, other: pattern(one=one, other=other), found or [""])


def said_by(error: Exception) -> str:
    """Return the text of an error; a `Said` if it was made from one."""
    said: Any = error.args[0] if len(error.args) == 1 else None
    return said if isinstance(said, Said) else str(error)
