"""A dashboard in the process of a simulated chassis, which can also change the simulated world.

The simulator belongs to a lower layer, so it imports this module on demand, by its name.
"""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.sentences import Sentence, said_by
from woosh_robot_agent.simulator.faults import FAULTS, FaultError, Injection, parse_fault
from woosh_robot_agent.simulator.server import SimulatedChassis
from woosh_robot_agent.tools.dashboard.commands import Args
from woosh_robot_agent.tools.dashboard.control import ControlConfig, Outcome
from woosh_robot_agent.tools.dashboard.server import Dashboard, DashboardConfig
from woosh_robot_agent.tools.dashboard.texts import page_text, value_data

_NO_TEXT = Sentence("a fault is a text of at most {length} characters")
_TOO_MANY = Sentence("there are {count} faults already: end some of them")
_AT_ONCE = Sentence("leave out `at`: a fault of the page begins at once")
_MAX_FAULTS = 100
"""Maximum number of faults that are active at the same time, obstacles included."""
_MAX_TEXT = 300
"""Maximum length of the text of a fault."""


@asynccontextmanager
async def dashboard_beside(
    simulator: SimulatedChassis,
    port: int,
    scan_rate: float = DashboardConfig.scan_rate,
    **timing: float,
) -> AsyncIterator[str]:
    """Serve the page for a simulated chassis on this machine, and let viewers control the chassis.

    Args:
        simulator: the chassis, already listening.
        port: port of the page; 0 takes a free port.
        scan_rate: rate of the laser scans, in Hz.
        timing: fields of `ControlConfig`.

    Yields:
        The address of the page.

    Raises:
        OSError: the port is in use.
    """
    # a wildcard address can be listened on, but not connected to
    host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(simulator.config.host, simulator.config.host)
    faults = FaultCommands(simulator)
    config = DashboardConfig(
        port=port, control=True, scan_rate=scan_rate, control_config=ControlConfig(**timing)
    )
    async with Dashboard([LinkConfig(host, simulator.port)], config, faults.commands) as dashboard:
        dashboard.robots[0].parts.add("simulator", faults.data, each_second=True)
        yield dashboard.url


class FaultCommands:
    """Commands that begin and end faults; an obstacle is a fault, too.

    Args:
        simulator: the chassis, in the same event loop.

    Attributes:
        commands: functions that execute the commands, by the command's name.
    """

    def __init__(self, simulator: SimulatedChassis) -> None:
        self._simulator = simulator
        self.commands = {"fault": self._begin, "endFault": self._end, "clearFaults": self._clear}
        self._kinds = [
            {
                "name": fault.name,
                "description": value_data(fault.description),
                "arguments": ", ".join(argument.name for argument in fault.all_arguments),
            }
            for fault in FAULTS.values()
        ]

    def data(self) -> dict[str, Any]:
        """Return all kinds of faults, and the active faults."""
        return {"known": self._kinds, "faults": [_entry(each) for each in self._simulator.faults]}

    def _clear(self, _args: Args) -> Outcome:
        self._simulator.clear_faults()
        return Outcome(True, page_text("reply.faultsEnded"))

    def _begin(self, args: Args) -> Outcome:
        text = args.get("text")
        if not isinstance(text, str) or len(text) > _MAX_TEXT:
            return _refusal(_NO_TEXT(length=_MAX_TEXT))
        if len(self._simulator.faults) >= _MAX_FAULTS:
            return _refusal(_TOO_MANY(count=_MAX_FAULTS))
        try:
            step = parse_fault(text)
            if step.at:
                return _refusal(_AT_ONCE())
            injection = self._simulator.inject(step.name, **step.arguments)
        except FaultError as error:
            return _refusal(said_by(error))
        return Outcome(True, page_text("reply.faultBegun", fault=str(injection)))

    def _end(self, args: Args) -> Outcome:
        for injection in self._simulator.faults:
            if _id(injection) == args.get("id"):
                injection.clear()
                return Outcome(True, page_text("reply.faultEnded", fault=str(injection)))
        return Outcome(False, page_text("reason.faultEnded"))


def _refusal(reason: str) -> Outcome:
    return Outcome(False, page_text("reason.said", text=reason))


def _id(injection: Injection) -> str:
    return f"{injection.name} {injection.number}"


def _entry(injection: Injection) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "id": _id(injection),
        "name": injection.name,
        "text": str(injection),
    }
    # without x and y, the obstacle was put ahead of the robot, at a place that is not known here
    if injection.name == "obstacle" and injection["x"] is not None:
        entry |= {name: injection[name] for name in ("x", "y", "radius")}
    return entry
