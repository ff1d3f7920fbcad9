"""The same calls and pushes through the agent and through rosbridge_suite.

rosbridge stands between the same ROS programs and a chassis that speaks the protocol of rosbridge.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator

from benchmarks.figures import Measured, Target
from benchmarks.measurements.calls import POSE_SPEED, CalledProgram, Caller, calling
from benchmarks.measurements.pushes import PushPath, PushRun, push_path, subscribing
from benchmarks.options import Options
from benchmarks.processes import running
from benchmarks.programs.rosbridge import server_path
from woosh_robot_agent.testing import own_domain
from woosh_robot_agent.testing.agents import NAMESPACE

FIGURES = {
    "rosbridge": Target(
        None, 1.0, "calls, and pushes at 100 Hz / the same through rosbridge, the worst ratio"
    ),
}
"""Measured only where rosbridge is installed."""
_STARTED = "started on port "
_RATE = 100.0
"""Rate of the pushes, in Hz."""


def measure(domain: int, options: Options) -> Measured:
    """Measure calls and pushes through agent and rosbridge in turn; nothing without rosbridge."""
    if server_path() is None:
        return {}
    with (
        calling(domain) as our_caller,
        push_path(domain, options) as our_path,
        own_domain() as other_domain,
        calling(other_domain) as other_caller,
        _rosbridge_path(other_domain, options) as other_path,
    ):
        both = [
            (_called_program(caller, path, options), path)
            for caller, path in ((our_caller, our_path), (other_caller, other_path))
        ]
        runs: tuple[list[PushRun], list[PushRun]] = ([], [])
        for _ in range(options.turns):
            for (called, path), pushed in zip(both, runs, strict=True):
                called.call(options.samples(1000 // options.turns))
                pushed.append(path.push(_RATE, options.samples(1000 // options.turns)))
    (ours, theirs) = (called.round_trips for called, _ in both)
    (our_pushes, their_pushes) = map(PushRun.merge, runs)
    pairs = {
        "call": (ours.times.median, theirs.times.median),
        "CPU of a call": (ours.cpu, theirs.cpu),
        "push": (our_pushes.latency.median, their_pushes.latency.median),
        "CPU of a push": (our_pushes.cpu_per_push, their_pushes.cpu_per_push),
    }
    text = ", ".join(f"{name} {mine:.0f} / {other:.0f}" for name, (mine, other) in pairs.items())
    return {"rosbridge": (max(mine / other for mine, other in pairs.values()), f"{text} µs")}


def _called_program(caller: Caller, path: PushPath, options: Options) -> CalledProgram:
    caller.use(*POSE_SPEED)
    caller.warm_up(1.0 * options.scale)
    (program,) = path.publishers
    return CalledProgram(program, caller)


@contextlib.contextmanager
def _rosbridge_path(domain: int, options: Options) -> Iterator[PushPath]:
    """Provide a warmed-up path through rosbridge, with one subscriber."""
    with (
        subscribing(domain, NAMESPACE) as subscriber,
        running("benchmarks.programs.rosbridge", "server", domain=domain) as server,
    ):
        server.wait_logged(_STARTED)
        port = re.findall(rf"{_STARTED}(\d+)", server.log)[0]
        url = f"ws://127.0.0.1:{port}"
        with running("benchmarks.programs.rosbridge", url, domain=domain) as chassis:
            path = PushPath(chassis, [server], [subscriber])
            path.warm_up(2.0 * options.scale)
            yield path
