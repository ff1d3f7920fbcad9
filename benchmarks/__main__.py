"""`scripts/bench`: run one benchmark and pass it the remaining arguments."""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Sequence
from functools import partial

from benchmarks.results import save

BENCHMARKS = {
    "dashboard": (
        "benchmarks.dashboard",
        "cost of the page in the browser, by number of viewers",
    ),
    "faults": ("benchmarks.robustness.faults", "every fault, alone and in pairs, amid traffic"),
    "fleet": ("benchmarks.fleet", "cost of VDA 5050 vehicles, by number of robots"),
    "flood": ("benchmarks.robustness.flood", "too many calls, pushes and bytes; slow answers"),
    "fuzz": ("benchmarks.robustness.fuzz", "malformed frames, requests and bytes"),
    "links": ("benchmarks.links", "WebSocket and TCP, JSON and protobuf, compared"),
    "maps": ("benchmarks.maps", "transfer of a map of 20 MiB, over each kind of link"),
    "odom": ("benchmarks.odom", "error of odom between the robot's reports"),
    "real": ("benchmarks.real", "the simulated chassis, compared with a real robot"),
    "recording": ("benchmarks.recording", "cost of `record` at 1000 frames a second"),
    "scale": ("benchmarks.scale", "cost by number of robots, push rate and scan size"),
    "setup": ("benchmarks.setup", "time of scripts/setup in new checkouts; takes minutes"),
    "soak": ("benchmarks.robustness.soak", "an hour of mixed traffic and faults"),
    "speed": ("benchmarks.speed", "cost of the agent relative to bare rclpy and sockets"),
}
"""Module and description of each benchmark. Each module has `main(arguments) -> exit status`."""
SAVE = "--save"


def main(arguments: Sequence[str]) -> int:
    """Run the benchmark that the first argument names.

    Returns:
        The exit status: 1 if a limit was exceeded, otherwise 0.
    """
    parser = argparse.ArgumentParser(
        prog="scripts/bench",
        usage="scripts/bench --BENCHMARK [--save] [OPTION ...]",
        description="Measures how robust and how fast the agent is, and how much the simulated "
        "chassis is like a real robot. Prints Markdown tables. The exit status is 1 if a limit is "
        "exceeded.",
        epilog="Each benchmark has options of its own: scripts/bench --soak --help. With --save, "
        "its tables are also written to benchmarks/results/RELEASE/BENCHMARK.md.",
        allow_abbrev=False,
    )
    group = parser.add_mutually_exclusive_group(required=True)
    for name, (_, description) in BENCHMARKS.items():
        group.add_argument(
            f"--{name}", dest="name", action="store_const", const=name, help=description
        )
    name = parser.parse_args(arguments[:1]).name
    module, title = BENCHMARKS[name]
    options = [each for each in arguments[1:] if each != SAVE]
    run = partial(importlib.import_module(module).main, options)
    if len(options) == len(arguments) - 1:
        status: int = run()
        return status
    if useless := {"--json", "--smoke"} & {*options}:
        parser.error(f"{SAVE} cannot be combined with {', '.join(sorted(useless))}")
    return save(name, title, options, run)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
