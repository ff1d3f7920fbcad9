"""Options and errors that the tools share, and the event that ends them."""

from __future__ import annotations

import argparse
import asyncio
import ipaddress
import math
import re
import socket
import sys
from collections.abc import Coroutine
from typing import Any, NamedTuple

from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.link.config import DEFAULT_PORTS, ENCODINGS, url_host
from woosh_robot_agent.link.reports import printable
from woosh_robot_agent.link.tasks import run_main
from woosh_robot_agent.program import end_signals


class ToolError(Exception):
    """A tool cannot do what it should; the text says why, and what to do."""


def run_tool(work: Coroutine[Any, Any, int]) -> int:
    """Run the main coroutine of a tool, and print its `ToolError`; return the exit status."""
    try:
        return run_main(work)
    except ToolError as error:
        print(printable(f"error: {error}"), file=sys.stderr)
        return 1


def tool_parser(prog: str, description: str, epilog: str) -> argparse.ArgumentParser:
    """Return a parser without options, whose help keeps the line breaks of `epilog`."""
    return argparse.ArgumentParser(
        prog=prog,
        description=description,
        epilog=epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def stop_event() -> asyncio.Event:
    """Return an event that each of `end_signals` sets. Needs a running event loop."""
    stop = asyncio.Event()
    for number in end_signals():
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    return stop


class Address(NamedTuple):
    """Value of `--ip`: an address or host name, and a port; 0 is the default of the transport."""

    ip: str
    port: int = 0


def add_link_options(
    parser: argparse.ArgumentParser,
    *,
    ip_required: bool = True,
    for_subparser: bool = False,
    several: bool = False,
) -> None:
    """Add `--ip` and the other options of the link to a parser.

    Args:
        ip_required: True if `--ip` must be given.
        for_subparser: True for a subparser whose main parser has the options too. The options may
            come before or after the command; the main parser has their defaults and their help.
        several: True if `--ip` can be repeated; then its value is a list of `Address`.
    """
    default = LinkConfig()

    def add(name: str, **keywords: Any) -> None:
        if for_subparser:
            keywords |= {"default": argparse.SUPPRESS, "help": argparse.SUPPRESS, "required": False}
        parser.add_argument(name, **keywords)

    repeated = {"action": "append"} if several else {}
    add(
        "--ip",
        type=_address,
        metavar="HOST[:PORT]",
        required=ip_required,
        help="address or host name of the robot, and its port (default: "
        + ", ".join(f"{port} for {name}" for name, port in DEFAULT_PORTS.items())
        + ")",
        **repeated,
    )
    add(
        "--transport",
        choices=DEFAULT_PORTS,
        default=default.transport,
        help="transport of the link (default: %(default)s)",
    )
    add(
        "--encoding",
        choices=ENCODINGS,
        default=default.encoding,
        help="encoding of WebSocket frames (default: %(default)s)",
    )
    add(
        "--robot-id",
        type=int,
        default=default.robot_id,
        help="id of the robot behind a gateway (default: %(default)s, no gateway)",
    )
    add(
        "--timeout",
        type=above_zero,
        default=default.connect_timeout,
        help="timeout of the connection and of each answer, in seconds (default: %(default)g)",
    )


def link_config(
    parser: argparse.ArgumentParser, options: argparse.Namespace, address: Address | None = None
) -> LinkConfig:
    """Return the configuration of the link; an invalid option ends the program.

    The address is by default `options.ip`, which must then be one `Address`.
    """
    ip, port = options.ip if address is None else address
    try:
        return LinkConfig(
            ip=ip,
            port=port,
            transport=options.transport,
            encoding=options.encoding,
            robot_id=options.robot_id,
            connect_timeout=options.timeout,
            handshake_timeout=options.timeout,
            request_timeout=options.timeout,
        )
    except ValueError as error:
        parser.error(str(error))


def link_arguments(config: LinkConfig) -> str:
    """Return the options with which another tool reaches the same robot, to be shown in a hint."""
    address = f"{url_host(config.ip)}:{config.port}" if config.port else config.ip
    arguments = f"--ip {address}"
    for name in ("transport", "encoding", "robot_id"):
        value = getattr(config, name)
        if value != getattr(LinkConfig, name):
            arguments += f" --{name.replace('_', '-')} {value}"
    return arguments


def _address(text: str) -> Address:
    """Parse `HOST`, `HOST:PORT`, an IPv6 address or `[IPV6]:PORT`."""
    match = re.fullmatch(r"(\[.*\]|[^:]*):([0-9]{1,5})", text)
    host, port = (match[1], int(match[2])) if match else (text, 0)
    try:
        if match and port == 0:
            raise ValueError  # LinkConfig would take 0 for the default port
        # LinkConfig checks both; it wants an IPv6 address without brackets
        config = LinkConfig(ip=re.sub(r"^\[(.*:.*)\]$", r"\1", host), port=port)
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"must be HOST or HOST:PORT, with a port within 1 to 65535: {text!r}"
        ) from None
    return Address(config.ip, config.port)


def host_and_port(text: str) -> tuple[str, int]:
    """Parse `HOST:PORT`, `[IPV6]:PORT` or `PORT`, which stands for `127.0.0.1:PORT`.

    Raises:
        argparse.ArgumentTypeError: the text has another form.
    """
    host, _, port = text.rpartition(":")
    if not port.isdecimal() or int(port) >= 2**16:
        raise argparse.ArgumentTypeError(f"not HOST:PORT, e.g. 127.0.0.1:5480: {text!r}")
    return host.strip("[]") or "127.0.0.1", int(port)


def above_zero(text: str) -> float:
    """Parse a finite number above 0.

    Raises:
        argparse.ArgumentTypeError: the text is something else.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"must be a finite number above 0: {text}")
    return value


def is_local(host: str) -> bool:
    """Return True if only this machine can reach a server that listens on the address `host`."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def own_address(host: str, port: int) -> str:
    """Return this computer's address on the route to a numeric address; sends nothing.

    Raises:
        OSError: there is no route.
    """
    family, *_, target = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        probe.connect(target)
        return str(probe.getsockname()[0])


def warn_if_not_local(host: str, consequence: str) -> None:
    """Print a warning to stderr if other machines can reach `host`.

    Args:
        host: address to listen on.
        consequence: end of the sentence "everybody who can reach `host` ...".
    """
    if not is_local(host):
        print(f"warning: everybody who can reach {host} {consequence}", file=sys.stderr)
