"""Texts for viewers, which the page shows in its language."""

from __future__ import annotations

import functools
import json
from pathlib import Path
from typing import Any

from woosh_robot_agent.sentences import SENTENCES, Said, Sentence

PAGE = Path(__file__).with_name("page")
"""Folder of the page."""
_REQUEST = Sentence("the request")
"""Stands for the name of a request's type, which means nothing to viewers."""
_TYPES = "woosh."
"""Beginning of the full names of all protobuf types of the robot."""


def page_text(key: str, **values: str | int) -> Said:
    """Return a text of `page/texts/en.json` and `page/texts/zh.json`, which have the same keys."""
    return Said(_texts("en")[key].format_map(values), key, values)


def value_data(value: str | int) -> Any:
    """Return a value for JSON: a `Said` as its key, its values and its English text.

    The page shows the English text if it has no translation.
    """
    if isinstance(value, Said):
        value = _without_types(value)
        values = {name: value_data(each) for name, each in value.values.items()}
        return {"key": value.key, "values": values, "english": str(value)}
    return value


def _without_types(said: Said) -> Said:
    """Return a text with "the request" in place of the name of a request's type."""
    values: dict[str, str | int] = {}
    for name, each in said.values.items():
        is_type = name == "name" and str(each).startswith(_TYPES)
        inner = _without_types(each) if isinstance(each, Said) else each
        values[name] = _REQUEST() if is_type else inner
    if values == said.values:
        return said
    pattern = said.key if said.key in SENTENCES else _texts("en")[said.key]
    return Said(pattern.format_map(values), said.key, values)


def translated(text: str, languages: str) -> str:
    """Return a text in Chinese if a browser prefers that, otherwise in English.

    Args:
        text: the English text; translated if it is a `Said` made by a `Sentence`.
        languages: the `Accept-Language` header of the browser.
    """
    if not isinstance(text, Said) or text.key not in SENTENCES or not languages.startswith("zh"):
        return text
    return _texts("said.zh")[text.key].format_map(text.values)


@functools.cache
def _texts(name: str) -> dict[str, str]:
    texts: dict[str, str] = json.loads((PAGE / "texts" / f"{name}.json").read_text("utf-8"))
    return texts
