"""Texts for people, in English, that the dashboard can show in another language."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping
from typing import Any

SENTENCES: set[str] = set()
"""The patterns of all sentences of the modules that are imported."""
_NO_VALUES: Mapping[str, str | int] = {}  # can be copied and pickled, unlike a MappingProxyType


class Said(str):
    """An English text that also holds its translation key.

    Attributes:
        key: key under which its translations are stored; for a sentence, its pattern.
        values: what was put into the pattern, by the names in braces; some are `Said` too.
    """

    key: str
    values: Mapping[str, str | int]

    def __new__(
        cls, english: str, key: str = "", values: Mapping[str, str | int] = _NO_VALUES
    ) -> Said:
        # copy and pickle call this with the text alone, and set the attributes afterwards
        said = super().__new__(cls, english)
        said.key, said.values = key, values
        return said


class Sentence:
    """A pattern of texts. Call it with the values to get a text.

    Args:
        pattern: the pattern in English, with names in braces. Its translations are stored under it.
    """

    def __init__(self, pattern: str) -> None:
        self._pattern = pattern
        SENTENCES.add(pattern)

    def __call__(self, **values: str | int) -> Said:
        """Return the text with these values."""
        return Said(self._pattern.format_map(values), self._pattern, values)


AND = Sentence("{one}, {other}")
"""Joins two items of a list."""
THEN = Sentence("{one}; {other}")
"""Joins two statements."""
REFUSED = Sentence("refused without a reason")
"""Stands for the reason of a refusal that has none."""
NOT_SENT = Sentence("not sent: {reason}")
"""Tells that something was not sent, and why."""


def joined(pattern: Sentence, parts: Iterable[str]) -> str:
    """Join texts into one, with the pattern `AND` or `THEN`; empty if there are none."""
    found = list(parts)
    return functools.reduce(lambda one, other: pattern(one=one, other=other), found or [""])


def said_by(error: Exception) -> str:
    """Return the text of an error; a `Said` if the error was created with one."""
    said: Any = error.args[0] if len(error.args) == 1 else None
    return said if isinstance(said, Said) else str(error)
