"""Curves of cost over size."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from benchmarks.measurements.samples import Spread
from benchmarks.options import Options


@dataclass(frozen=True)
class Point:
    """Cost at one size.

    Attributes:
        size: Number of robots, rate in Hz, or number of beams.
        cpu: CPU of the agents: percent of one core or, for scans, milliseconds per call.
        median: Median latency, in milliseconds.
        p99: 99th percentile of the latency, in milliseconds.
    """

    size: float
    cpu: float
    median: float
    p99: float

    @classmethod
    def of(cls, size: float, cpu: float, times: Spread) -> Point:
        return cls(size, cpu, times.median / 1000, times.p99 / 1000)


Curves = dict[str, list[Point]]
"""Points of each curve, by the curve's name."""


@dataclass(frozen=True)
class Sweep:
    """A size that is varied.

    Attributes:
        size: Label of the size.
        cpu: Label of the CPU figure.
        title: What stays constant.
        measure: Returns the curves.
    """

    size: str
    cpu: str
    title: str
    measure: Callable[[Options], Curves]
