"""Laser scans on scan, through the agent and through the floor."""

from __future__ import annotations

import contextlib
from functools import partial
from typing import Any

from rclpy.qos import QoSProfile
from sensor_msgs.msg import LaserScan

from benchmarks.figures import MICROSECONDS, Measured, Target
from benchmarks.measurements.bare_client import BareClient
from benchmarks.options import Options
from benchmarks.processes import FLOOR, running_agent, running_chassis, running_floor
from woosh_robot_agent.testing.agents import NAMESPACE

FIGURES = {
    "scan_cpu": Target(1.5, 1.2, "agent's CPU per scan of 1080 beams at 10 Hz / bare publish"),
}
_SCANS = 300
"""Number of scans, at the default rate of 10 Hz."""
_TIMEOUT = 60.0
"""Timeout for the scans, in seconds."""


class _Counter(BareClient):
    """A subscriber that counts the scans on some topics."""

    def __init__(self, domain: int, *topics: str) -> None:
        super().__init__(domain)
        self._counts = dict.fromkeys(topics, 0)
        for topic in topics:
            self.node.create_subscription(
                LaserScan, topic, partial(self._count, topic), QoSProfile(depth=10)
            )

    def _count(self, topic: str, _scan: Any) -> None:
        self._counts[topic] += 1

    def take(self, count: int) -> dict[str, int]:
        """Wait until each topic has had a number of scans; return how many it had."""
        self._counts = dict.fromkeys(self._counts, 0)
        if not self.spin_until(lambda: min(self._counts.values()) >= count, _TIMEOUT):
            raise AssertionError(f"too few scans came: {self._counts}")
        return self._counts


def measure(domain: int, options: Options) -> Measured:
    """Measure scans of 1080 beams through agent and floor, both at the same time."""
    topics = (f"{NAMESPACE}/scan", f"{FLOOR}/scan")
    with (
        contextlib.closing(_Counter(domain, *topics)) as scans,
        running_chassis(domain) as (_, port),
        running_agent(domain, port, options) as program,
        running_floor("scan", domain, port) as floor,
    ):
        scans.take(options.samples(50))
        before = [each.cpu for each in (program, floor)]
        counts = scans.take(options.samples(_SCANS)).values()
        after = [each.cpu for each in (program, floor)]
    ours, bare = (
        (now - then) / count * MICROSECONDS
        for then, now, count in zip(before, after, counts, strict=True)
    )
    return {"scan_cpu": (ours / bare, f"{ours:.0f} / {bare:.0f} µs")}
