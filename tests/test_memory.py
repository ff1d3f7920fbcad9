"""The memory of large frames is returned to the operating system."""

from __future__ import annotations

import subprocess
import sys

PREAMBLE = """
import ctypes, os, sys, threading, time
from pathlib import Path
from woosh_robot_agent.agent import Heap

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

heap = Heap()
real = time.monotonic
"""

# prints the unused memory in MiB after 40 MiB were freed, before and after `trim`
AT_ONCE = """
def use_memory():
    for each in [block(4 * MIB) for _ in range(10)]:
        libc.free(each)

before = resident()
thread = threading.Thread(target=use_memory)
thread.start()
thread.join()
unused = (resident() - before) // MIB
time.monotonic = lambda: real() + float(sys.argv[1])
heap.trim()
print(unused, (resident() - before) // MIB)
"""

LATER = """
before = resident()
blocks = [block(4 * MIB) for _ in range(10)]
kept = block(64)
time.monotonic = lambda: real() + 60
heap.trim()
for each in blocks:
    libc.free(each)
time.monotonic = lambda: real() + 120
heap.trim()
print((resident() - before) // MIB)
"""


def run(program: str, *arguments: str) -> list[int]:
    """Run a program after the preamble; return the numbers that it prints."""
    command = [sys.executable, "-c", PREAMBLE + program, *arguments]
    output = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return [int(word) for word in output.split()]


def test_freed_blocks_are_kept_for_the_next_large_frame() -> None:
    assert min(run(AT_ONCE, "0.0")) > 30


def test_freed_blocks_are_returned_after_a_while() -> None:
    at_once, later = run(AT_ONCE, "60.0")
    assert at_once > 30
    assert later < 5


def test_blocks_that_were_in_use_at_the_last_look_are_returned_after_the_next() -> None:
    assert run(LATER)[0] < 5
