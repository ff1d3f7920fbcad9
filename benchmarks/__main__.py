"""`scripts/bench`: run one benchmark and pass it the remaining arguments."""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Sequence

BENCHMARKS = {
    "dashboard": (
        "benchmarks.report.dashboard",
        "cost of the page in the browser, by number of viewers",
    ),
    "faults": ("tests.robustness.faults", "every fault, alone and in pairs, amid traffic"),
    "fleet": ("benchmarks.report.fleet", "cost of VDA 5050 vehicles, by number of robots"),
    "flood": ("tests.robustness.flood", "too many calls, pushes and bytes; slow answers"),
    "fuzz": ("tests.robustness.fuzz", "malformed frames, requests and bytes"),
    "links": ("benchmarks.report.links", "WebSocket and TCP, JSON and protobuf, compared"),
    "maps": ("benchmarks.report.maps", "transfer of a map of 20 MiB, over each kind of link"),
    "odom": ("benchmarks.report.odom", "error of odom between the robot's reports"),
    "real": ("benchmarks.report.real", "the simulated chassis, compared with a real robot"),
    "recording": ("benchmarks.report.recording", "cost of `record` at 1000 frames a second"),
    "scale": ("benchmarks.report.scale", "cost by number of robots, push rate and scan size"),
    "setup": ("benchmarks.report.setup", "time of scripts/setup in new checkouts; takes minutes"),
    "soak": ("tests.robustness.soak", "an hour of mixed traffic and faults"),
    "speed": (
        "benchmarks.report.speed",
        "cost of the agent relative to bare rclpy and sockets",
    ),
}
"""Module and description of each benchmark. Each module has `main(arguments) -> exit status`."""


def main(arguments: Sequence[str]) -> int:
    """Run the benchmark that the first argument names.

    Returns:
        The exit status: 1 if a limit was exceeded, otherwise 0.
    """
    parser = argparse.ArgumentParser(
        prog="scripts/bench",
        description="Measures how robust and how fast the agent is, and how much the simulated "
        "chassis is like a real robot. Prints Markdown tables. The exit status is 1 if a limit is "
        "exceeded.",
        epilog="Each benchmark has options of its own: scripts/bench --soak --help.",
        allow_abbrev=False,
    )
    group = parser.add_mutually_exclusive_group(required=True)
    for name, (module, description) in BENCHMARKS.items():
        group.add_argument(
            f"--{name}", dest="module", action="store_const", const=module, help=description
        )
    module_name = parser.parse_args(arguments[:1]).module
    status: int = importlib.import_module(module_name).main(arguments[1:])
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
