"""Standard streams that the caller has closed, e.g. by `2>&-`."""

from __future__ import annotations

# Import nothing slow here: programs import this module before they can handle signals.
import os
import sys


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
