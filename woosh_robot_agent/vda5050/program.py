"""Command line of the connector."""

from __future__ import annotations

import argparse
import asyncio
import logging
from collections.abc import Sequence

from woosh_robot_agent.stdout_errors import exit_on_stdout_error
from woosh_robot_agent.tools.options import add_link_options, link_config
from woosh_robot_agent.tools.stop_event import stop_event
from woosh_robot_agent.vda5050.mqtt import BrokerConfig
from woosh_robot_agent.vda5050.protocol.versions import VERSIONS
from woosh_robot_agent.vda5050.vehicle import Vehicle, VehicleConfig


@exit_on_stdout_error
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the connector until SIGINT or SIGTERM.

    Args:
        arguments: Arguments of the program; by default those of the command line.

    Returns:
        The exit status, 0.
    """
    parser = argparse.ArgumentParser(
        prog="vda5050", description="Make a robot a VDA 5050 vehicle at an MQTT broker."
    )
    add_link_options(parser)
    parser.add_argument(
        "--broker", required=True, help="URL of the broker, e.g. mqtt://user:password@host:1883"
    )
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
    options = parser.parse_args(arguments)
    try:
        broker = BrokerConfig.from_url(options.broker)
    except ValueError as error:
        parser.error(str(error))
    config = VehicleConfig(
        link=link_config(parser, options),
        manufacturer=options.manufacturer,
        serial_number=options.serial_number,
        interface=options.interface,
        version=VERSIONS[options.version](),
    )
    logging.basicConfig(level=logging.INFO, format="%(levelname)s: %(message)s")
    asyncio.run(_run(Vehicle(config, broker)))
    return 0


async def _run(vehicle: Vehicle) -> None:
    stop = stop_event()
    vehicle.start()
    try:
        await stop.wait()
    finally:
        await vehicle.close()
