"""Options that all benchmarks of speed share."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass

from woosh_robot_agent.parameters import EXECUTORS

_TURNS = 5
"""Number of times that agent and floor are measured alternately in one repetition.

The speed of a machine drifts, and measuring alternately cancels that out.
"""
LINKS = {
    "WebSocket, JSON": ("websocket", "json"),
    "WebSocket, protobuf": ("websocket", "protobuf"),
    "TCP, protobuf": ("tcp", "protobuf"),
}
"""Transport and encoding of each kind of link, by its title in tables."""
_SMOKE_SCALE = 0.01


@dataclass(frozen=True)
class Options:
    """Options of one measurement.

    Attributes:
        executor: Executor of the agent. The floors always have rclpy's single-threaded one.
        scale: Factor on the usual number of samples.
        transport: Transport of the link.
        encoding: Encoding of the link.
    """

    executor: str = EXECUTORS[0]
    scale: float = 1.0
    transport: str = "websocket"
    encoding: str = "json"

    @property
    def smoke(self) -> bool:
        """True if the benchmark is only checked to work, with meaningless figures."""
        return self.scale < 1.0

    @property
    def turns(self) -> int:
        """Number of times that agent and floor are measured alternately."""
        return 1 if self.smoke else _TURNS

    def samples(self, usual: int) -> int:
        """Return the number of samples to take instead of the usual one."""
        return max(5, int(usual * self.scale))

    @property
    def agent_parameters(self) -> dict[str, str]:
        """Parameters of the agent, as set by these options."""
        return {
            "executor": self.executor,
            "transport": self.transport,
            "encoding": self.encoding,
        }


def make_parser(name: str, description: str | None) -> argparse.ArgumentParser:
    """Return a parser with the options that all benchmarks of speed share."""
    parser = argparse.ArgumentParser(
        prog=f"scripts/bench --{name}",
        description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--repeat", type=int, default=3, help="repetitions to take the median of (default 3)"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object, not tables")
    parser.add_argument(
        "--smoke", action="store_true", help="run for seconds, only to see that it works"
    )
    parser.add_argument("--docs", action="store_true", help="write the results to docs/speed.md")
    parser.add_argument(
        "--executor", default=EXECUTORS[0], choices=EXECUTORS, help="executor of the agent"
    )
    return parser


def parse(parser: argparse.ArgumentParser, arguments: Sequence[str]) -> argparse.Namespace:
    """Return the options in `arguments`, or end the program if they make no sense."""
    options = parser.parse_args(arguments)
    if options.repeat < 1:
        parser.error("--repeat must be at least 1")
    if options.docs and options.smoke:
        parser.error("--docs cannot be combined with --smoke, whose figures mean nothing")
    return options


def repetitions(options: argparse.Namespace) -> int:
    """Return the number of repetitions."""
    return 1 if options.smoke else int(options.repeat)


def scale(options: argparse.Namespace) -> float:
    """Return the factor on the number of samples."""
    return _SMOKE_SCALE if options.smoke else 1.0
