"""State of a program's link to the robot, in words."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass

from woosh_robot_agent.link import ChassisClient, LinkState
from woosh_robot_agent.tools.options import link_arguments


@dataclass(frozen=True)
class LinkReport:
    """State of the connection from the robot to a program that shows it.

    Attributes:
        good: True if what the program shows is up to date.
        text: State of the link in words.
        detail: Counters, times or advice; may be empty.
    """

    good: bool
    text: str
    detail: str = ""


def link_report(chassis: ChassisClient) -> LinkReport:
    """Return the state of a link."""
    stats = chassis.stats
    since = time.strftime("%H:%M:%S", time.localtime(chassis.since))
    if chassis.state is LinkState.READY:
        bad, dropped = stats.bad_frames.total(), stats.dropped_pushes.total()
        counts = (
            f"frames: {stats.rx} received, {stats.tx} sent, {bad} invalid; {dropped} pushes dropped"
        )
        ping = "" if stats.round_trip is None else f"round trip {stats.round_trip * 1000:.0f} ms; "
        return LinkReport(True, f"connected since {since}", ping + counts)
    state = "connection lost" if stats.connects else "not connected"
    reason = f": {chassis.last_error}" if chassis.last_error else ""
    remedy = f"run `doctor {link_arguments(chassis.config)}` to find the cause"
    return LinkReport(False, f"{state} since {since}, retrying{reason}", remedy)


def system_text(error: OSError) -> str:
    """Return the operating system's text for an error, without what asyncio adds."""
    if error.errno and error.errno > 0:  # negative: a host name that cannot be resolved
        return os.strerror(error.errno)
    return error.strerror or str(error) or type(error).__name__
