"""Headers of messages."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime, timezone
from typing import Any


@dataclass(frozen=True)
class Identity:
    """What identifies a vehicle.

    Attributes:
        manufacturer: manufacturer of the vehicle.
        serial_number: serial number; unique for the manufacturer.
    """

    manufacturer: str
    serial_number: str


class HeaderIds:
    """Number of the last message of each topic.

    Args:
        last: numbers from which to go on.
    """

    def __init__(self, last: Mapping[str, int] | None = None) -> None:
        self._last = Counter(last or {})

    def next(self, topic: str) -> int:
        """Return the number of the next message of a topic."""
        self._last[topic] += 1
        return self._last[topic] - 1


def timestamp(unix: float) -> str:
    """Return a Unix time in ISO 8601, in UTC, with milliseconds."""
    when = datetime.fromtimestamp(unix, timezone.utc)
    return when.isoformat(timespec="milliseconds").replace("+00:00", "Z")


def header(identity: Identity, version: str, header_id: int, unix: float) -> dict[str, Any]:
    """Return the fields with which each message begins."""
    return {
        "headerId": header_id,
        "timestamp": timestamp(unix),
        "version": version,
        "manufacturer": identity.manufacturer,
        "serialNumber": identity.serial_number,
    }
