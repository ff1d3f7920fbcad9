"""Headers of messages."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime, timezone
from typing import Any

_COUNT = 2**32
"""Number of header ids; after the last one, they begin again at 0."""
_BLOCK = 1000
"""Number of header ids of a topic that are reserved at a time."""


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
    """Number of the next message of each topic.

    So that no number is used again after a restart, they are reserved in blocks: after the end of
    the program without `close`, the numbers go on behind the block.

    Args:
        first: numbers from which to go on.
        save: called with the numbers from which to go on after a restart, before any of them is
            used.
    """

    def __init__(
        self,
        first: Mapping[str, int] | None = None,
        save: Callable[[Mapping[str, int]], None] = lambda numbers: None,
    ) -> None:
        self._next = Counter(first or {})
        self._reserved = Counter(self._next)
        """The first number of each topic that is not reserved."""
        self._save = save

    def next(self, topic: str) -> int:
        """Return the number of the next message of a topic, which is taken by this."""
        number = self._next[topic]
        self._take(topic, number + 1)
        return number

    def peek(self, topic: str) -> int:
        """Return the number of the next message of a topic, which is not taken."""
        return self._next[topic]

    def close(self) -> None:
        """Save the exact numbers; take none after this."""
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
    """Return the fields with which each message begins."""
    return {
        "headerId": header_id,
        "timestamp": timestamp(unix),
        "version": version,
        "manufacturer": identity.manufacturer,
        "serialNumber": identity.serial_number,
    }
