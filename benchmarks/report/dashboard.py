"""Cost of the page in the browser: CPU time and traffic, by number of viewers.

The robot moves all the time. Its laser has 1080 beams and is requested at 10 Hz, and poses come at
10 Hz. The exit status is 1 if a limit is exceeded.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
import time
from collections.abc import Sequence
from typing import Any
from urllib.parse import urlsplit

from benchmarks.processes import Program, running
from benchmarks.report.table import markdown
from woosh_robot_agent.link.transport.websockets_compat import ClientSocket, Connect
from woosh_robot_agent.testing import own_domain

_VIEWERS = (1, 10)
"""Numbers of viewers."""
_MAX_CPU = 10.0
"""Maximum CPU time of the dashboard with one viewer, in percent of a core."""
_MAX_TRAFFIC = 200.0
"""Maximum traffic per viewer, in kB/s."""
_MAX_LOSS = 0.1
"""Maximum share of the scans that a viewer may miss because of the other viewers."""
_READY = "dashboard ready at "


async def _view(url: str, socket_class: Any, seconds: float) -> tuple[int, int]:
    """Watch for some seconds; return the bytes and the scans that came."""
    place = urlsplit(url).netloc
    header = {
        "additional_headers"
        if "websockets.asyncio" in socket_class.__module__
        else "extra_headers": {"Origin": f"http://{place}"}
    }
    size = scans = 0
    async with Connect(
        f"ws://{place}/live", factory=socket_class, compression=None, **header
    ) as socket:
        while not isinstance(await socket.recv(), bytes):
            pass  # until the first scan; what comes at the beginning comes once
        end = asyncio.get_running_loop().time() + seconds
        while asyncio.get_running_loop().time() < end:
            message = await socket.recv()
            size += len(message)
            scans += isinstance(message, bytes)
    return size, scans


async def _view_all(url: str, viewers: int, seconds: float) -> list[tuple[int, int]]:
    return await asyncio.gather(*(_view(url, ClientSocket, seconds) for _ in range(viewers)))


def _measure(dashboard: Program, url: str, viewers: int, seconds: float) -> dict[str, float]:
    """Return CPU time in percent, traffic per viewer in kB/s, and scans per viewer in Hz."""
    cpu, begin = dashboard.cpu, time.monotonic()
    found = asyncio.run(_view_all(url, viewers, seconds))
    took = time.monotonic() - begin
    return {
        "cpu": 100.0 * (dashboard.cpu - cpu) / took,
        "traffic": max(size for size, _ in found) / seconds / 1000.0,
        "scans": min(scans for _, scans in found) / seconds,
    }


def measure(seconds: float) -> dict[str, dict[str, float]]:
    """Return the figures by number of viewers."""
    with (
        own_domain() as domain,
        running("benchmarks.programs.moving_chassis", domain=domain) as chassis,
    ):
        robot = ("--ip", "127.0.0.1", "--port", str(chassis.receive()), "--page-port", "0")
        with running("woosh_robot_agent.tools.dashboard", *robot, domain=domain) as dashboard:
            assert dashboard.process.stdout is not None
            line = dashboard.process.stdout.readline()
            dashboard.check_running()
            url = line.removeprefix(_READY).strip()
            return {str(each): _measure(dashboard, url, each, seconds) for each in _VIEWERS}


def excess(found: dict[str, dict[str, float]]) -> list[str]:
    """Return the limits that are exceeded."""
    one, *_, many = found.values()
    problems = []
    if one["cpu"] > _MAX_CPU:
        problems.append(f"CPU with one viewer: {one['cpu']:.1f} % of a core, limit {_MAX_CPU:g} %")
    if (traffic := max(each["traffic"] for each in found.values())) > _MAX_TRAFFIC:
        problems.append(f"traffic per viewer: {traffic:.0f} kB/s, limit {_MAX_TRAFFIC:g} kB/s")
    if many["scans"] < one["scans"] * (1.0 - _MAX_LOSS):
        problems.append(f"scans: {many['scans']:.1f} Hz with all viewers, {one['scans']:.1f} alone")
    return problems


def main(arguments: Sequence[str]) -> int:
    """Measure, and print the figures."""
    parser = argparse.ArgumentParser(
        prog="scripts/bench --dashboard",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object, not a table")
    parser.add_argument(
        "--smoke", action="store_true", help="measure for seconds, only to see that it works"
    )
    given = parser.parse_args(arguments)
    found = measure(1.0 if given.smoke else 20.0)
    if given.json:
        print(json.dumps(found))
    else:
        rows = [
            (viewers, f"{each['cpu']:.1f} %", f"{each['traffic']:.1f} kB/s", f"{each['scans']:.1f}")
            for viewers, each in found.items()
        ]
        header = ("viewers", "CPU of a core", "traffic per viewer", "scans per second")
        print(markdown(header, rows, "rrrr"))
    problems = [] if given.smoke else excess(found)
    for problem in problems:
        print(f"exceeded: {problem}", file=sys.stderr)
    return int(bool(problems))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
