"""Pushes of 2 MB: for how long they hold the link thread, through which velocities pass."""

from __future__ import annotations

import re
from contextlib import closing

from diagnostic_msgs.msg import DiagnosticArray

from benchmarks.figures import Measured, Spread, Target
from benchmarks.measurements.bare_client import BareClient
from benchmarks.measurements.velocities import CMD_VEL, VelocityPath, publishing
from benchmarks.options import Options
from benchmarks.processes import running_agent, running_chassis

FIGURES = {
    "large_push": Target(
        20.0, 10.0, "ms for which the link thread is held at most, with two pushes of 2 MB a second"
    ),
}
_POSES = 60_000
"""Poses of a path; its frame has 2 MB of JSON."""
_RATE = 2.0
"""Rate of the pushes, in Hz."""
_PUSHES = 30
_VELOCITY_RATE = 50.0
"""Rate of the velocities, in Hz."""
_HELD = re.compile(r"[\d.]+ ms, ([\d.]+) ms since the start")
_TIMEOUT = 30.0
"""Maximum time until the agent reports its status, in seconds."""


def measure(domain: int, options: Options) -> Measured:
    """Measure the longest turn of the link thread, and the latency of velocities."""
    pushes = options.samples(_PUSHES)
    seconds = pushes / _RATE
    with (
        closing(_Diagnostics(domain)) as diagnostics,
        running_chassis(domain) as (chassis, port),
        running_agent(domain, port, options, cmd_vel_rate=2 * _VELOCITY_RATE) as program,
        publishing(domain, CMD_VEL) as publisher,
    ):
        path = VelocityPath(publisher, CMD_VEL, program, chassis)
        path.drive(_VELOCITY_RATE, options.samples(100))
        before = diagnostics.held()
        chassis.send("push_path", _RATE, _POSES, pushes)
        latencies = path.drive(_VELOCITY_RATE, int(seconds * _VELOCITY_RATE))
        after = diagnostics.held()
    text = f"before {before:g} ms; velocities meanwhile {Spread.of(latencies)} µs"
    return {"large_push": (after, text)}


class _Diagnostics:
    """Reads for how long the agent's link thread was held."""

    def __init__(self, domain: int) -> None:
        self._client = BareClient(domain)
        self._held: list[float] = []
        self._client.node.create_subscription(DiagnosticArray, "/diagnostics", self._read, 10)

    def held(self) -> float:
        """Wait for a report; return the longest turn of the link thread since its start, in ms."""
        self._held.clear()
        # the first report may be from before this call
        if not self._client.spin_until(lambda: len(self._held) > 1, _TIMEOUT):
            raise TimeoutError("the agent does not report for how long its thread was held")
        return self._held[-1]

    def close(self) -> None:
        self._client.close()

    def _read(self, message: DiagnosticArray) -> None:
        values = {value.key: value.value for status in message.status for value in status.values}
        if held := _HELD.fullmatch(values.get("link thread held", "")):
            self._held.append(float(held[1]))
