"""`scripts/bench`: picks one measurement; the rest of the arguments are its own."""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Sequence

BENCHES = {
    "faults": "every fault at every point: what the agent answers, and how soon it is back",
    "flood": "clients and a chassis that send too much, and one that answers too slowly",
    "fuzz": "frames, requests and goals that make no sense",
    "links": "what WebSocket and TCP, JSON and protobuf cost, side by side",
    "scale": "how the cost grows with robots, rate and size, with plots",
    "soak": "mixed traffic and a fault every now and then, for an hour",
    "speed": "what the agent costs over bare rclpy and a bare socket",
}
"""Measurements by name. Each is a module with `main(arguments) -> exit status`."""
ROBUSTNESS = ("faults", "flood", "fuzz", "soak")
"""Those that live in `tests.robustness`, because the tests run them in short."""


def main(arguments: Sequence[str]) -> int:
    """Run the measurement that the arguments name.

    Returns:
        0, or 1 where a limit was exceeded.
    """
    parser = argparse.ArgumentParser(
        prog="scripts/bench",
        description="Measures how robust and how fast the agent is, and prints a Markdown table. "
        "The exit status is 1 if a limit of robustness is exceeded.",
        epilog="Options after the first are those of the measurement: scripts/bench --soak --help.",
        allow_abbrev=False,
    )
    which = parser.add_mutually_exclusive_group(required=True)
    for name, what in BENCHES.items():
        which.add_argument(f"--{name}", dest="name", action="store_const", const=name, help=what)
    chosen = parser.parse_args(arguments[:1])
    package = "tests.robustness" if chosen.name in ROBUSTNESS else "benchmarks"
    status: int = importlib.import_module(f"{package}.{chosen.name}").main(arguments[1:])
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
