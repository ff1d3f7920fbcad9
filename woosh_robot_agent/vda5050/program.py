"""Command line of the connector."""

from __future__ import annotations

import argparse
import asyncio
import logging
import math
from collections.abc import Sequence
from pathlib import Path

from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.link.log_once import log_to_stderr
from woosh_robot_agent.stdout_errors import exit_on_stdout_error
from woosh_robot_agent.tools.options import Address, add_link_options, link_config
from woosh_robot_agent.tools.stop_event import stop_event
from woosh_robot_agent.vda5050.broker_options import add_broker_options, broker_config
from woosh_robot_agent.vda5050.connector import Connector, VehicleNameFilter
from woosh_robot_agent.vda5050.protocol.versions import VERSIONS
from woosh_robot_agent.vda5050.robot.factsheet import Limits
from woosh_robot_agent.vda5050.robots_file import RobotsFileError, read_robots
from woosh_robot_agent.vda5050.store import state_folder
from woosh_robot_agent.vda5050.vehicle_config import VehicleConfig


@exit_on_stdout_error
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the connector until SIGINT or SIGTERM.

    Args:
        arguments: Arguments of the program; by default those of the command line.

    Returns:
        The exit status, 0.
    """
    parser = _make_parser()
    options = parser.parse_args(arguments)
    if not 0.0 <= options.driving_state_interval < math.inf:
        parser.error("--driving-state-interval must be 0 or above, and finite")
    try:
        broker = broker_config(options)
        vehicles = _vehicles(parser, options)
    except (RobotsFileError, ValueError) as error:
        parser.error(str(error))
    log_to_stderr(logging.INFO, "%(levelname)s: %(vehicle)s%(message)s", VehicleNameFilter())
    asyncio.run(_run(Connector(vehicles, broker)))
    return 0


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
        "control that does not read visualization; 0 publishes on events (default: %(default)g)",
    )
    parser.add_argument(
        "--no-maps-in-state",
        action="store_true",
        help="omit the field maps from the state, which a master control of version 2.0, such as "
        "openTCS, would refuse",
    )
    return parser


def _vehicles(
    parser: argparse.ArgumentParser, options: argparse.Namespace
) -> dict[str, VehicleConfig]:
    """Return the configuration of each vehicle, by its name in the log.

    Raises:
        RobotsFileError: the file of the robots cannot be used.
        ValueError: an option is invalid.
    """
    if (options.ip is None) == (options.robots is None):
        raise ValueError("give either --ip or --robots")
    if options.robots is None:
        return {"": _vehicle(options, link_config(parser, options), options.serial_number)}
    if options.serial_number:
        raise ValueError("--serial-number is for one robot; set serial_number in the file")
    default = link_config(parser, options, Address(LinkConfig.ip))  # each robot has its own
    robots = read_robots(options.robots, default)
    return {each.name: _vehicle(options, each.link, each.serial_number) for each in robots}


def _vehicle(options: argparse.Namespace, link: LinkConfig, serial_number: str) -> VehicleConfig:
    return VehicleConfig(
        link=link,
        manufacturer=options.manufacturer,
        serial_number=serial_number,
        interface=options.interface,
        version=VERSIONS[options.version](),
        state_folder=options.state_folder,
        log_folder=options.state_folder / "reports",
        limits=Limits(
            driving_state_interval=options.driving_state_interval,
            maps_in_state=not options.no_maps_in_state,
        ),
    )


async def _run(connector: Connector) -> None:
    stop = stop_event()
    connector.start()
    try:
        await stop.wait()
    finally:
        await connector.close()
