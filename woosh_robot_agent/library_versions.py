"""The oldest releases of the libraries with which the agent works.

Ubuntu 22.04, the system of ROS 2 Humble, has older ones. With them, imports or the link would fail
with errors that do not tell why.
"""

from __future__ import annotations

import re

import google.protobuf
from websockets.version import version as websockets_version

_OLDEST = {"websockets": "10.4", "protobuf": "3.21"}


def outdated_libraries() -> str:
    """Return which libraries are too old, and what to do; empty if none is."""
    # protobuf 3.21 from apt reports its version as 4.21 or 3.21
    installed = {"websockets": websockets_version, "protobuf": google.protobuf.__version__}
    old = [name for name in _OLDEST if _release(installed[name]) < _release(_OLDEST[name])]
    if not old:
        return ""
    found = " and ".join(f"{name} {installed[name]}" for name in old)
    needed = " ".join(f"'{name}>={_OLDEST[name]}'" for name in _OLDEST)
    return f"too old: {found}; run: python3 -m pip install {needed}"


def _release(version: str) -> list[int]:
    return [int(part) for part in re.findall(r"\d+", version)[:2]]
