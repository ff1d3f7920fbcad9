"""Goals of robot/ExecTask through the agent and through the floor."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from typing import Any

from rclpy.action import ActionClient

from benchmarks.measurements.bare_client import BareClient
from benchmarks.measurements.samples import Measured, Spread, no_garbage_collection
from benchmarks.options import Options
from benchmarks.processes import Program, running
from benchmarks.programs.start import agent, chassis_running
from woosh_robot_agent.testing import own_domain, wait_until
from woosh_robot_agent.testing.agents import NAMESPACE
from woosh_robot_msgs.action import ExecTask

_GOALS = 100
_TIMEOUT = 30.0
"""Timeout for each step of a goal, in seconds."""
_FIRST_TASK = 1_700_000_000_000
"""Id of the first task. Clients use the Unix time, in milliseconds."""


class GoalSender(BareClient):
    """An action client that sends goals one after the other, and records their times.

    Args:
        domain: ROS_DOMAIN_ID.
        chassis: Executes the tasks.
    """

    def __init__(self, domain: int, chassis: Program) -> None:
        super().__init__(domain)
        self._chassis = chassis
        self._client = ActionClient(self.node, ExecTask, f"{NAMESPACE}/robot/ExecTask")
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
        if None in sent:
            raise AssertionError("a goal did not end")
        for (begun, ended), (arrived, reported) in zip(sent, self._times(), strict=True):
            self._starts.append(arrived - begun)
            self._ends.append(ended - reported)

    def _send(self, timeout: float) -> tuple[float, float] | None:
        """Send a goal; return the times of the goal and of its result, None after a timeout."""
        self._next_task += 1
        goal: Any = ExecTask.Goal()
        goal.arg.task_id = self._next_task
        begun = time.monotonic()
        accepted = self._client.send_goal_async(goal, feedback_callback=lambda _feedback: None)
        if not self.spin_until(accepted.done, timeout):
            return None
        result = accepted.result().get_result_async()
        if not self.spin_until(result.done, timeout):
            return None
        return begun, time.monotonic()

    def _times(self) -> list[list[float]]:
        """Return when each task reached the chassis, and when the chassis last reported on it."""
        self._chassis.send("times")
        times: list[list[float]] = self._chassis.receive()
        return times

    @property
    def start(self) -> Spread:
        """Time from sending a goal to its first frame at the chassis."""
        return Spread.of(self._starts)

    @property
    def end(self) -> Spread:
        """Time from the last report of the chassis to the result."""
        return Spread.of(self._ends)

    def close(self) -> None:
        self._client.destroy()
        super().close()


@contextlib.contextmanager
def _sending(domain: int, options: Options, *, floor: bool = False) -> Iterator[GoalSender]:
    """Provide a warmed-up sender of goals to the agent or the floor."""
    transport = "websocket" if floor else options.transport
    with chassis_running("task_chassis", domain, transport) as (chassis, port):
        sender = GoalSender(domain, chassis)
        with (
            contextlib.closing(sender),
            running("benchmarks.floors.goal", f"ws://127.0.0.1:{port}", domain=domain)
            if floor
            else agent(domain, port, options),
        ):
            sender.warm_up()
            yield sender


def measure(domain: int, options: Options) -> Measured:
    """Measure goals of agent and floor in turn."""
    with (
        own_domain() as floor_domain,
        _sending(domain, options) as ours,
        _sending(floor_domain, options, floor=True) as floor,
    ):
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
