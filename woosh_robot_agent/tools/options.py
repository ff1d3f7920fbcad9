"""Options that the tools share: which chassis, and how it is spoken to."""

from __future__ import annotations

import argparse
import ipaddress
import sys
from dataclasses import fields

from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.link.config import DEFAULT_PORTS, ENCODINGS


def add_link_options(parser: argparse.ArgumentParser, *, ip_required: bool = True) -> None:
    """Add `--ip` and the rest of the link's options to a parser."""
    default = LinkConfig()
    parser.add_argument("--ip", required=ip_required, help="address or host name of the robot")
    parser.add_argument(
        "--port",
        type=int,
        default=default.port,
        help="its port; the transport's default, "
        + " or ".join(f"{port} for {name}" for name, port in DEFAULT_PORTS.items()),
    )
    parser.add_argument(
        "--transport", choices=DEFAULT_PORTS, default=default.transport, help="how to connect"
    )
    parser.add_argument(
        "--encoding", choices=ENCODINGS, default=default.encoding, help="encoding of the frames"
    )
    parser.add_argument(
        "--robot-id", type=int, default=default.robot_id, help="which robot, behind a gateway"
    )
    parser.add_argument(
        "--timeout",
        type=float,
        default=default.connect_timeout,
        help="s to wait for the connection, and for each answer",
    )


def link_config(parser: argparse.ArgumentParser, options: argparse.Namespace) -> LinkConfig:
    """The link's configuration of parsed options; ends the program where one makes no sense."""
    names = {field.name for field in fields(LinkConfig)}
    given = {name: value for name, value in vars(options).items() if name in names}
    timeouts = dict.fromkeys(
        ("connect_timeout", "handshake_timeout", "request_timeout"), options.timeout
    )
    try:
        return LinkConfig(**given, **timeouts)
    except ValueError as error:
        parser.error(str(error))


def warn_if_not_local(host: str, danger: str) -> None:
    """Say on stderr what listening beyond this machine means.

    Args:
        host: address to listen at.
        danger: what anybody who reaches it can do.
    """
    try:
        local = ipaddress.ip_address(host).is_loopback
    except ValueError:
        local = host == "localhost"
    if not local:
        print(f"warning: anybody who reaches {host} {danger}", file=sys.stderr)
