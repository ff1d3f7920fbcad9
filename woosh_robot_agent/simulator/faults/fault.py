"""Kinds of faults and their arguments, how they are written as text, and faults in progress.

Functions that take the name of a fault or arguments raise `FaultError` if these are invalid.
"""

from __future__ import annotations

import logging
import math
import random
import shlex
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from woosh_robot_agent.data_files import DataFileError, load_yaml
from woosh_robot_agent.link.protos import message_types
from woosh_robot_agent.sentences import Said, Sentence, joined, said_by
from woosh_robot_agent.simulator.config import Scenario, Step
from woosh_robot_agent.simulator.serving.server import Server

_LOG = logging.getLogger(__name__)

Value = int | float | str
"""Value of an argument. An optional number that is not given is None instead."""

# Texts with keys, which a page can show in another language.
_OR = Sentence("{one} or {other}")
_NO_MESSAGE = Sentence("{name}: no message has the type {value}")
_MESSAGE = Sentence("message type")
_KINDS: dict[type, Said] = {
    int: Sentence("integer")(),
    float: Sentence("number")(),
    str: Sentence("text")(),
}
"""Names of the types of values."""
_WITHIN = Sentence("{kind} from {low} to {high}")
_AT_LEAST = Sentence("{kind} of at least {low}")
_IN_UNIT = Sentence("{kind}, in {unit}")
_UNITS = {
    unit: Sentence(unit)()
    for unit in ("s of simulated time", "s of real time", "1/s of real time", "bytes")
}
_WRONG = Sentence("{name}: {value} is not {allowed}")
_MOMENTARY = Sentence("{fault} is momentary: leave out `for`")
_NO_ARGUMENT = Sentence("{fault} has no argument {name}; its arguments are: {names}")
_IN_FAULT = Sentence("{fault}: {error}")
_UNKNOWN = Sentence("unknown fault {name}: use one of {known}")
_UNREADABLE = Sentence("fault {text}: {error}")
_NO_PAIR = Sentence("{fault}: {word} is not of the form key=value")
_TWICE = Sentence("{fault}: {name} is given twice")

_MAX_NUMBER = 1e300
"""Maximum absolute value of a number, which excludes infinity."""


class FaultError(ValueError):
    """A fault does not exist, or an argument is invalid. The text says what is valid."""


@dataclass(frozen=True)
class Argument:
    """An argument that a fault takes.

    Attributes:
        default: default value, which also gives the type; None for an optional number.
        description: meaning of the argument, for the documentation.
        low: minimum of a number.
        high: maximum of a number; finite only with a finite `low`.
        unit: unit of a number; empty if it has none.
        choices: valid texts; empty if other texts are valid too.
        is_message: True if the text must be empty or the full name of a protobuf message.
    """

    name: str
    default: Value | None
    description: str
    low: float = -math.inf
    high: float = math.inf
    unit: str = ""
    choices: tuple[str, ...] = ()
    is_message: bool = False

    @property
    def kind(self) -> type[int] | type[float] | type[str]:
        """Type of the value."""
        return float if self.default is None else type(self.default)

    def parse(self, text: str) -> Value:
        """Convert a text of the command line to the type of the value, if that is possible.

        Otherwise return the text unchanged, which `check` rejects.
        """
        try:
            return self.kind(text)
        except ValueError:
            return text

    def check(self, value: object) -> Value:
        """Return a valid value in the type of the argument, e.g. 1 as 1.0."""
        if self.kind is str:
            if not isinstance(value, str) or (self.choices and value not in self.choices):
                raise self._wrong(value)
            if self.is_message and value and value not in message_types():
                raise FaultError(_NO_MESSAGE(name=self.name, value=repr(value)))
            return value
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self._wrong(value)
        if self.kind is int and not isinstance(value, int):
            raise self._wrong(value)
        if not (self.low <= value <= self.high and abs(value) <= _MAX_NUMBER):  # true for NaN too
            raise self._wrong(value)
        return self.kind(value)

    @property
    def allowed(self) -> str:
        """Description of the valid values, without an article."""
        if self.choices:
            return joined(_OR, self.choices)
        if self.is_message:
            return _MESSAGE()
        text = _KINDS[self.kind]
        if math.isfinite(self.high):
            text = _WITHIN(kind=text, low=_number(self.low), high=_number(self.high))
        elif math.isfinite(self.low):
            text = _AT_LEAST(kind=text, low=_number(self.low))
        if not self.unit:
            return text
        return _IN_UNIT(kind=text, unit=_UNITS.get(self.unit, self.unit))

    def _wrong(self, value: object) -> FaultError:
        allowed = self.allowed
        if isinstance(allowed, Said) and not self.choices:
            # Only the English text has an article: the key, which finds translations, has none.
            article = "an" if allowed[0] in "aeiou" else "a"
            allowed = Said(f"{article} {allowed}", allowed.key, allowed.values)
        return FaultError(_WRONG(name=self.name, value=repr(value), allowed=allowed))


def _number(value: float) -> str:
    return f"{int(value)}" if value == int(value) else f"{value:g}"


End = Callable[[], object]
"""Ends a fault."""

Begin = Callable[[Server, "Injection"], "End | None"]
"""Begins a fault. Returns the function that ends it, or None if the fault is already over."""

_FOR = Argument(
    "for", 0.0, "time after which the fault ends; 0: no limit", 0, unit="s of simulated time"
)
"""An argument of all lasting faults."""


@dataclass(frozen=True)
class Fault:
    """A kind of fault.

    Attributes:
        description: effect of the fault, for the documentation.
        begin: function that begins the fault.
        own_arguments: arguments, without `for`, which all lasting faults have.
        lasting: True if the fault lasts until it is cleared or expires; False for a momentary
            fault, which is over at once or after a number of pushes.
        shared: True if simultaneous injections act as one fault, which ends with the last of them.
        check: raises FaultError for an invalid combination of arguments; None if all are valid.
    """

    name: str
    description: str
    begin: Begin
    own_arguments: tuple[Argument, ...] = ()
    lasting: bool = True
    shared: bool = False
    check: Callable[[Mapping[str, Any]], None] | None = None

    @property
    def all_arguments(self) -> tuple[Argument, ...]:
        """Arguments of the fault, and `for` if it lasts."""
        return (*self.own_arguments, _FOR) if self.lasting else self.own_arguments

    def resolve(
        self, arguments: Mapping[str, object], extra: tuple[Argument, ...] = ()
    ) -> dict[str, Any]:
        """Return the checked arguments, with all defaults filled in.

        Args:
            arguments: the given arguments. A trailing underscore, as in `for_`, is ignored.
            extra: additional arguments that are allowed here, such as `at`.
        """
        if not self.lasting and not {"for", "for_"}.isdisjoint(arguments):
            raise FaultError(_MOMENTARY(fault=self.name))
        known = {each.name: each for each in (*self.all_arguments, *extra)}
        resolved: dict[str, Any] = {name: each.default for name, each in known.items()}
        for key, value in arguments.items():
            name = key.removesuffix("_")
            if name not in known:
                names = ", ".join(known) or "none"
                raise FaultError(_NO_ARGUMENT(fault=self.name, name=repr(name), names=names))
            if value is None and known[name].default is None:
                continue  # the argument is optional
            try:
                resolved[name] = known[name].check(value)
            except FaultError as error:
                raise FaultError(_IN_FAULT(fault=self.name, error=said_by(error))) from None
        if self.check:
            self.check(resolved)
        return resolved


FAULTS: dict[str, Fault] = {}
"""All faults, by name, once the package `faults` is imported."""


def fault(
    description: str,
    *own_arguments: Argument,
    lasting: bool = True,
    shared: bool = False,
    check: Callable[[Mapping[str, Any]], None] | None = None,
) -> Callable[[Begin], Begin]:
    """Return a decorator that adds a fault to `FAULTS`; the decorated function begins the fault.

    The fault has the name of the function without the underscore at its start, and the given
    attributes of `Fault`.
    """

    def add(begin: Begin) -> Begin:
        name = begin.__name__.removeprefix("_")
        # a text with a key, which a page can show in another language
        said = Sentence(description)()
        FAULTS[name] = Fault(name, said, begin, own_arguments, lasting, shared, check)
        return begin

    return add


@dataclass(eq=False)
class Injection:
    """An injected fault.

    Attributes:
        number: number among the injections of this fault, from 1.
        arguments: all arguments, defaults included, by name.
        rng: random number generator, derived from the seed of the simulator.
        hits: number of answers, pushes, requests or connections that the fault has affected.
        active: True until this injection ends.
    """

    fault: Fault
    number: int
    arguments: dict[str, Any]
    rng: random.Random
    _clear: Callable[[Injection], None]
    """Ends the given injection; set by the `Injector`."""
    hits: int = 0
    active: bool = True

    def __getitem__(self, name: str) -> Any:
        """Return the value of an argument."""
        return self.arguments[name]

    def __str__(self) -> str:
        """Return the fault as on the command line, without arguments at their defaults."""
        parts = [
            f"{argument.name}={shlex.quote(str(self.arguments[argument.name]))}"
            for argument in self.fault.all_arguments
            if self.arguments[argument.name] != argument.default
        ]
        return " ".join([self.fault.name, *parts])

    @property
    def name(self) -> str:
        """Name of the fault."""
        return self.fault.name

    def clear(self) -> None:
        """End the injection, if it has not ended."""
        self._clear(self)

    def hit(self) -> None:
        """Count an effect of the fault, and end the injection if its `count` is reached."""
        self.hits += 1
        if self.hits == self.arguments.get("count"):
            self.clear()


def _find_fault(name: str) -> Fault:
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
    """Return a step of a scenario, with all defaults filled in, from arguments and `at`."""
    resolved = _find_fault(name).resolve(arguments, extra=(_AT,))
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
    known = {argument.name: argument for argument in (*_find_fault(name).all_arguments, _AT)}
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
        """Begin a fault with the given arguments."""
        fault = _find_fault(name)
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
            injection.active = False
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
