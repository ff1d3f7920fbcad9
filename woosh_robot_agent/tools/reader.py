"""What a tool does when nobody reads its output any more, as `head` when it has its lines."""

from __future__ import annotations

import functools
import os
import sys
from collections.abc import Callable, Sequence

UNREAD = 1
"""Exit status of a tool whose output was not read to its end."""


def ends_with_its_reader(main: Callable[..., int]) -> Callable[..., int]:
    """Have the `main` of a tool end without a word, and with `UNREAD`, when stdout is closed."""

    @functools.wraps(main)
    def wrapped(arguments: Sequence[str] | None = None) -> int:
        try:
            try:
                return main(arguments)
            finally:
                print(end="", flush=True)  # else Python complains of what is in the buffer
        except BrokenPipeError:  # of stdout: those of its sockets the link makes LinkErrors
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, sys.stdout.fileno())  # for the buffer is written once more at the end
            os.close(nowhere)
            return UNREAD

    return wrapped
