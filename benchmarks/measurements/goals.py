"""Goals of robot/ExecTask through the agent and through the floor."""

from __future__ import annotations

import contextlib
import time
from typing import Any

from rclpy.action import ActionClient

from benchmarks.figures import Measured, Spread, Target, no_garbage_collection
from benchmarks.measurements.bare_client import BareClient
from benchmarks.options import Options
from benchmarks.processes import FLOOR, Program, running_agent, running_chassis, running_floor
from woosh_robot_agent.testing import wait_until
from woosh_robot_agent.testing.agents import NAMESPACE
from woosh_robot_msgs.action import ExecTask

FIGURES = {
    "goal_rtt": Target(
        2.0, 1.5, "goal to the chassis, and last report to the result / bare action server"
    ),
}
_GOALS = 100
_TIMEOUT = 30.0
"""Timeout for each step of a goal, in seconds."""
_FIRST_TASK = 1_700_000_000_000
"""Id of the first task. Clients use the Unix time, in milliseconds."""


class GoalSender:
    """An action client that sends goals one after the other, and records their times.

    Args:
        client: Node of the action client.
        namespace: Namespace of the action server.
        chassis: Executes the tasks.
    """

    def __init__(self, client: BareClient, namespace: str, chassis: Program) -> None:
        self._spin_until = client.spin_until
        self._client = ActionClient(client.node, ExecTask, f"{namespace}/robot/ExecTask")
        self._chassis = chassis
        self._next_task = _FIRST_TASK
        self._starts: list[float] = []
        self._ends: list[float] = []

    def warm_up(self) -> None:
        """Send goals until one has succeeded, and forget them."""
        wait_until(self._client.server_is_ready, "the action", _TIMEOUT)
        # a server that is ready may not have discovered this client yet
        wait_until(lambda: self._send(1.0) is not None, "the first result", _TIMEOUT)
        self._times()

    def send(self, count: int) -> None:
        """Send goals, and record the time of their starts and ends."""
        with no_garbage_collection():
            sent = [self._send(_TIMEOUT) for _ in range(count)]
        times = self._times()
        for goal in sent:
            assert goal is not None, "a goal did not end"
            task_id, begun, ended = goal
            arrived, reported = times[str(task_id)]
            self._starts.append(arrived - begun)
            self._ends.append(ended - reported)

    def _send(self, timeout: float) -> tuple[int, float, float] | None:
        """Send a goal; return its task, its time and that of its result; None after a timeout."""
        self._next_task += 1
        goal: Any = ExecTask.Goal()
        goal.arg.task_id = self._next_task
        begun = time.monotonic()
        accepted = self._client.send_goal_async(goal, feedback_callback=lambda _feedback: None)
        if not self._spin_until(accepted.done, timeout):
            return None
        result = accepted.result().get_result_async()
        if not self._spin_until(result.done, timeout):
            return None
        return self._next_task, begun, time.monotonic()

    def _times(self) -> dict[str, list[float]]:
        """Return when each task came to the chassis, and when it last reported, by task."""
        self._chassis.send("tasks")
        times: dict[str, list[float]] = self._chassis.receive()
        return times

    @property
    def start(self) -> Spread:
        """Time from sending a goal to its first frame at the chassis."""
        return Spread.of(self._starts)

    @property
    def end(self) -> Spread:
        """Time from the last report of the chassis to the result."""
        return Spread.of(self._ends)


def measure(domain: int, options: Options) -> Measured:
    """Measure goals of agent and floor in turn."""
    with (
        contextlib.closing(BareClient(domain)) as client,
        running_chassis(domain) as (chassis, port),
        running_agent(domain, port, options),
        running_floor("goal", domain, port),
    ):
        ours = GoalSender(client, NAMESPACE, chassis)
        floor = GoalSender(client, FLOOR, chassis)
        for sender in (ours, floor):
            sender.warm_up()
        for _ in range(options.turns):
            for sender in (ours, floor):
                sender.send(options.samples(_GOALS // options.turns))
    total, floor_total = (each.start.median + each.end.median for each in (ours, floor))
    return {
        "goal_rtt": (
            total / floor_total,
            f"({ours.start} + {ours.end}) / ({floor.start} + {floor.end}) µs",
        )
    }
