"""Reads the files in `tests/facts`."""

from __future__ import annotations

import copy
import functools
from pathlib import Path
from typing import Any

import yaml

FOLDER = Path(__file__).parent / "facts"


def facts(name: str) -> Any:
    """Return the content of a YAML file."""
    return copy.deepcopy(_content(name))  # some tests change it


@functools.cache
def _content(name: str) -> Any:
    # The loader that is written in Python takes ten times as long.
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    return yaml.load((FOLDER / name).read_text("utf-8"), loader)
