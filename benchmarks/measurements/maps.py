"""Transfers of a large map through the agent and through the floor."""

from __future__ import annotations

import contextlib
import os
from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from benchmarks.figures import Measured, Spread, Target
from benchmarks.measurements.calls import CalledProgram, Caller, RoundTrips, calling
from benchmarks.measurements.velocities import CMD_VEL, VelocityPath, publishing
from benchmarks.options import Options
from benchmarks.processes import MIB, Program, running, running_agent, running_chassis
from woosh_common_msgs.msg import FileData
from woosh_map_msgs.srv import Download, Upload
from woosh_robot_agent.testing import own_domain

FIGURES = {
    "map_download": Target(
        2.0, 1.5, "a map of 20 MiB, from the chassis to a client / bare service"
    ),
    "map_upload": Target(3.0, 2.0, "the same map, from a client to the chassis / bare service"),
}
_CALLS = 25
"""Number of transfers in each direction."""
_FIRST_TIMEOUT = 5.0
"""Time after which the first transfer is tried again, in seconds."""
_VELOCITY_RATE = 50.0
"""Rate of the velocities, in Hz."""
_VELOCITIES = 1000
"""Number of velocities, with downloads and without."""
MILLISECONDS = 1e-3
"""Milliseconds in a microsecond."""


@dataclass(frozen=True)
class Transfers:
    """Cost of all transfers of one program in one direction.

    Attributes:
        trips: round trips.
        memory: largest resident memory above that before the transfers, in sizes of the map.
    """

    trips: RoundTrips
    memory: float


class _Endpoint:
    """A program that serves map transfers.

    Args:
        program: the program.
        caller: calls its services.
        size: size of the map, in bytes.
    """

    def __init__(self, program: Program, caller: Caller, size: int) -> None:
        self.program = program
        self._caller = caller
        self._size = size
        self._rss = program.rss
        self._memory: dict[str, float] = {}
        self._called: dict[str, CalledProgram] = {}
        file = FileData(name="map.png", data=array("B", os.urandom(size)))
        upload = Upload.Request()
        upload.arg.file_datas = [file]
        self._services: dict[str, tuple[Any, Any]] = {
            "Download": (Download, None),
            "Upload": (Upload, upload),
        }

    def use(self, direction: str) -> None:
        """Select `Download` or `Upload`."""
        srv, request = self._services[direction]
        self._caller.use(srv, f"map/{direction}", request, first_timeout=_FIRST_TIMEOUT)

    def transfer(self, direction: str, count: int) -> None:
        """Make some transfers in the selected direction, and record their cost."""
        self.program.reset_peak_rss()
        self._called.setdefault(direction, CalledProgram(self.program, self._caller)).call(count)
        memory = (self.program.peak_rss - self._rss) / self._size
        self._memory[direction] = max(memory, self._memory.get(direction, 0.0))

    def transfers(self, direction: str) -> Transfers:
        """Return the cost of all transfers in one direction."""
        return Transfers(self._called[direction].round_trips, self._memory[direction])


@dataclass(frozen=True)
class MapCost:
    """Cost of maps through one kind of link, and of the floor.

    Attributes:
        agent, floor: transfers by direction, `Download` or `Upload`.
        idle_velocities: latency of velocities without transfers, from publisher to chassis.
        velocities: latency of velocities during downloads.
    """

    agent: dict[str, Transfers]
    floor: dict[str, Transfers]
    idle_velocities: Spread | None = None
    velocities: Spread | None = None

    def ratio(self, direction: str) -> float:
        """Return the median time of the agent's transfers divided by the floor's."""
        ours, floor = self.agent[direction].trips, self.floor[direction].trips
        return ours.times.median / floor.times.median


@contextlib.contextmanager
def _both(
    domain: int, options: Options, size: int
) -> Iterator[tuple[_Endpoint, _Endpoint, Caller, Program]]:
    """Run agent and floor; yield their endpoints, the agent's caller and the chassis."""
    with (
        calling(domain) as caller,
        running_chassis(domain, "--map", str(size), transport=options.transport) as (chassis, port),
        running_agent(domain, port, options, cmd_vel_rate=100.0) as program,
        own_domain() as floor_domain,
        calling(floor_domain) as floor_caller,
        running("benchmarks.floors.maps", str(size), domain=floor_domain) as floor,
    ):
        yield (
            _Endpoint(program, caller, size),
            _Endpoint(floor, floor_caller, size),
            caller,
            chassis,
        )


def measure_cost(domain: int, options: Options, *, velocities: bool = True) -> MapCost:
    """Measure transfers of agent and floor in turn, then velocities with and without downloads."""
    size = MIB if options.smoke else 20 * MIB
    idle = busy = None
    with _both(domain, options, size) as (ours, floor, caller, chassis):
        for direction in ("Upload", "Download"):
            for each in (ours, floor):
                each.use(direction)
            for _ in range(options.turns):
                for each in (ours, floor):
                    each.transfer(direction, options.samples(_CALLS // options.turns))
        if velocities:
            with publishing(domain, CMD_VEL) as publisher:
                path = VelocityPath(publisher, CMD_VEL, ours.program, chassis)
                count = options.samples(_VELOCITIES)
                path.drive(_VELOCITY_RATE, options.samples(100))
                idle = Spread.of(path.drive(_VELOCITY_RATE, count))
                busy = Spread.of(path.drive(_VELOCITY_RATE, count, lambda: caller.calls(1)))
    directions = ("Download", "Upload")
    return MapCost(
        {each: ours.transfers(each) for each in directions},
        {each: floor.transfers(each) for each in directions},
        idle,
        busy,
    )


def measure(domain: int, options: Options) -> Measured:
    """Measure transfers of agent and floor in turn."""
    cost = measure_cost(domain, options, velocities=False)
    return {
        f"map_{direction.lower()}": (
            cost.ratio(direction),
            f"{_milliseconds(cost.agent[direction])} / {_milliseconds(cost.floor[direction])} ms",
        )
        for direction in ("Download", "Upload")
    }


def _milliseconds(transfers: Transfers) -> str:
    return f"{transfers.trips.times.median * MILLISECONDS:.0f}"
