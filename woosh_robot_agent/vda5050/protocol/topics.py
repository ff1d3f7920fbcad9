"""Topics of a vehicle."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import NamedTuple


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


class PublishOptions(NamedTuple):
    """QoS level and retain flag of a message."""

    qos: int
    retain: bool


PUBLISHED: Mapping[Topic, PublishOptions] = {
    Topic.STATE: PublishOptions(0, False),
    Topic.VISUALIZATION: PublishOptions(0, False),
    Topic.CONNECTION: PublishOptions(1, True),
    Topic.FACTSHEET: PublishOptions(0, True),
}
"""Publish options of the topics of the vehicle; they are the same in all versions."""
