"""The configuration of the simulated chassis, and scenarios: faults that begin at given times."""

from __future__ import annotations

import ipaddress
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from woosh_robot_agent.simulator.profile import Profile
from woosh_robot_agent.simulator.status_codes import Language


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


SEEDED_START = 1735689600.0
"""Start of the simulated clock of a seeded run, as Unix time in seconds: 2025-01-01 00:00 UTC."""

MAX_CLOCK_OFFSET = 3650 * 86400.0
"""Maximum difference between the simulated clock and the real one, in seconds."""


@dataclass(frozen=True)
class SimulatorConfig:
    """Options of a simulated chassis. The command line has the most useful ones.

    Attributes:
        host: Address to listen on.
        port: WebSocket port; 0 takes a free one.
        tcp_port: Port for length-delimited protobuf over TCP; 0 takes a free one.
        speed: Simulated seconds per real second, 1 to 100.
        seed: Makes runs repeatable: laser noise, random choices of faults, and the start of the
            simulated clock. Without a seed the clock starts at the current time.
        profile: How the robot behaves: the name of a shipped profile (`tr200`, `instant`), the path
            of a file, or a loaded profile.
        scenes: Paths of further scenes, as for `scenes.files.load_scene`. The robot starts in the
            first of them, or in the first shipped scene if there is none.
        robot_id: Number of the robot.
        omnidirectional: True for a base that can move sideways, False for a differential one.
        clock_offset: Difference between the simulated clock and the real one, in seconds. The times
            of all messages have it.
        code_language: Language of the texts of status codes: `zh`, `en`, or `none` for no texts.
            Without it the profile decides.
        initialised: The robot knows its pose at the start. Otherwise a client must send InitRobot.
        charge_after: Simulated time without a command before a robot with a low battery drives to
            a charger by itself, in seconds.
        park_after: Simulated time without a command before it drives to a parking place by itself,
            in seconds.
        max_frame: Largest frame accepted from a client, in bytes.
        max_connections: Maximum number of connected clients.
        max_waiting: Maximum number of requests of one client that wait to be executed or answered.
            Further ones are refused.
        max_outbox: Maximum number of frames that wait to be sent to one client. A client that
            exceeds it is disconnected.
        scenario: Faults that begin at given times.
    """

    host: str = "127.0.0.1"
    port: int = 5480
    tcp_port: int = 5481
    speed: float = 1.0
    seed: int | None = None
    profile: str | Path | Profile = "tr200"
    scenes: tuple[Path, ...] = ()
    robot_id: int = 30001
    omnidirectional: bool = True
    clock_offset: float = 0.0
    code_language: Language | None = None
    initialised: bool = True
    charge_after: float = 600.0
    park_after: float = 1800.0
    max_frame: int = 64 * 1024 * 1024
    max_connections: int = 64
    max_waiting: int = 256
    max_outbox: int = 10_000
    scenario: Scenario | None = None

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
        if not abs(self.clock_offset) <= MAX_CLOCK_OFFSET:
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
        """Return the start of the simulated clock, as Unix time in seconds."""
        return time.time() if self.seed is None else SEEDED_START
