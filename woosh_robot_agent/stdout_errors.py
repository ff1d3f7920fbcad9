"""Exit of a program that cannot write to stdout."""

from __future__ import annotations

import contextlib
import functools
import os
import sys
from collections.abc import Callable
from typing import Any, ParamSpec, TextIO

EXIT_STATUS = 1
"""Exit status of a program whose output was not written or not read to its end."""

_P = ParamSpec("_P")


def exit_on_stdout_error(main: Callable[_P, int]) -> Callable[_P, int]:
    """Make the `main` of a program return `EXIT_STATUS` if it cannot write to stdout.

    The reason is printed to stderr, unless the reader of a pipe has closed it, as `| head` does.
    """

    @functools.wraps(main)
    def wrapped(*args: _P.args, **kwargs: _P.kwargs) -> int:
        stdout = sys.stdout
        if stdout is None:  # closed by the caller: print() does nothing
            return main(*args, **kwargs)
        checked = _CheckedStdout(stdout)
        try:
            with contextlib.redirect_stdout(checked):
                try:
                    return main(*args, **kwargs)
                finally:
                    # Otherwise Python flushes at exit and prints the error itself.
                    checked.flush()
        except _StdoutError as error:
            # The buffer is flushed once more at exit: give it somewhere to go.
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, stdout.fileno())
            os.close(null)
            if not isinstance(error.reason, BrokenPipeError):
                reason = error.reason.strerror or error.reason
                print(f"error: cannot write to stdout: {reason}", file=sys.stderr)
            return EXIT_STATUS

    return wrapped


class _StdoutError(Exception):
    """Writing to stdout failed.

    It is no OSError, so that a program does not take it for an error of its files or sockets.

    Attributes:
        reason: the error of the operating system.
    """

    def __init__(self, reason: OSError) -> None:
        super().__init__(reason)
        self.reason = reason


class _CheckedStdout:
    """A text stream whose `write` and `flush` raise `_StdoutError` instead of OSError."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        try:
            return self._stream.write(text)
        except OSError as error:
            raise _StdoutError(error) from error

    def flush(self) -> None:
        try:
            self._stream.flush()
        except OSError as error:
            raise _StdoutError(error) from error

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)
