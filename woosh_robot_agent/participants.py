"""The place of a DDS endpoint's process, as far as its global identifier (GID) tells.

The first 8 bytes of a GID of Fast DDS, the default middleware of ROS 2, are: 2 bytes for the
vendor, 2 for the computer (from its network addresses), the lower 2 of the process id, and 2 random
ones of the process. This form is not documented, and other middleware uses another one. So a GID is
interpreted only if that of this process has this form.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from enum import Enum
from pathlib import Path

UNKNOWN_NODE = "_NODE_NAME_UNKNOWN_"
"""Name that rmw reports for the node of an endpoint before it has discovered the node."""
_FAST_DDS = b"\x01\x0f"
"""First two bytes of a GID of Fast DDS: the vendor."""
_PID_MASK = 0xFFFF
"""Mask of the bits of a process id that a GID contains."""
_PROCESSES = Path("/proc")
"""Folder that has a subfolder for each process, named by its id."""


class Place(Enum):
    """Place of a process, seen from this one."""

    THIS_PROCESS = "in this process"
    THIS_COMPUTER = "on this computer"
    ENDED = "in a process on this computer that has ended"
    OTHER_COMPUTER = "on another computer, or in a container"
    UNKNOWN = ""


def process_of(gid: Sequence[int]) -> bytes:
    """Return the part of a GID that identifies the process."""
    return bytes(gid[:8])


def is_possibly_own(gid: Sequence[int]) -> bool:
    """Return True if a GID has the form of Fast DDS, and the process id of this process."""
    data = bytes(gid)
    return data[:2] == _FAST_DDS and _pid(data) == os.getpid() & _PID_MASK


def place_of(gid: Sequence[int], own: Sequence[int]) -> tuple[Place, int]:
    """Return where a process runs, and its process id; 0 if that is not known.

    Args:
        gid: GID of an endpoint of the process.
        own: GID of an endpoint of this process.
    """
    data = bytes(gid)
    if not is_possibly_own(own) or data[:2] != _FAST_DDS:
        return Place.UNKNOWN, 0
    if process_of(gid) == process_of(own):
        return Place.THIS_PROCESS, os.getpid()
    if data[2:4] != bytes(own)[2:4]:
        return Place.OTHER_COMPUTER, 0
    running = [pid for pid in _process_ids() if pid & _PID_MASK == _pid(data)]
    if not running:
        return Place.ENDED, 0
    return Place.THIS_COMPUTER, running[0] if len(running) == 1 else 0


def _pid(gid: bytes) -> int:
    return int.from_bytes(gid[4:6], "little")


def _process_ids() -> list[int]:
    return [int(entry.name) for entry in _PROCESSES.iterdir() if entry.name.isdigit()]
