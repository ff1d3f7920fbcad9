"""Gives memory back to the system once a large frame has been read."""

from __future__ import annotations

import ctypes

_LARGE = 1024 * 1024
"""Bytes from which a block is a mapping of its own, and which may stay unused at the heap's end."""
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # M_TRIM_THRESHOLD and M_MMAP_THRESHOLD of <malloc.h>


def give_back_large_blocks() -> None:
    """Have glibc return large blocks as soon as they are free, now and later.

    By default it raises both limits to many MiB after the first large block, so that a frame of 60
    MiB leaves 30 MiB behind for good. Other C libraries are left as they are.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_TRIM_THRESHOLD, _LARGE)
        mallopt(_MMAP_THRESHOLD, _LARGE)
