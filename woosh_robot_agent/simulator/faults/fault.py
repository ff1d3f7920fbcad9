"""What a fault is, and what one that was put in can be asked."""

from __future__ import annotations

import random
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from google.protobuf.message import Message

from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.faults.parameters import FaultError, Parameter, resolve
from woosh_robot_agent.simulator.serving.hooks import Hooks


class Target(Protocol):
    """What faults are put into: a simulated chassis with its connections."""

    @property
    def chassis(self) -> Chassis:
        """The model."""

    @property
    def hooks(self) -> Hooks:
        """Where requests, frames and new connections can be caught."""

    def drop(self) -> None:
        """End every connection at once, as a broken cable would."""

    def hold_link(self, held: bool) -> None:
        """Neither read nor write, but keep the connections; or go on."""

    def hang(self, hung: bool) -> None:
        """Let model time stand still and queue what is read; or go on."""

    def switch(self, on: bool) -> None:
        """Drop every client and refuse new connections; or listen again at the same ports."""

    def set_emergency_stop(self, pressed: bool) -> None:
        """Press or release the emergency stop button."""

    def lose_localisation(self) -> None:
        """Make the chassis forget where it is."""

    def push(self, message: Message) -> None:
        """Push a message to everybody who subscribed to its type."""

    def backlog(self) -> int:
        """The most frames that wait for one client."""

    def room(self) -> int:
        """How many frames may wait for one client."""

    def report(self) -> None:
        """Push what changed."""


#: Undoes what a fault did.
End = Callable[[], None]
Begin = Callable[[Target, "Injection"], "End | None"]

FOR = Parameter(
    "for", float, 0.0, "ends by itself after this time; 0: never", unit="simulated s", low=0.0
)


@dataclass(frozen=True)
class Fault:
    """A kind of fault.

    Attributes:
        name: As people write it.
        description: What it does.
        begin: Does it, and gives what undoes it.
        own: Its parameters, without those that every lasting one has.
        lasting: It goes on until it is cleared or runs out; else it is over at once.
        shared: Several at a time are as one, which ends with the last of them.
        check: Raises FaultError where arguments do not go together.
    """

    name: str
    description: str
    begin: Begin
    own: tuple[Parameter, ...] = ()
    lasting: bool = True
    shared: bool = False
    check: Callable[[Mapping[str, Any]], None] | None = None

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """All its parameters."""
        return (*self.own, FOR) if self.lasting else self.own

    def resolve(
        self, arguments: Mapping[str, object], also: tuple[Parameter, ...] = ()
    ) -> dict[str, Any]:
        """The arguments with all defaults put in.

        Args:
            arguments: What was said.
            also: Further parameters, which are not the fault's own.

        Raises:
            FaultError: One is unknown or does not fit.
        """
        if not self.lasting and not {"for", "for_"}.isdisjoint(arguments):
            raise FaultError(f"{self.name} is momentary: it takes no `for`")
        resolved = resolve(self.name, (*self.parameters, *also), arguments)
        if self.check:
            self.check(resolved)
        return resolved


class Injection:
    """A fault that was put in.

    Attributes:
        fault: Its kind.
        number: Which of its kind it is, from 1.
        arguments: All of them, defaults included, by name.
        rng: Its random choices, which the simulator's seed decides.
        hits: How many answers, frames or connections it has met.
        active: Whether it still lasts.
    """

    def __init__(
        self,
        fault: Fault,
        number: int,
        arguments: dict[str, Any],
        rng: random.Random,
        clear: Callable[[Injection], None],
    ) -> None:
        self.fault = fault
        self.number = number
        self.arguments = arguments
        self.rng = rng
        self.hits = 0
        self.active = True
        self._clear = clear

    def __getitem__(self, name: str) -> Any:
        """The value of an argument."""
        return self.arguments[name]

    def __str__(self) -> str:
        """As on the command line, without what is at its default."""
        said = [
            f"{parameter.name}={shlex.quote(str(self.arguments[parameter.name]))}"
            for parameter in self.fault.parameters
            if self.arguments[parameter.name] != parameter.default
        ]
        return " ".join([self.fault.name, *said])

    @property
    def name(self) -> str:
        """The name of its kind."""
        return self.fault.name

    def clear(self) -> None:
        """End it; nothing happens if it is over."""
        self._clear(self)

    def hit(self) -> None:
        """Count that it met something, and end it if that was the last time."""
        self.hits += 1
        if self.hits == self.arguments.get("count"):
            self.clear()
