"""Memory settings of the process: heap trimming and garbage collection."""

from __future__ import annotations

import ctypes
import gc
import os
import time
from pathlib import Path
from typing import Any

_MIB = 1024 * 1024
_LARGEST_BLOCK = 32 * _MIB
"""Minimum size of a block with its own mapping, in bytes; glibc allows no more."""
_MAX_UNUSED = 256 * _MIB
"""Unused space at the end of the heap from which glibc returns it at once, in bytes."""
_PERIOD = 5.0
"""Time between two looks at the memory, in seconds."""
_GROWTH = 8 * _MIB
"""Growth of the resident memory after which unused memory is returned, in bytes."""
_M_TRIM_THRESHOLD = -1
"""`M_TRIM_THRESHOLD` of <malloc.h>."""
_M_MMAP_THRESHOLD = -3
"""`M_MMAP_THRESHOLD` of <malloc.h>."""
_M_ARENA_MAX = -8
"""`M_ARENA_MAX` of <malloc.h>."""
_PAGE_SIZE = os.sysconf("SC_PAGE_SIZE")


class Heap:
    """The C heap of this process. Create it before any thread.

    A large frame is copied several times on its way. If each copy gets new memory from the system,
    that takes several times as long as the copying. Therefore the heap keeps what is freed, and
    `trim` returns it to the system shortly afterwards. All threads share one heap, because glibc
    can only trim the first one.

    Does nothing with other C libraries than glibc.
    """

    def __init__(self) -> None:
        libc = ctypes.CDLL(None)
        mallopt = getattr(libc, "mallopt", None)
        self._malloc_trim: Any = getattr(libc, "malloc_trim", None)
        if mallopt is not None:
            mallopt(_M_ARENA_MAX, 1)
            mallopt(_M_TRIM_THRESHOLD, _MAX_UNUSED)
            mallopt(_M_MMAP_THRESHOLD, _LARGEST_BLOCK)
        self._due = time.monotonic() + _PERIOD
        """Monotonic time of the next look at the memory."""
        self._usual = _resident()
        """Resident memory after unused memory was returned, in bytes."""

    def trim(self) -> None:
        """Return unused memory to the system, if the process has grown. Call it often."""
        now = time.monotonic()
        if now < self._due or self._malloc_trim is None:
            return
        self._due = now + _PERIOD
        resident = _resident()
        if resident < self._usual + _GROWTH:
            self._usual = min(self._usual, resident)
            return
        self._malloc_trim(0)
        self._usual = _resident()


def _resident() -> int:
    """Return the resident memory of this process, in bytes."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * _PAGE_SIZE


def disable_collection() -> None:
    """Disable garbage collection until `enable_collection_of_new_objects`.

    A starting program allocates mostly permanent objects. Searching them for garbage would take
    an eighth of the start-up time.
    """
    gc.disable()


def enable_collection_of_new_objects() -> None:
    """Enable garbage collection, and exempt all objects that exist now."""
    gc.freeze()
    gc.enable()
