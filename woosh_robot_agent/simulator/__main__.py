"""The simulated chassis as a program."""

from __future__ import annotations

import argparse
import asyncio
import functools
import logging
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

from woosh_robot_agent.simulator.config import SimulatorConfig
from woosh_robot_agent.simulator.faults import Scenario, load_scenario, markdown, parse_fault
from woosh_robot_agent.simulator.scenes.yaml_fields import SceneError
from woosh_robot_agent.simulator.server import SimulatedChassis


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a simulated chassis until SIGINT or SIGTERM.

    Args:
        arguments: Those of the command line if None.

    Returns:
        The exit status: 0, or 1 if it could not start.
    """
    parser = _parser()
    options = parser.parse_args(arguments)
    if options.list_faults:
        print(markdown())
        return 0
    logging.basicConfig(
        level=[logging.WARNING, logging.INFO, logging.DEBUG][min(options.verbose, 2)],
        format="%(levelname)s %(name)s: %(message)s",
    )
    # The library logs each handshake that is broken off, which is an everyday matter for a port.
    logging.getLogger("websockets").setLevel(logging.CRITICAL)
    try:
        scenario = load_scenario(options.scenario) if options.scenario else Scenario()
        scenario += Scenario(tuple(parse_fault(text) for text in options.fault))
        config = SimulatorConfig(
            host=options.host,
            port=options.port,
            tcp_port=options.tcp_port,
            speed=options.speed,
            seed=options.seed,
            scenes=tuple(options.scene),
            robot_id=options.robot_id,
            omnidirectional=options.base == "omnidirectional",
            initialised=not options.uninitialised,
            max_frame=options.max_frame,
            max_connections=options.max_connections,
            max_waiting=options.max_waiting,
            max_outbox=options.max_outbox,
            scenario=scenario,
        )
    except ValueError as error:
        parser.error(str(error))
    except OSError as error:
        parser.error(f"scenario {options.scenario}: {error.strerror or error}")
    if not config.local:
        print(
            f"warning: anybody who reaches {config.host} can command this simulated robot",
            file=sys.stderr,
        )
    try:
        asyncio.run(_serve(config))
    except SceneError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        reason = error.strerror or str(error)
        print(f"error: cannot listen on {config.host}: {reason}", file=sys.stderr)
        return 1
    return 0


async def _serve(config: SimulatorConfig) -> None:
    stopping = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stopping.set)
    async with SimulatedChassis(config) as simulator:
        host = f"[{config.host}]" if ":" in config.host else config.host
        print(
            f"simulated chassis ready on ws://{host}:{simulator.port} "
            f"and tcp://{host}:{simulator.tcp_port}",
            flush=True,
        )
        await stopping.wait()


def _parser() -> argparse.ArgumentParser:
    default = SimulatorConfig()
    parser = argparse.ArgumentParser(
        prog="simulator",
        description="A simulated Woosh chassis that speaks the chassis link.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("--host", default=default.host, help="address to listen at")
    parser.add_argument("--port", type=int, default=default.port, help="WebSocket port, 0: any")
    parser.add_argument(
        "--tcp-port", type=int, default=default.tcp_port, help="delimited protobuf's port, 0: any"
    )
    parser.add_argument(
        "--speed", type=float, default=default.speed, help="how much faster time runs, 1 to 100"
    )
    parser.add_argument(
        "--seed",
        type=int,
        default=default.seed,
        help="make laser noise, clock and faults' choices repeatable",
    )
    parser.add_argument(
        "--scene",
        type=Path,
        action="append",
        default=[],
        metavar="FOLDER",
        help="folder with scene.yaml, or a map of nav2 (YAML); again for more, it starts in the "
        "first",
    )
    parser.add_argument("--robot-id", type=int, default=default.robot_id, help="robot number")
    parser.add_argument(
        "--base",
        choices=("omnidirectional", "differential"),
        default="omnidirectional",
        help="whether it can move sideways",
    )
    parser.add_argument(
        "--uninitialised",
        action="store_true",
        help="start like a robot that was just switched on: InitRobot comes first",
    )
    _add_faults(parser)
    _add_limits(parser, default)
    parser.add_argument(
        "-v",
        "--verbose",
        action="count",
        default=0,
        help="log clients and faults; twice: all bad frames",
    )
    return parser


def _add_faults(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("faults")
    group.add_argument(
        "--fault",
        action="append",
        default=[],
        metavar='"NAME KEY=VALUE ... at=S for=S"',
        help="what goes wrong, when, and for how long, in simulated s; can be repeated",
    )
    group.add_argument(
        "--scenario", metavar="FILE", help="faults from a YAML file: a list of {at: S, do: NAME}"
    )
    group.add_argument(
        "--list-faults", action="store_true", help="print all faults with their arguments and end"
    )


def _add_limits(parser: argparse.ArgumentParser, default: SimulatorConfig) -> None:
    group = parser.add_argument_group("limits")
    add = functools.partial(group.add_argument, type=int, metavar="N")
    add("--max-frame", default=default.max_frame, help="bytes of a client's largest frame")
    add("--max-connections", default=default.max_connections, help="clients at a time")
    add(
        "--max-waiting",
        default=default.max_waiting,
        help="requests of a client that may wait, further ones are refused",
    )
    add(
        "--max-outbox",
        default=default.max_outbox,
        help="frames that may wait for a client, one that is slower is dropped",
    )


if __name__ == "__main__":
    sys.exit(main())
