"""Reads the files in `tests/facts`."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import yaml

FOLDER = Path(__file__).parent / "facts"


@functools.cache
def facts(name: str) -> Any:
    """Return the content of a YAML file; callers must not change it."""
    # The loader that is written in Python takes ten times as long.
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    return yaml.load((FOLDER / name).read_text("utf-8"), loader)
