"""Memory settings of the process: heap trimming and garbage collection."""

from __future__ import annotations

import ctypes
import gc
import time
from typing import Any

_MIB = 1024 * 1024
_LARGEST_BLOCK = 32 * _MIB
"""Minimum size of a block with its own mapping, in bytes; glibc allows no more."""
_MAX_UNUSED = 256 * _MIB
"""Unused space at the end of the heap from which glibc returns it at once, in bytes."""
_PERIOD = 5.0
"""Time between two looks at the memory, in seconds."""
_GROWTH = 8 * _MIB
"""Growth of the unused memory after which it is returned, in bytes."""
_M_TRIM_THRESHOLD = -1
"""`M_TRIM_THRESHOLD` of <malloc.h>."""
_M_MMAP_THRESHOLD = -3
"""`M_MMAP_THRESHOLD` of <malloc.h>."""
_M_ARENA_MAX = -8
"""`M_ARENA_MAX` of <malloc.h>."""


class _MallInfo(ctypes.Structure):
    """`struct mallinfo2` of <malloc.h>; `fordblks` is the unused memory in bytes."""

    _fields_ = (
        *((f"other{number}", ctypes.c_size_t) for number in range(8)),
        ("fordblks", ctypes.c_size_t),
        ("keepcost", ctypes.c_size_t),
    )


class Heap:
    """The C heap of this process. Create it before any thread.

    A large frame is copied several times on its way. If each copy gets new memory from the system,
    that takes several times as long as the copying. Therefore the heap keeps what is freed, and
    `trim` returns it to the system shortly afterwards. All threads share one heap, because glibc
    can only trim the first one.

    Does nothing with other C libraries than glibc 2.33 and later.
    """

    def __init__(self) -> None:
        libc: Any = ctypes.CDLL(None)
        self._libc = libc if hasattr(libc, "mallinfo2") else None
        if self._libc is not None:
            libc.mallopt(_M_ARENA_MAX, 1)
            libc.mallopt(_M_TRIM_THRESHOLD, _MAX_UNUSED)
            libc.mallopt(_M_MMAP_THRESHOLD, _LARGEST_BLOCK)
            libc.mallinfo2.restype = _MallInfo
        self._due = time.monotonic() + _PERIOD
        """Monotonic time of the next look at the memory."""
        self._usual = self._unused()
        """Unused memory after it was returned, in bytes; glibc goes on counting it."""

    def trim(self) -> None:
        """Return unused memory to the system, if there is more of it. Call it often."""
        now = time.monotonic()
        if now < self._due or self._libc is None:
            return
        self._due = now + _PERIOD
        unused = self._unused()
        if unused < self._usual + _GROWTH:
            self._usual = min(self._usual, unused)
            return
        self._libc.malloc_trim(0)
        self._usual = self._unused()

    def _unused(self) -> int:
        """Return the memory that was freed, in bytes."""
        return 0 if self._libc is None else int(self._libc.mallinfo2().fordblks)


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
