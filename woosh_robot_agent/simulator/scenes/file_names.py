"""Names of files and of the scenes and maps that clients name."""

from __future__ import annotations

from pathlib import PurePosixPath, PureWindowsPath

MAX_NAME = 255
"""Maximum length of a name, in characters."""


def is_plain(name: str) -> bool:
    """Return True if a name is not empty and is a file name, not a path, on every system."""
    plain = PurePosixPath(name).name == PureWindowsPath(name).name == name
    return plain and name not in ("", "..") and name.isprintable() and len(name) <= MAX_NAME
