"""Topics of a vehicle."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple


class Quality(NamedTuple):
    """QoS level of a message, and True if the broker keeps it for new subscribers."""

    qos: int
    retain: bool


class Topic(Enum):
    """Last level of a topic."""

    ORDER = "order"
    INSTANT_ACTIONS = "instantActions"
    STATE = "state"
    VISUALIZATION = "visualization"
    CONNECTION = "connection"
    FACTSHEET = "factsheet"
    ZONE_SET = "zoneSet"
    """From version 3.0 on."""
