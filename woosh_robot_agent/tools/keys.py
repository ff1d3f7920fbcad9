"""Single keys of a terminal, for an asyncio program."""

from __future__ import annotations

import asyncio
import os
import sys
import termios
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager

_END = "\x04"


@contextmanager
def keys(pressed: Callable[[str], None]) -> Iterator[bool]:
    """Have `pressed` called with each key; gives whether there is a keyboard.

    The terminal is as it was afterwards, whatever happens.
    """
    if not sys.stdin.isatty():
        yield False
        return
    loop = asyncio.get_running_loop()
    number = sys.stdin.fileno()
    before = termios.tcgetattr(number)

    def read() -> None:
        data = os.read(number, 100)
        if not data:  # the terminal has gone
            loop.remove_reader(number)
        for key in data.decode(errors="replace") or _END:
            pressed(key)

    try:
        tty.setcbreak(number)
        loop.add_reader(number, read)
        yield True
    finally:
        loop.remove_reader(number)
        termios.tcsetattr(number, termios.TCSADRAIN, before)
