"""Headers of messages."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime, timezone
from typing import Any

_COUNT = 2**32
"""Number of header ids; after the last one, they start again at 0."""
_BLOCK = 1000
"""Number of header ids of a topic that are reserved at once."""


@dataclass(frozen=True)
class Identity:
    """Identity of a vehicle, in topics and headers.

    Attributes:
        manufacturer: manufacturer of the vehicle.
        serial_number: serial number; unique for the manufacturer.
    """

    manufacturer: str
    serial_number: str


class HeaderIds:
    """Header ids of a vehicle, counted for each topic.

    Ids are reserved in blocks, so that none is used again after a restart. If the program ends
    without `close`, the ids continue after the reserved block.

    Args:
        first: next id of each topic.
        save: saves the next id of each topic after a restart; called before the reserved ids are
            used.
    """

    def __init__(
        self,
        first: Mapping[str, int] | None = None,
        save: Callable[[Mapping[str, int]], None] = lambda numbers: None,
    ) -> None:
        self._next = Counter(first or {})
        self._reserved = Counter(self._next)
        """The first id of each topic that is not reserved."""
        self._save = save

    def next(self, topic: str) -> int:
        """Take the next id of a topic, and return it."""
        number = self._next[topic]
        self._take(topic, number + 1)
        return number

    def peek(self, topic: str) -> int:
        """Return the next id of a topic without taking it."""
        return self._next[topic]

    def close(self) -> None:
        """Save the exact ids; take none afterwards."""
        self._save(dict(self._next))

    def _take(self, topic: str, following: int) -> None:
        self._next[topic] = following % _COUNT
        if not 0 < self._reserved[topic] - self._next[topic] <= _BLOCK:
            self._reserved[topic] = self._next[topic] + _BLOCK
            self._save({name: number % _COUNT for name, number in self._reserved.items()})


def timestamp(unix: float) -> str:
    """Return a Unix time in ISO 8601, in UTC, with milliseconds."""
    when = datetime.fromtimestamp(unix, timezone.utc)
    return when.isoformat(timespec="milliseconds").replace("+00:00", "Z")


def header(identity: Identity, version: str, header_id: int, unix: float) -> dict[str, Any]:
    """Return the header fields of a message."""
    return {
        "headerId": header_id,
        "timestamp": timestamp(unix),
        "version": version,
        "manufacturer": identity.manufacturer,
        "serialNumber": identity.serial_number,
    }
