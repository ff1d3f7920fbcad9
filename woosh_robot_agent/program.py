"""What all programs of the package share: signals, standard streams and missing libraries."""

from __future__ import annotations

import contextlib
import functools
import os
import re
import resource
import signal
import sys
from collections.abc import Callable
from typing import Any, ParamSpec, TextIO

# Import nothing slow here: programs import this module before they can handle signals.


class StopSignals:
    """Handler of SIGINT and SIGTERM that sets a flag instead of ending the program.

    Attributes:
        received: True once a signal has arrived.
        fd: File descriptor that becomes readable with each signal, also while the main thread is
            in a call that does not return to Python.
    """

    def __init__(self) -> None:
        self.received = False
        self.fd, self._write_end = os.pipe()
        os.set_blocking(self.fd, False)
        os.set_blocking(self._write_end, False)
        self._former_fd = signal.set_wakeup_fd(self._write_end, warn_on_full_buffer=False)
        self._former = {
            number: signal.signal(number, self._handle)
            for number in (signal.SIGINT, signal.SIGTERM)
        }

    def ignore(self) -> None:
        """Ignore further signals, which would change the exit status of an ending program."""
        for number in self._former:
            signal.signal(number, signal.SIG_IGN)

    def restore(self) -> None:
        """Restore the former handlers, and close `fd`."""
        for number, handler in self._former.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(self._former_fd)
        os.close(self._write_end)
        os.close(self.fd)

    def _handle(self, number: int, frame: object) -> None:
        self.received = True


# Import nothing slow here: programs import this module before they can handle signals.

_DESCRIPTORS = 64
"""File descriptors that the agent needs besides the connections of its robots.

It opens 24, and the middleware some for each other ROS program on the computer.
"""


def open_standard_streams() -> None:
    """Open /dev/null in place of closed standard streams.

    Otherwise the next file or socket gets their number, and C libraries write their logs to it: the
    logs of ROS would go to the chassis. Call it before anything else is opened.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest number that is free
            os.set_inheritable(number, True)
        if getattr(sys, name) is None:
            mode = "r" if name == "stdin" else "w"
            stream = open(number, mode, encoding="utf-8", closefd=False)  # noqa: SIM115
            setattr(sys, name, stream)


def too_few_descriptors(robots: int = 1) -> str:
    """Return that the limit of file descriptors is too low, and what to do; empty if it is not.

    Beyond the limit, libraries fail with errors that do not tell why, or silently.

    Args:
        robots: Number of robots that the agent connects to.
    """
    limit, needed = resource.getrlimit(resource.RLIMIT_NOFILE)[0], _DESCRIPTORS + robots - 1
    if limit >= needed or limit == resource.RLIM_INFINITY:
        return ""
    return (
        f"too few file descriptors: the limit is {limit}, and {needed} are needed; raise it with "
        "ulimit -n 1024, in a systemd unit with LimitNOFILE=1024"
    )


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

    It is not an OSError, because programs would handle that as an error of a file or socket.

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


_NOT_COMPILED = (
    "the protobuf modules are not compiled; run scripts/setup or python3 setup.py build_proto"
)
_OLDEST = {"websockets": "10.4", "protobuf": "3.21"}
_DISTRIBUTIONS = {"google": "protobuf", "yaml": "pyyaml", "PIL": "pillow"}
"""Names of libraries for pip, by module, where the two differ."""
_ROS = r"_?rclpy\w*|rpyutils|rosidl\w*|ament_index_python|\w+_(msgs|interfaces)"
"""Pattern of the modules that belong to ROS or to its workspace."""


def import_problem(error: ImportError) -> str:
    """Return what is missing, and what to do; empty if the error is a defect of this package."""
    reason = str(error).partition("\n")[0]
    module, _, part = (error.name or "").partition(".")
    if re.fullmatch(_ROS, module):
        return (
            f"ROS is not available ({reason}): source the setup files of ROS and of the workspace"
        )
    if module == __package__:
        return _NOT_COMPILED if re.fullmatch(r"pb(\..*)?", part) else ""
    if not isinstance(error, ModuleNotFoundError):
        return ""
    name = _DISTRIBUTIONS.get(module, module)
    needed = f"'{name}>={_OLDEST[name]}'" if name in _OLDEST else name
    return f"{name} is not installed here; run: python3 -m pip install {needed}"


def outdated_libraries() -> str:
    """Return which libraries are too old, and what to do; empty if none is.

    Raises:
        ModuleNotFoundError: a library is missing.
    """
    import google.protobuf
    from websockets.version import version as websockets_version

    # protobuf 3.21 from apt reports its version as 4.21 or 3.21
    installed = {"websockets": websockets_version, "protobuf": google.protobuf.__version__}
    old = [name for name in _OLDEST if _release(installed[name]) < _release(_OLDEST[name])]
    if not old:
        return ""
    found = " and ".join(f"{name} {installed[name]}" for name in old)
    needed = " ".join(f"'{name}>={_OLDEST[name]}'" for name in _OLDEST)
    return f"too old: {found}; run: python3 -m pip install {needed}"


def _release(version: str) -> list[int]:
    return [int(part) for part in re.findall(r"\d+", version)[:2]]
