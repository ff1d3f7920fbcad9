"""The devices of the robot that a job can own."""

from __future__ import annotations

from enum import Enum, auto


class Device(Enum):
    """A device that at most one running job owns; NONE for jobs that need no device."""

    WHEELS = auto()
    JACK = auto()
    COLUMN = auto()
    CHARGER = auto()
    NONE = auto()
