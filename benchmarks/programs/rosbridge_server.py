"""Run the WebSocket server of rosbridge_suite, as `ros2 run` would.

python -m benchmarks.programs.rosbridge_server

The server replaces this process, chooses a free port and logs it.
"""

from __future__ import annotations

import os
from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_prefix

_PACKAGE = "rosbridge_server"


def executable() -> Path | None:
    """Return the path of the server; None if it is not installed."""
    try:
        return Path(get_package_prefix(_PACKAGE), "lib", _PACKAGE, "rosbridge_websocket")
    except PackageNotFoundError:
        return None


def main() -> None:
    path = executable()
    if path is None:
        raise SystemExit(f"{_PACKAGE} is not installed: install the package of your ROS 2 release")
    os.execv(path, [path, "--ros-args", "-p", "port:=0", "-p", "address:=127.0.0.1"])


if __name__ == "__main__":
    main()
