"""Memory settings of the process: heap trimming and garbage collection."""

from __future__ import annotations

import ctypes
import gc

_LARGE_BLOCK = 1024 * 1024
"""Minimum size of a block with its own mapping, and maximum unused space of the heap, in bytes."""
_M_TRIM_THRESHOLD = -1
"""`M_TRIM_THRESHOLD` of <malloc.h>."""
_M_MMAP_THRESHOLD = -3
"""`M_MMAP_THRESHOLD` of <malloc.h>."""


def return_large_blocks() -> None:
    """Make glibc return large blocks to the system as soon as they are freed.

    By default glibc raises both thresholds to many MiB after the first large block: a frame of
    60 MiB would keep 30 MiB allocated for good. Does nothing with other C libraries.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_TRIM_THRESHOLD, _LARGE_BLOCK)
        mallopt(_M_MMAP_THRESHOLD, _LARGE_BLOCK)


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
