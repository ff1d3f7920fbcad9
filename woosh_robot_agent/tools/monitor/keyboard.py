"""Single key presses of a terminal, for an asyncio program."""

from __future__ import annotations

import asyncio
import os
import sys
import termios
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager

_END_OF_INPUT = "\x04"


@contextmanager
def key_presses(on_key: Callable[[str], None]) -> Iterator[bool]:
    """Call `on_key` with each key pressed; yield False if stdin is not a terminal.

    The terminal's settings are restored at the end. If the terminal goes away, that counts as the
    key Ctrl-D.
    """
    if not sys.stdin.isatty():
        yield False
        return
    loop = asyncio.get_running_loop()
    stdin = sys.stdin.fileno()
    settings = termios.tcgetattr(stdin)

    def read() -> None:
        data = os.read(stdin, 100)
        if not data:  # the terminal is gone
            loop.remove_reader(stdin)
        for key in data.decode(errors="replace") or _END_OF_INPUT:
            on_key(key)

    try:
        tty.setcbreak(stdin)
        loop.add_reader(stdin, read)
        yield True
    finally:
        loop.remove_reader(stdin)
        termios.tcsetattr(stdin, termios.TCSADRAIN, settings)
