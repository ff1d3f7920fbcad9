"""Begins and ends faults, on demand and by schedule."""

from __future__ import annotations

import logging
import random
from collections import Counter, deque
from collections.abc import Iterable

from woosh_robot_agent.simulator.config import Step
from woosh_robot_agent.simulator.faults.fault import End, Injection, Target
from woosh_robot_agent.simulator.faults.table import find

_LOG = logging.getLogger(__name__)


class Injector:
    """The faults of one simulated chassis.

    Args:
        target: The simulated chassis.
        seed: Seed of their random choices.
        steps: Scheduled faults.

    Attributes:
        counts: Number of faults since the start, by name.
    """

    def __init__(self, target: Target, seed: int, steps: Iterable[Step] = ()) -> None:
        self.counts: Counter[str] = Counter()
        self._target = target
        self._seed = seed
        self._steps = deque(sorted(steps, key=lambda step: step.at))
        self._clock = 0.0
        self._active: dict[Injection, float | None] = {}
        """Active faults, oldest first, with the simulated times at which they expire."""
        self._ends: dict[object, End] = {}
        """Functions that end the faults. A shared fault has one for all its injections."""

    @property
    def active(self) -> list[Injection]:
        """Active faults, oldest first."""
        return list(self._active)

    def inject(self, name: str, **arguments: object) -> Injection:
        """Begin a fault.

        Raises:
            FaultError: There is no such fault, or an argument is invalid.
        """
        fault = find(name)
        number = self.counts[name] + 1
        rng = random.Random(f"{self._seed}:{name}:{number}")
        injection = Injection(fault, number, fault.resolve(arguments), rng, self._clear)
        key = fault if fault.shared else injection
        if key not in self._ends:
            end = fault.begin(self._target, injection)
            if end is not None:
                self._ends[key] = end
        self.counts[name] += 1
        if key in self._ends:
            _LOG.info("fault begins: %s", injection)
            seconds = injection.arguments.get("for")
            self._active[injection] = self._clock + seconds if seconds else None
        else:
            _LOG.info("fault: %s", injection)
            injection.active = False
        return injection

    def clear(self) -> None:
        """End all faults."""
        # Shared faults last: a frozen chassis must execute its queue without the other faults.
        for injection in sorted(self.active, key=lambda each: each.fault.shared):
            injection.clear()

    def advance(self, seconds: float) -> None:
        """End expired faults and begin due ones. Time also advances while the chassis is frozen."""
        self._clock = round(self._clock + seconds, 6)
        for injection, until in list(self._active.items()):
            if until is not None and until <= self._clock:
                injection.clear()
        while self._steps and self._steps[0].at <= self._clock:
            step = self._steps.popleft()
            self.inject(step.name, **step.arguments)

    def _clear(self, injection: Injection) -> None:
        if not injection.active:
            return
        injection.active = False
        del self._active[injection]
        fault = injection.fault
        if fault.shared and any(other.fault is fault for other in self._active):
            return
        hits = f", it affected {injection.hits}" if injection.hits else ""
        _LOG.info("fault ends: %s%s", injection, hits)
        self._ends.pop(fault if fault.shared else injection)()
