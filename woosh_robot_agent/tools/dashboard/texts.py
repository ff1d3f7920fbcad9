"""Texts for viewers, which the page shows in its language."""

from __future__ import annotations

import functools
import json
from pathlib import Path
from typing import Any, Union

from woosh_robot_agent.sentences import SENTENCES, Said, Sentence

PAGE = Path(__file__).with_name("page")
"""Folder of the page."""
_REQUEST = Sentence("the request")
"""Stands for the name of a request's type, which means nothing to viewers."""
_TYPES = "woosh."
"""Beginning of the full names of all protobuf types of the robot."""
Value = Union[str, int, float, "Text"]
"""Type of the values in a text. The page translates a `Text` and a `Said`, which is a str."""


class Text:
    """A text in `page/texts/en.json` and `page/texts/zh.json`, which have the same keys.

    `str` returns the text in English.

    Args:
        **values: values for the placeholders of the text, by name.
    """

    def __init__(self, key: str, **values: Value) -> None:
        self._key = key
        self._values = values

    def __str__(self) -> str:
        return english()[self._key].format_map({name: str(v) for name, v in self._values.items()})

    @property
    def data(self) -> dict[str, Any]:
        """The key and the values, for JSON."""
        values = {name: value_data(value) for name, value in self._values.items()}
        return {"key": self._key, "values": values}


def value_data(value: Value) -> Any:
    """Return a value for JSON: a `Text` or `Said` as its key and values, others unchanged.

    A `Said` also has its English text, which the page shows if it has no translation.
    """
    if isinstance(value, Text):
        return value.data
    if isinstance(value, Said):
        value = _without_types(value)
        values = {name: value_data(each) for name, each in value.values.items()}
        return {"key": value.key, "values": values, "english": str(value)}
    return value


def _without_types(said: Said) -> Said:
    """Return a text with "the request" in place of the name of a request's type."""
    if said.key not in SENTENCES:  # a name, not a sentence with values
        return said
    values: dict[str, str | int] = {}
    for name, each in said.values.items():
        is_type = name == "name" and str(each).startswith(_TYPES)
        inner = _without_types(each) if isinstance(each, Said) else each
        values[name] = _REQUEST() if is_type else inner
    if values == said.values:
        return said
    return Said(said.key.format_map(values), said.key, values)


def translated(text: str, languages: str) -> str:
    """Return a text in Chinese if a browser prefers that, otherwise in English.

    Args:
        text: the English text; translated if it is a `Said` made by a `Sentence`.
        languages: the `Accept-Language` header of the browser.
    """
    if not isinstance(text, Said) or text.key not in SENTENCES or not languages.startswith("zh"):
        return text
    return _texts("said.zh")[text.key].format_map(text.values)


def english() -> dict[str, str]:
    """Return the English texts, by key."""
    return _texts("en")


@functools.cache
def _texts(name: str) -> dict[str, str]:
    texts: dict[str, str] = json.loads((PAGE / "texts" / f"{name}.json").read_text("utf-8"))
    return texts
