"""End of a process that serves many robots, and of a process with as many bare nodes."""

from __future__ import annotations

import time

from benchmarks.figures import Measured, Target
from benchmarks.measurements.fleet import Fleet
from benchmarks.measurements.presence import floor_command
from benchmarks.measurements.pushes import subscribing
from benchmarks.options import Options
from benchmarks.processes import Program, running

FIGURES = {"fleet_end": Target(3.0, 1.5, "seconds until a process with 20 robots has ended")}
_ROBOTS = 20
_TIMEOUT = 60.0
"""Timeout for the end of a process, in seconds."""


def measure(domain: int, options: Options) -> Measured:
    """Measure the end of the agents and that of the floor, one after the other."""
    robots = 2 if options.smoke else _ROBOTS
    with Fleet(options, per_process=robots) as fleet:
        fleet.grow(robots)
        (program,) = fleet.agents
        ours = _end(program)
    with (
        subscribing(domain, "/woosh_robot"),
        running(*floor_command(robots), domain=domain) as floor,
    ):
        floor.wait_logged("ready")
        bare = _end(floor)
    return {"fleet_end": (ours, f"{ours:.2f} s; bare nodes with the same entities {bare:.2f} s")}


def _end(program: Program) -> float:
    """End a program; return the time that this took, in seconds."""
    begun = time.monotonic()
    program.interrupt()
    program.process.wait(_TIMEOUT)
    return time.monotonic() - begun
