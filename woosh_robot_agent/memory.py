"""How the program's memory is looked after: large blocks go back, and what stays is left alone."""

from __future__ import annotations

import ctypes
import gc

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


def collect_nothing() -> None:
    """Look for no garbage until `collect_only_what_comes`.

    While a program starts it makes what it will always need. Python would look through all of that
    again and again, which takes an eighth of the start.
    """
    gc.disable()


def collect_only_what_comes() -> None:
    """Look for garbage again, but never among what is there by now."""
    gc.freeze()
    gc.enable()
