"""The vehicles of one process."""

from __future__ import annotations

import asyncio
import contextvars
import logging
from collections.abc import Mapping

from woosh_robot_agent.vda5050.mqtt import BrokerConfig
from woosh_robot_agent.vda5050.vehicle import Vehicle
from woosh_robot_agent.vda5050.vehicle_config import VehicleConfig

_LOG = logging.getLogger(__name__)
_VEHICLE_NAME = contextvars.ContextVar("vehicle_name", default="")
"""Name of the vehicle that the current code runs for; tasks and callbacks inherit it."""


class Connector:
    """Several vehicles at one broker. Used in one asyncio event loop.

    Each vehicle has its own connections, so that a lost robot affects only its own vehicle.

    Args:
        vehicles: configuration of each vehicle, by its name in the log.
        broker: address of the broker.
    """

    def __init__(self, vehicles: Mapping[str, VehicleConfig], broker: BrokerConfig) -> None:
        self._vehicles: list[tuple[Vehicle, contextvars.Context]] = []
        for name, config in vehicles.items():
            context = contextvars.copy_context()
            context.run(_VEHICLE_NAME.set, name)
            self._vehicles.append((context.run(Vehicle, config, broker), context))

    def start(self) -> None:
        """Start connecting to the robots, and to the broker once each robot is known."""
        for vehicle, context in self._vehicles:
            context.run(vehicle.start)

    async def close(self) -> None:
        """Close all vehicles at the same time; see `Vehicle.close`."""
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
