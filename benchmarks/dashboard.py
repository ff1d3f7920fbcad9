"""Cost of the page: of its server, by number of viewers, and in the browser, if there is one.

For the server, the robot moves all the time. Its laser has 1080 beams and is requested at 10 Hz,
and poses come at 10 Hz. In the browser, the page loads from this machine; then the stick drives a
simulated robot, while the processor of the browser is slowed down by a factor of 4; and then the
page receives the messages of an hour as fast as it can. The exit status is 1 if a limit is
exceeded.
"""

from __future__ import annotations

import asyncio
import contextlib
import statistics
import time
from collections.abc import Sequence

from benchmarks import page
from benchmarks.figures import markdown
from benchmarks.options import make_parser, report
from benchmarks.processes import Program, running, running_chassis
from benchmarks.programs.page_viewers import connect, first_scan
from woosh_robot_agent.link import ChassisClient, LinkConfig, LinkState
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed
from woosh_robot_agent.testing import own_domain
from woosh_robot_agent.tools.dashboard.server import Dashboard, DashboardConfig

_VIEWERS = (1, 10)
"""Numbers of viewers."""
_MAX_CPU = 10.0
"""Maximum CPU time of the dashboard with all viewers, in percent of a core."""
_MAX_TRAFFIC = 200.0
"""Maximum traffic per viewer, in kB/s."""
_MAX_LOSS = 0.1
"""Maximum share of the scans that a viewer may miss because of the other viewers."""
_MAX_SLOWDOWN = 1.5
"""Maximum factor by which the viewers may lengthen the median round trip of the link."""
_MAX_LOAD = {"bytes": 300_000, "seconds": 1.0}
"""Maximum size of the first load, and maximum time until the map is there."""
_MIN_FRAMES = 57.0
"""Minimum number of frames in a second while the robot drives; the screen shows 60."""
_MAX_GROWTH = 1000.0
"""Maximum growth of the page's memory over an hour, in kB."""
_TURNS = 5
"""Number of times that the link is measured without and with viewers."""
_READY = "dashboard ready at "


async def _view(url: str, seconds: float) -> tuple[int, int]:
    """Watch for some seconds; return the bytes and the scans that came."""
    size = scans = 0
    async with connect(url) as socket:
        await first_scan(socket)
        end = asyncio.get_running_loop().time() + seconds
        while asyncio.get_running_loop().time() < end:
            message = await socket.recv()
            size += len(message)
            scans += isinstance(message, bytes)
    return size, scans


async def _view_all(url: str, viewers: int, seconds: float) -> list[tuple[int, int]]:
    return await asyncio.gather(*(_view(url, seconds) for _ in range(viewers)))


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


async def _round_trips(client: ChassisClient, seconds: float) -> list[float]:
    """Return the times of requests of the dashboard's link until their answers, in milliseconds."""
    found = []
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        begin = time.perf_counter()
        await client.request(PoseSpeed())
        found.append(1000.0 * (time.perf_counter() - begin))
        await asyncio.sleep(0.005)
    return found


async def _link_latency(port: int, seconds: float, domain: int) -> dict[str, float]:
    """Return the round-trip time of the link without viewers and with all of them, in ms.

    Both are measured in turns, because the machine may not be equally fast all the time.
    """
    alone, watched = [], []
    async with Dashboard([LinkConfig("127.0.0.1", port)], DashboardConfig(port=0)) as dashboard:
        client = dashboard.robots[0].chassis
        while client.state is not LinkState.READY:
            await asyncio.sleep(0.05)
        for _ in range(_TURNS):
            alone += await _round_trips(client, seconds / _TURNS)
            with contextlib.ExitStack() as stack:
                program = ("benchmarks.programs.page_viewers", dashboard.url, str(_VIEWERS[-1]))
                viewers = stack.enter_context(running(*program, domain=domain))
                await asyncio.to_thread(viewers.receive)
                watched += await _round_trips(client, seconds / _TURNS)
                await asyncio.to_thread(stack.close)  # their sockets are closed by this loop
    return {
        "alone": statistics.median(alone),
        "watched": statistics.median(watched),
        "alone_p99": statistics.quantiles(alone, n=100)[98],
        "watched_p99": statistics.quantiles(watched, n=100)[98],
    }


def measure(seconds: float) -> dict[str, dict[str, float]]:
    """Return the figures by number of viewers, and those of the link."""
    with (
        own_domain() as domain,
        running_chassis(domain) as (chassis, port),
    ):
        chassis.send("move")
        robot = ("dashboard", "--ip", f"127.0.0.1:{port}", "--page-port", "0")
        with running("woosh_robot_agent.tools", *robot, domain=domain) as dashboard:
            assert dashboard.process.stdout is not None
            line = dashboard.process.stdout.readline()
            dashboard.check_running()
            url = line.removeprefix(_READY).strip()
            found = {str(each): _measure(dashboard, url, each, seconds) for each in _VIEWERS}
        found["link"] = asyncio.run(_link_latency(port, seconds, domain))
        chassis.interrupt()
        return found | (page.measure(seconds, domain) if page.is_available() else {})


def excess(found: dict[str, dict[str, float]]) -> list[str]:
    """Return the limits that are exceeded."""
    one, many = (found[str(each)] for each in (_VIEWERS[0], _VIEWERS[-1]))
    link = found["link"]
    problems = []
    if many["cpu"] > _MAX_CPU:
        problems.append(
            f"CPU with all viewers: {many['cpu']:.1f} % of a core, limit {_MAX_CPU:g} %"
        )
    if (traffic := max(each["traffic"] for each in (one, many))) > _MAX_TRAFFIC:
        problems.append(f"traffic per viewer: {traffic:.0f} kB/s, limit {_MAX_TRAFFIC:g} kB/s")
    if many["scans"] < one["scans"] * (1.0 - _MAX_LOSS):
        problems.append(f"scans: {many['scans']:.1f} Hz with all viewers, {one['scans']:.1f} alone")
    if link["watched"] > link["alone"] * _MAX_SLOWDOWN:
        problems.append(
            f"round trip of the link: {link['watched']:.2f} ms with all viewers, "
            f"{link['alone']:.2f} ms without"
        )
    return problems + (_excess_of_page(found) if "load" in found else [])


def _excess_of_page(found: dict[str, dict[str, float]]) -> list[str]:
    problems = []
    load, frames, hour = found["load"], found["frames"], found["hour"]
    for name, limit in _MAX_LOAD.items():
        if load[name] > limit:
            problems.append(f"{name} of the first load: {load[name]:g}, limit {limit:g}")
    if frames["rate"] < _MIN_FRAMES:
        problems.append(
            f"frames in a second: {frames['rate']:.1f}, at least {_MIN_FRAMES:g}; end the other "
            "programs on this machine, and measure again"
        )
    if (growth := hour["end"] - hour["begin"]) > _MAX_GROWTH:
        problems.append(f"growth in an hour: {growth:.0f} kB, limit {_MAX_GROWTH:g} kB")
    if hour["end_nodes"] > hour["begin_nodes"]:
        problems.append(f"elements: {hour['end_nodes']:.0f} instead of {hour['begin_nodes']:.0f}")
    return problems


def table(found: dict[str, dict[str, float]]) -> str:
    """Return the figures as Markdown."""
    rows = [
        (viewers, f"{each['cpu']:.1f} %", f"{each['traffic']:.1f} kB/s", f"{each['scans']:.1f}")
        for viewers, each in found.items()
        if viewers.isdecimal()
    ]
    header = ("viewers", "CPU of a core", "traffic per viewer", "scans per second")
    text = markdown(header, rows, "rrrr") + (
        "\n\nRound trip of the link: {alone:.2f} ms without viewers (99 %: {alone_p99:.2f} ms), "
        "{watched:.2f} ms with all of them (99 %: {watched_p99:.2f} ms).".format(**found["link"])
    )
    if "load" not in found:
        return text + "\n\nThere is no Chromium, so the page in the browser was not measured."
    load, frames, hour = found["load"], found["frames"], found["hour"]
    rows = [
        ("first load", f"{load['bytes'] / 1000.0:.0f} kB"),
        ("time until the map is there", f"{load['seconds']:.2f} s"),
        ("frames in a second while driving, slowed down by 4", f"{frames['rate']:.1f}"),
        ("share of the time that the page computes meanwhile", f"{frames['busy']:.0f} %"),
        ("memory after a tenth of the messages of an hour", f"{hour['begin']:.0f} kB"),
        ("memory after all of them", f"{hour['end']:.0f} kB"),
    ]
    return f"{text}\n\n{markdown(('in the browser', ''), rows, 'lr')}"


def main(arguments: Sequence[str]) -> int:
    """Measure, and print the figures."""
    given = make_parser("dashboard", __doc__).parse_args(arguments)
    return report(given, measure(1.0 if given.smoke else page.DURATION), table, excess)
