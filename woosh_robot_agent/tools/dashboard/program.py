"""Command line of `dashboard`."""

from __future__ import annotations

import argparse
import asyncio
import errno
import logging
import os
import socket
import ssl
import sys
from collections.abc import Sequence
from pathlib import Path

from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.link.reports import LogOnce, log_to_stderr
from woosh_robot_agent.link.tasks import start_task
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

_LOG = logging.getLogger(__name__)
_RENEWAL_PERIOD = 60.0
"""Time between two checks if the certificate was renewed, in seconds."""
_PEM_HINT = "give PEM files that belong together, and a key without a password"
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
    return run_tool(_run(robots, config, _certificate_files(options)))


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
        _load(context, _certificate_files(options))
    except (OSError, ValueError) as error:  # also if they are no certificate or key
        parser.error(f"cannot use --tls-cert and --tls-key: {error}; {_PEM_HINT}")
    return context


def _certificate_files(options: argparse.Namespace) -> list[str]:
    """Return the files of `--tls-cert` and `--tls-key`, as far as they are given."""
    return [each for each in (options.tls_cert, options.tls_key) if each is not None]


def _load(context: ssl.SSLContext, files: Sequence[str]) -> None:
    """Load a certificate, and its key if it has a file of its own, for further connections.

    Raises:
        OSError, ValueError: the files cannot be used.
    """

    def no_password() -> str:
        raise ValueError("the key is encrypted")

    context.load_cert_chain(files[0], files[-1], password=no_password)


async def _use_renewed(context: ssl.SSLContext, files: Sequence[str]) -> None:
    """Load a certificate again whenever its files have changed."""
    log = LogOnce(_LOG)
    loaded: list[int] = []
    while True:
        try:
            versions = [os.stat(each).st_mtime_ns for each in files]
            if loaded and versions != loaded:
                # tried first, because a failure leaves a context without a key
                _load(ssl.create_default_context(ssl.Purpose.CLIENT_AUTH), files)
                _load(context, files)
                print("the renewed certificate is used", file=sys.stderr, flush=True)
                log.clear()
            loaded = versions
        except (OSError, ValueError) as error:
            log.warn(
                str(error),
                "the page is still served with the former certificate: cannot use "
                f"{' and '.join(files)}: {error}; {_PEM_HINT}",
            )
        await asyncio.sleep(_RENEWAL_PERIOD)


async def _run(
    robots: Sequence[LinkConfig], config: DashboardConfig, certificate_files: Sequence[str]
) -> int:
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
    renewal: asyncio.Task[None] | None = None
    if config.tls is not None:
        renewal = start_task(
            _use_renewed(config.tls, certificate_files), "renewal of the certificate"
        )
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
        if renewal is not None:
            renewal.cancel()
        await dashboard.close()
    return 0
