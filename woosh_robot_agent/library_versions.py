"""Libraries that are missing, and the oldest releases with which the agent works.

Ubuntu 22.04, the system of ROS 2 Humble, has older ones. With them, imports or the link would fail
with errors that do not tell why.
"""

from __future__ import annotations

import re

_OLDEST = {"websockets": "10.4", "protobuf": "3.21"}
_DISTRIBUTIONS = {"google": "protobuf", "yaml": "pyyaml", "PIL": "pillow"}
"""Names of libraries for pip, by module, where the two differ."""
_ROS = r"_?rclpy\w*|rpyutils|rosidl\w*|ament_index_python|\w+_(msgs|interfaces)"
"""Pattern of the modules that belong to ROS or to its workspace."""


def import_problem(error: ImportError) -> str:
    """Return what is missing, and what to do; empty if the error is a defect of this package."""
    reason = str(error).partition("\n")[0]
    module, _, part = (error.name or "").partition(".")
    if re.fullmatch(_ROS, module):
        return (
            f"ROS is not available ({reason}): source the setup files of ROS and of the workspace"
        )
    if module == __package__:
        return reason if part == "pb" else ""
    if not isinstance(error, ModuleNotFoundError):
        return ""
    name = _DISTRIBUTIONS.get(module, module)
    needed = f"'{name}>={_OLDEST[name]}'" if name in _OLDEST else name
    return f"{name} is not installed here; run: python3 -m pip install {needed}"


def outdated_libraries() -> str:
    """Return which libraries are too old, and what to do; empty if none is.

    Raises:
        ModuleNotFoundError: a library is missing.
    """
    import google.protobuf
    from websockets.version import version as websockets_version

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
