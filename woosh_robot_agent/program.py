"""Helpers for all programs of the package: signals, standard streams, exit, missing libraries."""

from __future__ import annotations

import errno
import io
import os
import re
import resource
import signal
import sys
from collections.abc import Callable

# Import nothing slow here: programs import this module before they can handle signals.


def end_signals() -> tuple[signal.Signals, ...]:
    """Return the signals that end a program: SIGINT, SIGTERM and SIGHUP.

    SIGHUP, which a closed terminal sends, is left out where `nohup` has made the program ignore it.
    """
    is_default = signal.getsignal(signal.SIGHUP) is signal.SIG_DFL
    return signal.SIGINT, signal.SIGTERM, *((signal.SIGHUP,) if is_default else ())


class StopSignals:
    """Handler of `end_signals` that sets a flag instead of ending the program.

    Attributes:
        received: True once a signal has arrived.
        fd: file descriptor that becomes readable with each signal, also while the main thread is
            in a call that does not return to Python.
    """

    def __init__(self) -> None:
        self.received = False
        self.fd, self._write_end = os.pipe()
        os.set_blocking(self.fd, False)
        os.set_blocking(self._write_end, False)
        self._former_fd = signal.set_wakeup_fd(self._write_end, warn_on_full_buffer=False)
        self._former = {number: signal.signal(number, self._handle) for number in end_signals()}

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


_DESCRIPTORS = 64
"""Number of file descriptors that the agent needs for one robot; each further robot needs one more.

It opens 24, and the middleware some for each other ROS program on the computer.
"""


def open_standard_streams() -> None:
    """Open /dev/null in place of closed standard streams.

    Otherwise the next file or socket gets the number of a closed stream, and C libraries write
    their logs to it: ROS would log to the chassis. Call this before anything else is opened.
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


def descriptor_problem(robots: int = 1) -> str:
    """Return a message with the remedy if the limit of file descriptors is too low, otherwise "".

    `robots` is the number of robots that the agent connects to. Beyond the limit, libraries fail
    silently, or with errors that do not tell why.
    """
    limit, needed = resource.getrlimit(resource.RLIMIT_NOFILE)[0], _DESCRIPTORS + robots - 1
    if limit >= needed or limit == resource.RLIM_INFINITY:
        return ""
    return (
        f"too few file descriptors: the limit is {limit}, and {needed} are needed; raise it with "
        "ulimit -n 1024, in a systemd unit with LimitNOFILE=1024"
    )


INTERRUPTED = 130
"""Exit status after Ctrl-C, as shells have it."""


def run_program(main: Callable[[], int]) -> int:
    """Run the `main` of a program, and return its exit status.

    Ctrl-C, a missing library, a closed pipe, as with `| head`, and a full disk under its output end
    it without a traceback. What the encoding of the output lacks is escaped. Import the program
    inside of `main`, so that this also holds while its modules are loaded.
    """
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        status = main()
        if sys.stdout is not None:
            sys.stdout.flush()
        return status
    except KeyboardInterrupt:
        return INTERRUPTED
    except OSError as error:
        if error.filename is not None or error.errno not in (errno.EPIPE, errno.ENOSPC):
            raise
        if error.errno == errno.ENOSPC:
            print(f"error: cannot write the output: {error.strerror}", file=sys.stderr)
        # Python flushes the buffer once more at exit: give it somewhere to go.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except ImportError as error:
        if not (problem := import_problem(error)):
            raise
        print(f"error: {problem}", file=sys.stderr)
        return 1


_ROS = r"_?rclpy\w*|rpyutils|rosidl\w*|ament_index_python|\w+_(msgs|interfaces)"
"""Pattern of the modules that belong to ROS or to its workspace."""
_RECORDING = "mcap mcap-protobuf-support foxglove-schemas-protobuf"
_RECORDING_OLD_PROTOBUF = "mcap 'mcap-protobuf-support<0.4' 'foxglove-schemas-protobuf<0.4'"
"""Libraries for recordings with a protobuf older than 5.29, e.g. from apt."""
_VDA5050 = "'aiomqtt>=2.3' 'jsonschema>=4.20'"
_PIP_ARGUMENTS = {
    "websockets": "'websockets>=10.4'",
    "google": "'protobuf>=3.21'",
    "aiohttp": "'aiohttp>=3.9'",
    "yaml": "pyyaml",
    "PIL": "pillow",
    **dict.fromkeys(("mcap", "mcap_protobuf", "foxglove_schemas_protobuf"), _RECORDING),
    **dict.fromkeys(("aiomqtt", "jsonschema", "paho"), _VDA5050),
}
"""Arguments of `pip install` for a module, if they differ from its name."""


def import_problem(error: ImportError) -> str:
    """Return the message for an import that failed, with the remedy; empty if that is a defect.

    Missing libraries, an environment without ROS and protobuf modules that are not compiled have a
    remedy.
    """
    reason = str(error).partition("\n")[0]
    module, _, part = (error.name or "").partition(".")
    if re.fullmatch(_ROS, module):
        return (
            f"ROS is not available ({reason}): source the setup files of ROS and of the workspace"
        )
    if module == __package__ and re.fullmatch(r"pb(\..*)?", part):
        return (
            "the protobuf modules are not compiled; run scripts/setup or "
            "python3 setup.py build_proto"
        )
    if module == __package__ or not isinstance(error, ModuleNotFoundError):
        return ""  # not a missing library, but a defect
    needed = _PIP_ARGUMENTS.get(module, module)
    if needed is _RECORDING and _release(_installed()["protobuf"]) < [5, 29]:
        needed = _RECORDING_OLD_PROTOBUF
    return f"the module {module} is not installed here; {_pip_command(needed)}"


def _pip_command(arguments: str) -> str:
    """Return the advice to run pip, with the options for a Python that the system manages."""
    import sysconfig

    marker = os.path.join(sysconfig.get_path("stdlib"), "EXTERNALLY-MANAGED")
    if sys.prefix == sys.base_prefix and os.path.exists(marker):  # not in an environment of its own
        arguments = f"--user --break-system-packages {arguments}"
    return f"run: python3 -m pip install {arguments}"


def outdated_libraries() -> str:
    """Return the message for outdated libraries, with the remedy; empty if none is too old.

    Raises:
        ModuleNotFoundError: a library is missing.
    """
    oldest = {"websockets": [10, 4], "protobuf": [3, 21]}
    installed = _installed()
    old = [
        f"{name} {installed[name]}"
        for name, release in oldest.items()
        if _release(installed[name]) < release
    ]
    if not old:
        return ""
    needed = " ".join(_PIP_ARGUMENTS[module] for module in ("websockets", "google"))
    return f"too old: {' and '.join(old)}; {_pip_command(needed)}"


def _installed() -> dict[str, str]:
    """Return the versions of the libraries that every program needs.

    protobuf 3.21 from apt reports its version as 4.21 or 3.21.
    """
    import google.protobuf
    from websockets.version import version as websockets_version

    return {"websockets": websockets_version, "protobuf": google.protobuf.__version__}


def _release(version: str) -> list[int]:
    """Return the first two numbers of a version."""
    return [int(part) for part in version.split(".")[:2]]
