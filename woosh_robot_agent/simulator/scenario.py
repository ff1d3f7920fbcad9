"""Scenarios: faults that begin at given times."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Step:
    """One fault and the time at which it begins.

    Attributes:
        at: Simulated time since the start, in seconds.
        name: Name of the fault.
        arguments: All arguments of the fault, by name.
    """

    at: float
    name: str
    arguments: Mapping[str, Any]


@dataclass(frozen=True)
class Scenario:
    """A schedule of faults.

    Attributes:
        steps: The faults, in any order. Those with equal times begin in the order given here.
    """

    steps: tuple[Step, ...] = ()

    def __add__(self, other: Scenario) -> Scenario:
        """Return a scenario with the faults of both."""
        return Scenario(self.steps + other.steps)
