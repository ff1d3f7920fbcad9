"""Quiet exit of a program when its stdout is closed, as by `| head`."""

from __future__ import annotations

import functools
import os
import sys
from collections.abc import Callable, Sequence

EXIT_STATUS = 1
"""Exit status of a program whose output was not read to its end."""


def exit_quietly_on_broken_pipe(main: Callable[..., int]) -> Callable[..., int]:
    """Make the `main` of a program return `EXIT_STATUS`, without a message, if stdout is closed."""

    @functools.wraps(main)
    def wrapped(arguments: Sequence[str] | None = None) -> int:
        try:
            try:
                return main(arguments)
            finally:
                # Otherwise Python flushes at exit and prints the error itself.
                print(end="", flush=True)
        except BrokenPipeError:  # of stdout: the link raises LinkError for its sockets
            # The buffer is flushed once more at exit: give it somewhere to go.
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, sys.stdout.fileno())
            os.close(null)
            return EXIT_STATUS

    return wrapped
