"""File descriptors as the caller passed them: closed standard streams, too low a limit."""

from __future__ import annotations

# Import nothing slow here: programs import this module before they can handle signals.
import os
import resource
import sys

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
