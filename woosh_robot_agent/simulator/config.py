"""What a simulated chassis can be told at its start."""

from __future__ import annotations

import ipaddress
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # faults know the chassis, which knows its configuration
    from woosh_robot_agent.simulator.faults.scenario import Scenario

#: Where a seeded simulation's clock starts, Unix time in s: 2025-01-01 00:00 UTC.
SEEDED_START = 1735689600.0


@dataclass(frozen=True)
class SimulatorConfig:
    """Options of a simulated chassis; the command line has those that people need.

    Attributes:
        host: The address to listen at.
        port: The WebSocket port; 0 takes a free one.
        tcp_port: The port for delimited protobuf; 0 takes a free one.
        speed: How much faster than real time simulated time runs, 1 to 100.
        seed: Makes runs repeatable: the laser's noise, and the simulated clock's start, which is
            otherwise that of the machine's clock.
        scenes: Folders or files of scenes besides the shipped ones, as for
            `scene_files.load_scene`; the robot starts in the first.
        robot_id: The robot's number.
        omnidirectional: The base can move sideways too; else it is a differential one.
        initialised: It knows where it is when it starts; else a client has to tell it (InitRobot).
        charge_after: Simulated s without any command after which it drives to a charger, if its
            battery is low and its settings allow that.
        park_after: The same for a parking place, whatever the battery.
        max_frame: Bytes of the largest frame that it takes from a client.
        max_connections: How many clients it serves at a time.
        max_waiting: How many requests of one client may wait, to be done or for their answers to
            be let go; further ones are refused.
        max_outbox: How many frames may wait for one client before it is dropped as too slow.
        scenario: Faults, and when they happen.
    """

    host: str = "127.0.0.1"
    port: int = 5480
    tcp_port: int = 5481
    speed: float = 1.0
    seed: int | None = None
    scenes: tuple[Path, ...] = ()
    robot_id: int = 30001
    omnidirectional: bool = True
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
        for port in (self.port, self.tcp_port):
            if not 0 <= port <= 65535:
                raise ValueError(f"port {port} is not within 0 to 65535")

    @property
    def local(self) -> bool:
        """Whether only programs of this machine reach it."""
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return self.host == "localhost"

    def start_time(self) -> float:
        """Where the simulated clock starts, Unix time in s."""
        return time.time() if self.seed is None else SEEDED_START
