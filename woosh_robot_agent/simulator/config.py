"""The configuration of the simulated chassis, and scenarios: faults that begin at given times."""

from __future__ import annotations

import ipaddress
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_args

from woosh_robot_agent.simulator.profile import SHIPPED, Profile
from woosh_robot_agent.simulator.status_codes import Language


@dataclass(frozen=True)
class Step:
    """One fault and the time at which it begins.

    Attributes:
        at: simulated time since the start, in seconds.
        arguments: all arguments of the fault, by name.
    """

    at: float
    name: str
    arguments: Mapping[str, Any]


@dataclass(frozen=True)
class Scenario:
    """A schedule of faults.

    Attributes:
        steps: the faults, in any order. Faults with equal times begin in the order given here.
    """

    steps: tuple[Step, ...] = ()

    def __add__(self, other: Scenario) -> Scenario:
        """Return a scenario with the faults of both."""
        return Scenario(self.steps + other.steps)


SEEDED_START = 1735689600.0
"""Start of the simulated clock of a seeded run, as Unix time in seconds: 2025-01-01 00:00 UTC."""

MAX_CLOCK_OFFSET = 3650 * 86400.0
"""Maximum difference between the simulated clock and the real one, in seconds."""


def _option(default: Any, help_: str, **arguments: Any) -> Any:
    """Return a field that is also a command-line option.

    Args:
        arguments: further arguments of `ArgumentParser.add_argument`.
    """
    return field(default=default, metadata={"help": help_, **arguments})


@dataclass(frozen=True)
class SimulatorConfig:
    """Options of a simulated chassis. Most of them are options of the command line, too.

    Raises:
        ValueError: a value is outside of its range.
    """

    host: str = _option("127.0.0.1", "address to listen on")
    port: int = _option(5480, "WebSocket port; 0: any free port")
    tcp_port: int = _option(5481, "port for delimited protobuf over TCP; 0: any free port")
    speed: float = _option(1.0, "simulated seconds per real second, 1 to 100")
    seed: int | None = _option(
        None,
        "seed of laser noise, simulated clock and random faults, for repeatable runs",
        type=int,
    )
    profile: str | Path | Profile = _option(  # noqa: RUF009 - returns a field
        "tr200",
        f"how the robot behaves: {' or '.join(reversed(SHIPPED))}, or a YAML file",
        metavar="NAME_OR_FILE",
    )
    clock_offset: float = _option(
        0.0,
        "how far the clock of the robot is ahead of the real one, in s; negative: behind",
        metavar="SECONDS",
    )
    code_language: Language | None = _option(  # noqa: RUF009 - returns a field
        None,
        "language of the texts of status codes; none: no texts; default: as in the profile",
        choices=get_args(Language),
    )
    robot_id: int = _option(30001, "number of the robot")
    max_frame: int = _option(
        64 * 1024 * 1024, "maximum size of a frame from a client, in bytes", metavar="N"
    )
    max_connections: int = _option(64, "maximum number of clients", metavar="N")
    max_waiting: int = _option(
        256, "maximum number of waiting requests per client; others are refused", metavar="N"
    )
    max_outbox: int = _option(
        10_000,
        "maximum number of frames waiting for a client; a client that exceeds it is dropped",
        metavar="N",
    )
    scenes: tuple[Path, ...] = ()
    """Folders or YAML files of scenes besides the shipped ones. The robot starts in the first of
    them; if there are none, in the first shipped scene."""
    omnidirectional: bool = True
    """True for a base that can move sideways, False for a differential base."""
    initialised: bool = True
    """True if the robot knows its pose at the start. Otherwise a client must send InitRobot."""
    charge_after: float = 600.0
    """Simulated time without a command before a robot with a low battery charges, in seconds."""
    park_after: float = 1800.0
    """Simulated time without a command before the robot parks by itself, in seconds."""
    scenario: Scenario = Scenario()
    """Faults that begin at given times."""

    def __post_init__(self) -> None:
        if not 1.0 <= self.speed <= 100.0:
            raise ValueError(f"speed {self.speed:g} is not within 1 to 100")
        if not 0 < self.robot_id < 2**32:
            raise ValueError(f"robot id {self.robot_id} is not within 1 to {2**32 - 1}")
        for name in ("max_frame", "max_connections", "max_waiting", "max_outbox"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} {getattr(self, name)} is not at least 1")
        if self.charge_after <= 0.0 or self.park_after <= 0.0:
            raise ValueError("charge_after and park_after must be more than 0 s")
        if not abs(self.clock_offset) <= MAX_CLOCK_OFFSET:  # true for NaN too
            raise ValueError(f"clock offset {self.clock_offset:g} s is more than 10 years")
        for port in (self.port, self.tcp_port):
            if not 0 <= port <= 65535:
                raise ValueError(f"port {port} is not within 0 to 65535")

    @property
    def local(self) -> bool:
        """True if only programs on this machine can connect."""
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return self.host == "localhost"

    def start_time(self) -> float:
        """Return the Unix time at which the simulated clock starts, without `clock_offset`."""
        return time.time() if self.seed is None else SEEDED_START
