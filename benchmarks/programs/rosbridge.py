"""The server of rosbridge_suite, and a chassis that speaks its protocol.

    python -m benchmarks.programs.rosbridge server
    python -m benchmarks.programs.rosbridge URL

The server replaces this process, as `ros2 run` does; it chooses a free port and logs it. The
chassis offers a service and publishes a topic. It answers each call of PoseSpeed at once with the
same message. Like `programs/chassis.py`, it does as little as it can. Each line on stdin is a
command:

    push RATE FIRST COUNT    publish COUNT messages of PoseSpeed at RATE Hz, with `mileage` counting
                             from FIRST; then print, as JSON, the time of each message
                             (time.monotonic) and the CPU time of all of them, in seconds
"""

from __future__ import annotations

import json
import os
import re
import sys
import time
from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_prefix

from benchmarks.floors.bare_socket import BareSocket

_PACKAGE = "rosbridge_server"
_NAME = "/woosh_robot/robot/PoseSpeed"
"""Name of the topic and of the service."""
_VALUES = {
    "twist": {"linear": 0.5, "angular": 0.1},
    "pose": {"x": 4.23276472, "y": -6.6727581, "theta": -0.255771846},
    "map_id": 3,
    "mileage": 0,
}
_ID = re.compile(rb'"id": ?"([^"]*)"')
_PLACEHOLDER = "PLACEHOLDER"


def server_path() -> Path | None:
    """Return the path of the server; None if it is not installed."""
    try:
        return Path(get_package_prefix(_PACKAGE), "lib", _PACKAGE, "rosbridge_websocket")
    except PackageNotFoundError:
        return None


def serve() -> None:
    """Replace this process by the server."""
    path = server_path()
    if path is None:
        raise SystemExit(f"{_PACKAGE} is not installed: install the package of your ROS 2 release")
    os.execv(path, [path, "--ros-args", "-p", "port:=0", "-p", "address:=127.0.0.1"])


class RosbridgeChassis:
    """Offers the service and the topic at a server of rosbridge."""

    def __init__(self, url: str) -> None:
        answer = {
            "op": "service_response",
            "service": _NAME,
            "id": _PLACEHOLDER,
            "values": {"info": _VALUES},
            "result": True,
        }
        self._before, self._after = json.dumps(answer).split(_PLACEHOLDER)
        self._socket = BareSocket(url, self._answer)
        for op, key, kind in (
            ("advertise", "topic", "msg"),
            ("advertise_service", "service", "srv"),
        ):
            offer = {"op": op, key: _NAME, "type": f"woosh_robot_msgs/{kind}/PoseSpeed"}
            self._socket.send(json.dumps(offer))

    def _answer(self, frame: bytes) -> None:
        if found := _ID.search(frame):
            self._socket.send(f"{self._before}{found[1].decode()}{self._after}")

    def push(self, rate: float, first: int, count: int) -> None:
        """Publish as the command `push` says, and print the report."""
        frames = [
            json.dumps({"op": "publish", "topic": _NAME, "msg": {**_VALUES, "mileage": number}})
            for number in range(first, first + count)
        ]
        sent = []
        cpu = time.process_time()
        due = time.monotonic()
        for frame in frames:
            sent.append(time.monotonic())
            self._socket.send(frame)
            due += 1 / rate
            time.sleep(max(0.0, due - time.monotonic()))
        print(json.dumps({"sent": sent, "cpu": time.process_time() - cpu}), flush=True)


def main(what: str) -> None:
    if what == "server":
        serve()
    chassis = RosbridgeChassis(what)
    for line in sys.stdin:
        _, rate, first, count = line.split()
        chassis.push(float(rate), int(first), int(count))


if __name__ == "__main__":
    try:
        main(sys.argv[1])
    except KeyboardInterrupt:
        pass
