"""Command line of `dashboard`."""

from __future__ import annotations

import argparse
import errno
import logging
import socket
import ssl
import sys
from collections.abc import Sequence
from pathlib import Path

from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.link.reports import log_to_stderr
from woosh_robot_agent.tools.dashboard.access import (
    Role,
    kept_tokens,
    new_tokens,
)
from woosh_robot_agent.tools.dashboard.control import ControlConfig
from woosh_robot_agent.tools.dashboard.server import Dashboard, DashboardConfig
from woosh_robot_agent.tools.options import (
    ToolError,
    add_link_options,
    is_local,
    link_config,
    run_tool,
    stop_event,
    tool_parser,
)

_EPILOG = """\
Without --control, nothing is sent that changes or moves something: the page only
shows. --ip can be repeated."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Serve the page until SIGINT, SIGTERM or SIGHUP.

    Returns:
        The exit status: 0; 1 if the page cannot be served.
    """
    parser = make_parser()
    options = parser.parse_args(arguments)
    if not options.host:
        parser.error("--host is empty: give an address of this machine, or 0.0.0.0 for all of them")
    if not 0 <= options.page_port < 2**16:
        parser.error(f"--page-port must be within 0 to 65535: {options.page_port}")
    for name in ("max_linear", "max_angular"):
        if not 0.0 < getattr(options, name) <= 10.0:
            option = name.replace("_", "-")
            parser.error(f"--{option} must be above 0, and at most 10: {getattr(options, name):g}")
    configs = [link_config(parser, options, address) for address in options.ip]
    robots = list({each.address: each for each in configs}.values())  # each robot once
    try:
        tokens = kept_tokens(options.token_file) if options.token_file else new_tokens()
    except ToolError as error:
        parser.error(f"--token-file: {error}")
    config = DashboardConfig(
        host=options.host,
        port=options.page_port,
        tls=_tls(parser, options),
        control=options.control,
        tokens=tokens,
        control_config=ControlConfig(options.max_linear, options.max_angular),
    )
    log_to_stderr(logging.WARNING, "%(levelname)s: %(message)s")
    return run_tool(_run(robots, config))


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    default = DashboardConfig()
    parser = tool_parser("dashboard", "Show robots on a page in the browser.", _EPILOG)
    add_link_options(parser, several=True)
    parser.add_argument(
        "--host",
        default=default.host,
        help="address to serve the page on; if other machines reach it, open a printed address, "
        "which has a token (default: %(default)s)",
    )
    parser.add_argument(
        "--page-port",
        type=int,
        default=default.port,
        help="port to serve the page on; 0: any free one (default: %(default)s)",
    )
    parser.add_argument(
        "--tls-cert",
        metavar="FILE",
        help="certificate to serve the page over HTTPS, as PEM, with its chain",
    )
    parser.add_argument(
        "--tls-key", metavar="FILE", help="private key, if it is not in the file of --tls-cert"
    )
    parser.add_argument(
        "--token-file",
        type=Path,
        metavar="FILE",
        help="file that keeps the tokens, so that the addresses stay valid; created if missing "
        "(default: new tokens at each start)",
    )
    parser.add_argument(
        "--control", action="store_true", help="allow the page to command and drive the robots"
    )
    for name, unit in (("linear", "m/s"), ("angular", "rad/s")):
        parser.add_argument(
            f"--max-{name}",
            type=float,
            default=getattr(default.control_config, f"max_{name}"),
            help=f"maximum {name} speed of the stick, in {unit} (default: %(default)g)",
        )
    return parser


def _tls(parser: argparse.ArgumentParser, options: argparse.Namespace) -> ssl.SSLContext | None:
    """Return the certificate for HTTPS; None for HTTP. An unusable certificate ends the program."""
    if options.tls_cert is None:
        if options.tls_key is not None:
            parser.error("--tls-key needs --tls-cert")
        return None
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    try:
        context.load_cert_chain(
            options.tls_cert,
            options.tls_key,
            password=lambda: parser.error("--tls-key is encrypted: give a key without a password"),
        )
    except OSError as error:  # also for files that are no certificate, or do not belong together
        parser.error(
            f"cannot use --tls-cert and --tls-key: {error}; give PEM files that belong together"
        )
    return context


async def _run(robots: Sequence[LinkConfig], config: DashboardConfig) -> int:
    stop = stop_event()
    dashboard = Dashboard(robots, config)
    try:
        await dashboard.start()
    except OSError as error:
        wrong_host = isinstance(error, socket.gaierror) or error.errno == errno.EADDRNOTAVAIL
        remedy = (
            "choose an address of this machine with --host"
            if wrong_host
            else "choose another port with --page-port"
        )
        where = f"{config.host}, port {config.port}"
        reason = error.strerror or error
        raise ToolError(f"cannot serve the page on {where}: {reason}; {remedy}") from None
    try:
        print(f"dashboard ready at {dashboard.url}", flush=True)
        if config.control:
            print("with control: the page can command and drive the robots", file=sys.stderr)
        else:
            print("without control: the page only shows; see --control", file=sys.stderr)
        if not is_local(config.host):
            rights = "command the robots" if config.control else "watch the robots"
            print(f"warning: everybody who knows this address can {rights}", file=sys.stderr)
            if config.control:
                print(f"to watch only: {dashboard.urls[Role.LOOK]}", file=sys.stderr)
        await stop.wait()
    finally:
        await dashboard.close()
    return 0
