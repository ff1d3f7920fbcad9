"""Command line of the simulator."""

from __future__ import annotations

import argparse
import asyncio
import importlib
import logging
import os
import sys
from collections.abc import Sequence
from contextlib import AbstractAsyncContextManager, AsyncExitStack
from dataclasses import fields
from pathlib import Path

import woosh_robot_agent.link.protos  # noqa: F401 - reports protobuf modules that are missing
from woosh_robot_agent.data_files import DataFileError
from woosh_robot_agent.link.config import url_host
from woosh_robot_agent.link.reports import log_to_stderr
from woosh_robot_agent.program import StopSignals
from woosh_robot_agent.simulator.config import SimulatorConfig
from woosh_robot_agent.simulator.faults import Scenario, load_scenario, markdown, parse_fault
from woosh_robot_agent.simulator.profile import SHIPPED, load_profile
from woosh_robot_agent.simulator.server import SimulatedChassis

_DISCONNECT_TIMEOUT = 1.0
"""Maximum time for which clients are still served after a signal, in seconds.

The same Ctrl-C may end an agent, which then stops the robot and needs the link for that.
"""

_DASHBOARD = "woosh_robot_agent.tools.dashboard.beside_simulator"
"""Module that serves the page of `--dashboard`.

It is imported by its name and only on demand, because it belongs to a layer above the simulator."""

_LEARN = "woosh_robot_agent.tools.doctor.learn"
"""Module for `--learn`, imported like `_DASHBOARD`, because it belongs to the same layer."""

_DASHBOARD_PORT = 8480
"""Default port of the page of `--dashboard`."""

_REPEAT_TIME = 0.3
"""Time within which further signals count as repeats of the first one, in seconds.

Without a terminal, `ros2 launch` sends a second SIGINT after the process group got the first one.
"""


class _PortError(Exception):
    """A port cannot be used. The text says why, and what to do."""


def run(arguments: Sequence[str] | None, signals: StopSignals) -> int:
    """Run a simulated chassis until a signal arrives, or only do what e.g. `--check` asks for.

    After the signal, the chassis still serves its clients until they have disconnected, for
    `_DISCONNECT_TIMEOUT` at most. Another signal, later than `_REPEAT_TIME`, ends it at once.

    Args:
        arguments: command-line arguments; None for the arguments of this process.

    Returns:
        The exit status: 1 if the chassis could not start, or if `--check` or `--learn` failed;
        otherwise 0.

    Raises:
        SystemExit: an argument or the scenario is invalid, or the help was printed.
    """
    parser = make_parser()
    options = parser.parse_args(arguments)
    try:
        if options.list_faults:
            print(markdown())
        elif options.check:
            return _check(options.check, options.profile)
        elif options.learn:
            if options.profile in SHIPPED:
                parser.error("--learn needs --profile FILE: the new file to write")
            learn_profile = importlib.import_module(_LEARN).learn_profile
            print(learn_profile(options.learn, Path(options.profile)))
        else:
            _run_chassis(parser, options, signals)
    except (DataFileError, _PortError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def _run_chassis(
    parser: argparse.ArgumentParser, options: argparse.Namespace, signals: StopSignals
) -> None:
    """Run a simulated chassis until a signal arrives; `run` reports the errors."""
    log_to_stderr(
        [logging.WARNING, logging.INFO, logging.DEBUG][min(options.verbose, 2)],
        "%(levelname)s %(name)s: %(message)s",
    )
    try:
        config = _config(options)
    except ValueError as error:
        parser.error(str(error))
    except OSError as error:
        parser.error(f"scenario {options.scenario}: {error.strerror or error}")
    if not config.local:
        print(
            f"warning: everybody who can reach {config.host} can control this simulated robot",
            file=sys.stderr,
        )
    try:
        asyncio.run(_serve(config, signals, options.dashboard))
    except BrokenPipeError:  # concerns standard output, not a port; `run_program` handles it
        raise
    except OSError as error:
        raise _PortError(
            f"cannot listen on {config.host}: {error.strerror or error}; "
            "choose another address or other ports: --host, --port and --tcp-port"
        ) from None


_OPTIONS = [each for each in fields(SimulatorConfig) if each.metadata]
"""Fields of `SimulatorConfig` that are also command-line options, under the same names."""


def _config(options: argparse.Namespace) -> SimulatorConfig:
    """Return the configuration from the options; raise ValueError or OSError for invalid ones."""
    scenario = load_scenario(options.scenario) if options.scenario else Scenario()
    return SimulatorConfig(
        **{each.name: getattr(options, each.name) for each in _OPTIONS},
        scenes=tuple(options.scene),
        omnidirectional=options.base == "omnidirectional",
        initialised=not options.uninitialised,
        scenario=scenario + Scenario(tuple(parse_fault(text) for text in options.fault)),
    )


def _check(scene: Path, profile: str) -> int:
    """Print the errors in a scene, and return the exit status: 1 if there are any."""
    from woosh_robot_agent.simulator.scene_check import check_scene

    findings = check_scene(scene, load_profile(profile))
    print("\n".join(findings) if findings else f"{scene}: nothing is wrong")
    return 1 if findings else 0


async def _serve(config: SimulatorConfig, signals: StopSignals, dashboard_port: int | None) -> None:
    """Serve clients until a signal arrives, and then for a short time, so that they can finish.

    That time ends when all clients have disconnected, when another signal arrives, or after
    `_DISCONNECT_TIMEOUT`. The page is closed before it.

    Args:
        dashboard_port: port of the page; None to serve no page.
    """
    loop, stopping = asyncio.get_running_loop(), asyncio.Event()

    def on_signal() -> None:
        os.read(signals.fd, 1024)  # the loop calls again while something is left to read
        stopping.set()

    loop.add_reader(signals.fd, on_signal)
    try:
        simulator = SimulatedChassis(config)
        if signals.received:  # while the scenes were loading
            return
        async with simulator:
            async with AsyncExitStack() as stack:
                if dashboard_port is not None:
                    url = await _serve_dashboard(stack, simulator, dashboard_port)
                    print(f"dashboard ready at {url}", flush=True)
                host = url_host(config.host)
                print(
                    f"simulated chassis ready on ws://{host}:{simulator.port} "
                    f"and tcp://{host}:{simulator.tcp_port}",
                    flush=True,
                )
                await stopping.wait()
            ends = [
                asyncio.ensure_future(_wait_for_another_signal(stopping)),
                asyncio.ensure_future(simulator.wait_disconnected()),
            ]
            await asyncio.wait(
                ends, timeout=_DISCONNECT_TIMEOUT, return_when=asyncio.FIRST_COMPLETED
            )
            for end in ends:
                end.cancel()
    finally:
        loop.remove_reader(signals.fd)


async def _serve_dashboard(stack: AsyncExitStack, simulator: SimulatedChassis, port: int) -> str:
    """Serve the page until `stack` is closed; return its address, or raise _PortError."""
    module = importlib.import_module(_DASHBOARD)
    page: AbstractAsyncContextManager[str] = module.dashboard_beside(simulator, port)
    try:
        return await stack.enter_async_context(page)
    except OSError as error:
        raise _PortError(
            f"cannot serve the page on port {port}: {error.strerror or error}; choose another "
            "one: --dashboard PORT"
        ) from None


def _port(text: str) -> int:
    if not text.isdecimal() or int(text) >= 2**16:
        raise argparse.ArgumentTypeError(f"{text!r} is no port, from 0 to 65535")
    return int(text)


async def _wait_for_another_signal(stopping: asyncio.Event) -> None:
    """Wait until a signal after `_REPEAT_TIME` sets `stopping` again."""
    await asyncio.sleep(_REPEAT_TIME)
    stopping.clear()
    await stopping.wait()


class _HelpFormatter(argparse.ArgumentDefaultsHelpFormatter):
    """Shows the default of an option, unless it is empty, false or zero."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        return super()._get_help_string(action) if action.default else action.help


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(
        prog="simulator",
        description="A simulated Woosh chassis that speaks the chassis link.",
        formatter_class=_HelpFormatter,
    )
    for option in _OPTIONS:
        arguments = dict(option.metadata)
        # Options whose default is None are texts, or have their type in the metadata.
        if option.default is not None:
            arguments["type"] = type(option.default)
        name = option.name.replace("_", "-")
        parser.add_argument(f"--{name}", default=option.default, **arguments)
    parser.add_argument(
        "--scene",
        type=Path,
        action="append",
        default=[],
        metavar="FOLDER",
        help="folder of a scene from a robot, folder with scene.yaml, or YAML file of a nav2 map; "
        "can be repeated, the robot starts in the first one",
    )
    parser.add_argument(
        "--check",
        type=Path,
        metavar="FOLDER",
        help="print what is wrong with a scene, a line for each finding, and exit",
    )
    parser.add_argument(
        "--learn",
        type=Path,
        metavar="RECORDING_OR_SURVEY",
        help="learn a robot profile from a recording or from the folder of `doctor --survey`, "
        "write it to the file given by --profile (must not exist), and exit",
    )
    parser.add_argument(
        "--dashboard",
        type=_port,
        nargs="?",
        const=_DASHBOARD_PORT,
        metavar="PORT",
        help="also serve a page that shows and drives the robot, for browsers on this machine, on "
        f"this port; 0: any free one; without a port: {_DASHBOARD_PORT}",
    )
    parser.add_argument(
        "--base",
        choices=("omnidirectional", "differential"),
        default="omnidirectional",
        help="kind of base: an omnidirectional one can move sideways",
    )
    parser.add_argument(
        "--uninitialised",
        action="store_true",
        help="start without a known pose, until a client sends InitRobot",
    )
    parser.add_argument(
        "--fault",
        action="append",
        default=[],
        metavar='"NAME KEY=VALUE ... at=S for=S"',
        help="begin a fault at a simulated time, for a simulated duration; can be repeated",
    )
    parser.add_argument(
        "--scenario",
        metavar="FILE",
        help="read faults from a YAML file: a list of {at: S, do: NAME}",
    )
    parser.add_argument(
        "--list-faults", action="store_true", help="print all faults with their arguments and exit"
    )
    parser.add_argument(
        "-v",
        "--verbose",
        action="count",
        default=0,
        help="log clients and faults; twice: also bad frames",
    )
    return parser
