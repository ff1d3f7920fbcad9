"""Parses faults of the command line and of scenarios, and begins and ends faults."""

from __future__ import annotations

import logging
import random
import shlex
from collections import Counter, deque
from collections.abc import Iterable, Mapping
from pathlib import Path

from woosh_robot_agent.data_files import DataFileError, load_yaml
from woosh_robot_agent.sentences import Sentence
from woosh_robot_agent.simulator.config import Scenario, Step
from woosh_robot_agent.simulator.faults import (
    chassis_faults,  # noqa: F401 - adds its faults
    link_faults,  # noqa: F401 - adds its faults
)
from woosh_robot_agent.simulator.faults.fault import (
    FAULTS,
    Argument,
    End,
    Fault,
    FaultError,
    Injection,
)
from woosh_robot_agent.simulator.serving.server import Server

_LOG = logging.getLogger(__name__)

# Texts with keys, which a page can show in another language.
_UNKNOWN = Sentence("unknown fault {name}: use one of {known}")
_UNREADABLE = Sentence("fault {text}: {error}")
_NO_PAIR = Sentence("{fault}: {word} is not of the form key=value")
_TWICE = Sentence("{fault}: {name} is given twice")


def find_fault(name: str) -> Fault:
    """Return the fault called `name`; raise FaultError if there is none."""
    try:
        return FAULTS[name]
    except KeyError:
        known = ", ".join(FAULTS)
        raise FaultError(_UNKNOWN(name=repr(name), known=known)) from None


def markdown() -> str:
    """Return the table of all faults in Markdown."""
    rows = [("Fault", "Effect", "Kind", "Arguments"), ("---",) * 4]
    for fault in FAULTS.values():
        arguments = "<br>".join(_describe_argument(argument) for argument in fault.own_arguments)
        kind = "lasting" if fault.lasting else "momentary"
        rows.append((f"`{fault.name}`", fault.description, kind, arguments))
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def _describe_argument(argument: Argument) -> str:
    default = argument.default
    if default is None:
        text = "none"
    elif isinstance(default, float):
        text = f"{default:g}"
    else:
        text = str(default) or "empty"
    return f"`{argument.name}` ({argument.allowed}, default {text}): {argument.description}"


_AT = Argument("at", 0.0, "time at which the fault begins", 0.0, unit="s of simulated time")
"""An additional argument of faults on the command line and in scenarios."""


def _make_step(name: str, arguments: Mapping[str, object]) -> Step:
    """Return a step of a scenario, with all defaults filled in, from arguments and `at`.

    Raises:
        FaultError: there is no such fault, or an argument is invalid.
    """
    resolved = find_fault(name).resolve(arguments, extra=(_AT,))
    return Step(resolved.pop("at"), name, resolved)


def parse_fault(text: str) -> Step:
    """Parse a fault of the command line: `NAME key=value ... at=5 for=10`.

    Values with spaces are quoted as in a shell.

    Raises:
        FaultError: there is no such fault, or an argument is invalid.
    """
    try:
        words = shlex.split(text)
    except ValueError as error:
        raise FaultError(_UNREADABLE(text=repr(text), error=str(error))) from None
    name, words = (words[0], words[1:]) if words else ("", [])
    known = {argument.name: argument for argument in (*find_fault(name).all_arguments, _AT)}
    arguments: dict[str, object] = {}
    for word in words:
        key, equals, value = word.partition("=")
        if not equals:
            raise FaultError(_NO_PAIR(fault=name, word=repr(word)))
        if key in arguments:
            raise FaultError(_TWICE(fault=name, name=key))
        # `_make_step` rejects unknown keys.
        arguments[key] = known[key].parse(value) if key in known else value
    return _make_step(name, arguments)


def load_scenario(path: str | Path) -> Scenario:
    """Read a scenario from a YAML file: a list of `{at: SECONDS, do: NAME, ...}`.

    Raises:
        OSError: the file cannot be read.
        FaultError: the file is not such a list. The text names the invalid entry and the reason.
    """
    try:
        entries = load_yaml(str(path), Path(path).read_bytes())
    except DataFileError as error:
        raise FaultError(str(error)) from None
    if not isinstance(entries, list):
        raise FaultError(f"{path}: not a list of {{at: SECONDS, do: NAME}}")
    steps = []
    for number, entry in enumerate(entries, 1):
        try:
            steps.append(_parse_entry(entry))
        except FaultError as error:
            raise FaultError(f"{path}: entry {number}: {error}") from None
    return Scenario(tuple(steps))


def _parse_entry(entry: object) -> Step:
    """Return the step that an entry of a scenario file describes."""
    if not isinstance(entry, dict) or not all(isinstance(key, str) for key in entry):
        raise FaultError(f"{entry!r} is not of the form {{at: SECONDS, do: NAME}}")
    arguments = dict(entry)
    name = arguments.pop("do", None)
    if name is False:  # YAML reads the unquoted word `off` as False
        name = "off"
    if not isinstance(name, str):
        raise FaultError("`do` must name a fault")
    if "at" not in arguments:
        raise FaultError(f"{name}: `at` is missing: give the simulated seconds since the start")
    return _make_step(name, arguments)


class Injector:
    """The faults of one simulated chassis.

    Args:
        seed: seed of the faults' random choices.
        steps: scheduled faults.

    Attributes:
        counts: number of faults that were injected since the start, by name.
    """

    def __init__(self, server: Server, seed: int, steps: Iterable[Step] = ()) -> None:
        self.counts: Counter[str] = Counter()
        self._server = server
        self._seed = seed
        self._steps = deque(sorted(steps, key=lambda step: step.at))
        self._clock = 0.0
        """Simulated time since the start, in seconds.

        Unlike the time of the chassis, it goes on during the fault `freeze`.
        """
        self._active: dict[Injection, float | None] = {}
        """Active faults, oldest first, with the times at which they expire; None for no limit."""
        self._ends: dict[object, End] = {}
        """Functions that end the active faults, by `Injection`, or by `Fault` if it is shared."""

    @property
    def active(self) -> list[Injection]:
        """Active faults, oldest first."""
        return list(self._active)

    def inject(self, name: str, **arguments: object) -> Injection:
        """Begin a fault with the given arguments.

        Raises:
            FaultError: there is no such fault, or an argument is invalid.
        """
        fault = find_fault(name)
        number = self.counts[name] + 1
        rng = random.Random(f"{self._seed}:{name}:{number}")
        injection = Injection(fault, number, fault.resolve(arguments), rng, self._clear)
        key = fault if fault.shared else injection  # a shared fault begins only once
        if key not in self._ends:
            end = fault.begin(self._server, injection)
            if end is not None:
                self._ends[key] = end
        self.counts[name] += 1
        if key in self._ends:
            _LOG.info("fault begins: %s", injection)
            seconds = injection.arguments.get("for")
            self._active[injection] = self._clock + seconds if seconds else None
        else:
            _LOG.info("fault: %s", injection)
            injection.active = False  # it is already over
        return injection

    def clear(self) -> None:
        """End all faults."""
        # Shared faults come last: when `freeze` ends, the chassis executes its queued requests,
        # which the other faults must no longer affect.
        for injection in sorted(self.active, key=lambda each: each.fault.shared):
            injection.clear()

    def advance(self, seconds: float) -> None:
        """Let `seconds` of simulated time pass: end expired faults and begin due ones."""
        self._clock = round(self._clock + seconds, 6)
        for injection, until in list(self._active.items()):
            if until is not None and until <= self._clock:
                injection.clear()
        while self._steps and self._steps[0].at <= self._clock:
            step = self._steps.popleft()
            self.inject(step.name, **step.arguments)

    def _clear(self, injection: Injection) -> None:
        """End an injection. A shared fault ends with its last injection."""
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
