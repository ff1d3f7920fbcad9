"""Command line and main loop of `dashboard`."""

from __future__ import annotations

import argparse
import asyncio
import errno
import logging
import socket
import sys
from collections.abc import Sequence

from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.link.reports import log_to_stderr
from woosh_robot_agent.program import exit_on_stdout_error
from woosh_robot_agent.tools.dashboard.access import is_local
from woosh_robot_agent.tools.dashboard.dashboard import Dashboard, DashboardConfig
from woosh_robot_agent.tools.options import add_link_options, link_config, stop_event

_EPILOG = """\
Without --control, nothing is sent that changes or moves something: the page only
shows. --ip can be repeated."""


@exit_on_stdout_error
def main(arguments: Sequence[str] | None = None) -> int:
    """Serve the page until SIGINT or SIGTERM.

    Args:
        arguments: Arguments of the program; by default those of the command line.

    Returns:
        The exit status: 0; 1 if the page cannot be served.
    """
    default = DashboardConfig()
    parser = argparse.ArgumentParser(
        prog="dashboard",
        description="Show robots on a page in the browser.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_link_options(parser, several=True)
    parser.add_argument(
        "--host",
        default=default.host,
        help="address to serve the page on; another one than this machine's own needs the token of "
        "the printed address (default: %(default)s)",
    )
    parser.add_argument(
        "--page-port",
        type=int,
        default=default.port,
        help="port to serve the page on; 0: any free one (default: %(default)s)",
    )
    parser.add_argument(
        "--control", action="store_true", help="allow the page to command and drive the robots"
    )
    for name, unit in (("linear", "m/s"), ("angular", "rad/s")):
        parser.add_argument(
            f"--max-{name}",
            type=float,
            default=getattr(default, f"max_{name}"),
            help=f"maximum {name} speed of the stick, in {unit} (default: %(default)g)",
        )
    parser.add_argument(
        "--scan-rate",
        type=float,
        default=default.scan_rate,
        help="rate of laser scans while somebody watches, in Hz (default: %(default)g)",
    )
    parser.add_argument(
        "--max-viewers",
        type=int,
        default=default.max_viewers,
        help="maximum number of viewers (default: %(default)s)",
    )
    options = parser.parse_args(arguments)
    if not options.host:
        parser.error("--host is empty: give an address of this machine, or 0.0.0.0 for all of them")
    if not 0 <= options.page_port < 2**16:
        parser.error(f"--page-port must be within 0 to 65535: {options.page_port}")
    if not 0.1 <= options.scan_rate <= 50.0:
        parser.error(f"--scan-rate must be within 0.1 to 50: {options.scan_rate:g}")
    for name in ("max_linear", "max_angular"):
        if not 0.0 < getattr(options, name) <= 10.0:
            option = name.replace("_", "-")
            parser.error(f"--{option} must be above 0, and at most 10: {getattr(options, name):g}")
    if options.max_viewers < 1:
        parser.error(f"--max-viewers must be at least 1: {options.max_viewers}")
    if options.control and options.max_viewers <= len(options.ip):
        parser.error(
            "--max-viewers must be more than the number of robots with --control, so that there is "
            f"a place for somebody who stops them: {options.max_viewers}"
        )
    robots = [link_config(parser, options, address) for address in options.ip]
    config = DashboardConfig(
        host=options.host,
        port=options.page_port,
        control=options.control,
        max_linear=options.max_linear,
        max_angular=options.max_angular,
        scan_rate=options.scan_rate,
        max_viewers=options.max_viewers,
    )
    log_to_stderr(logging.WARNING, "%(levelname)s: %(message)s")
    # websockets logs every aborted handshake as an error. Port scans would fill the log.
    logging.getLogger("websockets").setLevel(logging.CRITICAL)
    try:
        return asyncio.run(_run(robots, config))
    except OSError as error:
        reason = error.strerror or error
        wrong_host = isinstance(error, socket.gaierror) or error.errno == errno.EADDRNOTAVAIL
        remedy = (
            "choose an address of this machine with --host"
            if wrong_host
            else "choose another port with --page-port"
        )
        print(
            f"error: cannot serve the page on {config.host}, port {config.port}: {reason}; "
            f"{remedy}",
            file=sys.stderr,
        )
        return 1


async def _run(robots: Sequence[LinkConfig], config: DashboardConfig) -> int:
    stop = stop_event()
    async with Dashboard(robots, config) as dashboard:
        print(f"dashboard ready at {dashboard.url}", flush=True)
        if config.control:
            print("with control: the page can command and drive the robots", file=sys.stderr)
        else:
            print("without control: the page only shows; see --control", file=sys.stderr)
        if not is_local(config.host):
            rights = "command the robots" if config.control else "watch the robots"
            print(f"warning: everybody who knows this address can {rights}", file=sys.stderr)
        await stop.wait()
    return 0
