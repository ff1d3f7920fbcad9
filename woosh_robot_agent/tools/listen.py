"""Where a tool listens, as its command line says it."""

from __future__ import annotations

import argparse


def host_and_port(text: str) -> tuple[str, int]:
    """`HOST:PORT`, `[IPV6]:PORT` or `PORT` alone, which is one of this machine only.

    Raises:
        argparse.ArgumentTypeError: it is none of these.
    """
    host, _, port = text.rpartition(":")
    if not port.isdecimal() or not int(port) < 2**16:
        raise argparse.ArgumentTypeError(f"{text!r} is not HOST:PORT, e.g. 127.0.0.1:5480")
    return host.strip("[]") or "127.0.0.1", int(port)
