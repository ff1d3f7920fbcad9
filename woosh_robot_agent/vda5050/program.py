"""The program: its options, and one vehicle for each robot."""

from __future__ import annotations

import argparse
import asyncio
import contextvars
import logging
import math
from collections.abc import Mapping, Sequence
from contextlib import AsyncExitStack
from pathlib import Path

from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.link.reports import log_to_stderr
from woosh_robot_agent.link.tasks import run_main
from woosh_robot_agent.tools.dashboard.server import Dashboard, DashboardConfig
from woosh_robot_agent.tools.options import Address, add_link_options, link_config, stop_event
from woosh_robot_agent.vda5050.messages.factsheet import Limits
from woosh_robot_agent.vda5050.messages.versions import VERSIONS
from woosh_robot_agent.vda5050.mqtt import BrokerConfig, add_broker_options, broker_config
from woosh_robot_agent.vda5050.robots_file import read_robots
from woosh_robot_agent.vda5050.session import VehicleConfig
from woosh_robot_agent.vda5050.store import state_folder
from woosh_robot_agent.vda5050.vehicle import Vehicle

_LOG = logging.getLogger(__name__)
_VEHICLE_NAME = contextvars.ContextVar("vehicle_name", default="")
"""Name of the vehicle that the current code runs for; tasks and callbacks inherit it."""


class Connector:
    """Connects several robots to one broker, each as a vehicle. Use it in one asyncio event loop.

    Each vehicle has its own connections, so that a lost robot affects only its own vehicle. While
    the broker is off, each vehicle blocks a thread to connect: `run_main` has enough threads.

    Args:
        vehicles: configuration of each vehicle, by its name in the log.
    """

    def __init__(self, vehicles: Mapping[str, VehicleConfig], broker: BrokerConfig) -> None:
        self._vehicles: list[tuple[Vehicle, contextvars.Context]] = []
        """Vehicles, each with the context it runs in, which has its name for the log."""
        self._links = [config.link for config in vehicles.values()]
        for name, config in vehicles.items():
            context = contextvars.copy_context()
            context.run(_VEHICLE_NAME.set, name)
            self._vehicles.append((context.run(Vehicle, config, broker), context))

    def start(self) -> None:
        """Start connecting to the robots, and to the broker once each robot is known."""
        for vehicle, context in self._vehicles:
            context.run(vehicle.start)

    def make_dashboard(self, port: int) -> Dashboard:
        """Return a page, for browsers on this machine, with the robots, their orders and errors.

        The page has its own links to the robots, over which it only reads.

        Args:
            port: port of the page; 0 takes a free port.
        """
        dashboard = Dashboard(self._links, DashboardConfig(port=port))
        for robot, (vehicle, _) in zip(dashboard.robots, self._vehicles, strict=True):
            robot.order = vehicle.summary
        return dashboard

    async def close(self) -> None:
        """Close all vehicles at the same time. The robots continue their current tasks."""
        closing = [
            context.run(asyncio.ensure_future, vehicle.close())
            for vehicle, context in self._vehicles
        ]
        for ended in await asyncio.gather(*closing, return_exceptions=True):
            if isinstance(ended, BaseException):
                _LOG.error("a vehicle was not closed properly", exc_info=ended)


class VehicleNameFilter(logging.Filter):
    """Sets the attribute `vehicle` of log records to the name and a colon, or to an empty string.

    Add it to a handler, and use `%(vehicle)s` in its format.
    """

    def filter(self, record: logging.LogRecord) -> bool:
        name = _VEHICLE_NAME.get()
        record.vehicle = f"{name}: " if name else ""
        return True


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the connector until SIGINT, SIGTERM or SIGHUP.

    Args:
        arguments: arguments of the program; by default from the command line.

    Returns:
        The exit status: 0; 1 if the page cannot be served.
    """
    parser = _make_parser()
    options = parser.parse_args(arguments)
    if not 0.0 <= options.driving_state_interval < math.inf:
        parser.error("--driving-state-interval must be 0 or above, and finite")
    try:
        broker = broker_config(options)
        vehicles = _vehicles(parser, options)
    except ValueError as error:
        parser.error(str(error))
    log_to_stderr(logging.INFO, "%(levelname)s: %(vehicle)s%(message)s", VehicleNameFilter())
    return run_main(_run(Connector(vehicles, broker), options.dashboard))


def _make_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="vda5050", description="Connect robots to a VDA 5050 master control over MQTT."
    )
    add_link_options(parser, ip_required=False)
    parser.add_argument(
        "--robots",
        type=Path,
        metavar="FILE",
        help="parameter file of the agent that lists several robots; replaces --ip",
    )
    add_broker_options(parser)
    parser.add_argument(
        "--manufacturer",
        default=VehicleConfig.manufacturer,
        help="manufacturer in the topics (default: %(default)s)",
    )
    parser.add_argument(
        "--serial-number", default="", help="serial number in the topics (default: the robot's)"
    )
    parser.add_argument(
        "--interface",
        default=VehicleConfig.interface,
        help="first level of the topics (default: %(default)s)",
    )
    parser.add_argument(
        "--version",
        choices=VERSIONS,
        default="2.1",
        help="version of the standard (default: %(default)s)",
    )
    parser.add_argument(
        "--state-folder",
        type=Path,
        default=state_folder(),
        metavar="FOLDER",
        help="folder of the state files, which keep orders over a restart, and of the reports of "
        "the action logReport (default: %(default)s)",
    )
    parser.add_argument(
        "--driving-state-interval",
        type=float,
        default=Limits.driving_state_interval,
        metavar="SECONDS",
        help="maximum time between two states while a robot moves, in seconds, for a master "
        f"control that does not read visualization; 0 for the usual {Limits.state_interval:g} s "
        "(default: %(default)g)",
    )
    parser.add_argument(
        "--dashboard",
        type=int,
        nargs="?",
        const=DashboardConfig.port,
        metavar="PORT",
        help="also serve a page that shows the robots with their orders and errors, for browsers "
        "on this machine, on this port; 0: any free one; without a port: %(const)s",
    )
    parser.add_argument(
        "--no-maps-in-state",
        action="store_true",
        help="leave the field maps out of the state: a master control of version 2.0, such as "
        "openTCS, would refuse it",
    )
    return parser


def _vehicles(
    parser: argparse.ArgumentParser, options: argparse.Namespace
) -> dict[str, VehicleConfig]:
    """Return the configuration of each vehicle, by its name in the log.

    Raises:
        ValueError: an option is invalid, or the file of the robots cannot be used.
    """
    if (options.ip is None) == (options.robots is None):
        raise ValueError("give either --ip or --robots")
    if options.robots is None:
        return {"": _vehicle(options, link_config(parser, options), options.serial_number)}
    if options.serial_number:
        raise ValueError("--serial-number is for one robot; set serial_number in the file")
    default = link_config(parser, options, Address(LinkConfig.ip))  # replaced by those in the file
    robots = read_robots(options.robots, default)
    return {each.name: _vehicle(options, each.link, each.serial_number) for each in robots}


def _vehicle(options: argparse.Namespace, link: LinkConfig, serial_number: str) -> VehicleConfig:
    """Return the configuration of one vehicle; all vehicles share the options of the program."""
    return VehicleConfig(
        link=link,
        manufacturer=options.manufacturer,
        serial_number=serial_number,
        interface=options.interface,
        version=VERSIONS[options.version],
        state_folder=options.state_folder,
        limits=Limits(
            driving_state_interval=options.driving_state_interval,
            maps_in_state=not options.no_maps_in_state,
        ),
    )


async def _run(connector: Connector, dashboard_port: int | None) -> int:
    """Run the connector, and the page if it has a port, until a signal; return the exit status."""
    stop = stop_event()
    async with AsyncExitStack() as stack:
        connector.start()
        stack.push_async_callback(connector.close)
        if dashboard_port is not None:
            try:
                page = await stack.enter_async_context(connector.make_dashboard(dashboard_port))
            except OSError as error:
                reason = error.strerror or error
                remedy = "choose another one: --dashboard PORT"
                _LOG.error(
                    "cannot serve the page on port %d: %s; %s", dashboard_port, reason, remedy
                )
                return 1
            print(f"dashboard ready at {page.url}", flush=True)
        await stop.wait()
    return 0
