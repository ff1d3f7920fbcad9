"""The memory of large frames is returned to the operating system."""

from __future__ import annotations

import subprocess
import sys

PROGRAM = """
import ctypes, os, sys
from pathlib import Path
from woosh_robot_agent.memory import return_large_blocks

libc = ctypes.CDLL(None)
libc.malloc.restype = ctypes.c_void_p
libc.free.argtypes = [ctypes.c_void_p]
libc.memset.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.c_size_t]
MIB = 1024 * 1024

def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")

def block(size):
    address = libc.malloc(size)
    libc.memset(address, 1, size)
    return address

if sys.argv[1] == "on":
    return_large_blocks()
libc.free(block(30 * MIB))  # from now on glibc by default keeps smaller blocks
before = resident()
for large in [block(4 * MIB) for _ in range(10)]:
    libc.free(large)
print((resident() - before) // MIB)
"""


def left_behind(mode: str) -> int:
    """Return the memory that a program still occupies after it freed 40 MiB, in MiB."""
    run = [sys.executable, "-c", PROGRAM, mode]
    return int(subprocess.run(run, check=True, capture_output=True, text=True).stdout)


def test_freed_large_blocks_are_returned_at_once() -> None:
    assert left_behind("off") > 30, "glibc returns them by default"
    assert left_behind("on") < 5
