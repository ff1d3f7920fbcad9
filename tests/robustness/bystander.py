"""A client that calls the agent during a flood."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from benchmarks.figures import Figure
from tests.harness import Client
from tests.robustness.traffic import DuplicateAnswers
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.testing import wait_until
from woosh_robot_msgs.srv import General, Twist

_CALLS: tuple[tuple[Any, str], ...] = (
    (General, "robot/General"),
    (Twist, "robot/Twist"),
)
"""Services that the bystander calls, by ROS type and name."""


class Bystander:
    """Another client of a flooded agent, whose calls must not be lost.

    Args:
        client: The ROS client that it uses.
        simulator: The chassis of the agent.
        timeout: Time after which an answer counts as lost, in seconds.
    """

    def __init__(self, client: Client, simulator: SimulatorThread, timeout: float) -> None:
        self._client = client
        self._simulator = simulator
        self._timeout = timeout
        self._duplicates = DuplicateAnswers()
        for srv, name in _CALLS:
            self._duplicates.watch(client.service(srv, name))

    def run(self, part: str, until: Callable[[], bool]) -> list[Figure]:
        """Query and stop the robot every 0.1 s, and check that nothing is lost.

        Args:
            part: Part of the benchmark to which the figures belong.
            until: Ends the calls when it returns True.
        """
        asked: list[tuple[str, Any]] = []
        waits: dict[Any, float] = {}
        twists = self._simulator.counts["woosh.robot.Twist"]
        while not until():
            for srv, name in _CALLS:
                begin = time.monotonic()
                future = self._client.call_async(srv, name)
                future.add_done_callback(
                    lambda done, begin=begin: waits.setdefault(done, time.monotonic() - begin)
                )
                asked.append((name, future))
            threading.Event().wait(0.1)
        wait_until(
            lambda: len(waits) == len(asked),  # a future is done before its callbacks run
            f"answers to the bystander during {part}",
            self._timeout,
        )
        stops = [future.result() for name, future in asked if name == "robot/Twist"]
        received = self._simulator.counts["woosh.robot.Twist"] - twists
        return [
            Figure(
                part,
                "calls of a bystander answered, each once",
                f"{len(waits)} of {len(asked)}",
                "all",
                len(waits) == len(asked) and not self._duplicates.found,
            ),
            Figure(
                part,
                "its zero velocities that reached the chassis",
                f"{received} of {len(stops)}",
                "all",
                received == len(stops) and all(stop.ok for stop in stops),
            ),
            Figure(part, "longest wait of the bystander", f"{max(waits.values()):.2f} s"),
        ]
