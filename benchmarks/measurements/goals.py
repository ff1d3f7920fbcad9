"""Goals: of robot/ExecTask through the agent and the floor, and of MoveBase and Nav2's action."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from typing import Any

from action_msgs.msg import GoalStatus
from nav2_msgs.action import NavigateToPose
from rclpy.action import ActionClient

from benchmarks.figures import Measured, Spread, Target, no_garbage_collection
from benchmarks.measurements.bare_client import BareClient
from benchmarks.options import Options
from benchmarks.processes import FLOOR, Program, running_agent, running_chassis, running_floor
from woosh_robot_agent.testing import wait_until
from woosh_robot_agent.testing.agents import NAMESPACE
from woosh_robot_msgs.action import ExecTask
from woosh_ros_msgs.action import MoveBase

FIGURES = {
    "goal_rtt": Target(
        2.0, 1.5, "goal to the chassis, and last report to the result / bare action server"
    ),
}
NAV2_FIGURES = {
    "nav2_goal_rtt": Target(1.3, 1.15, "the same of navigate_to_pose / that of ros/MoveBase"),
}
_GOALS = 100
_TIMEOUT = 30.0
"""Timeout for each step of a goal, in seconds."""
_FIRST_TASK = 1_700_000_000_000
"""Id of the first task. Clients use the Unix time, in milliseconds."""
_FIRST_OWN = 10_000
"""Number of the first goal of MoveBase; it is the x of its pose."""


class GoalSender:
    """An action client that sends goals one after the other, and records their times.

    Args:
        client: node of the action client.
        action: type of the action.
        name: name of the action server.
        chassis: executes the goals.
        make_goal: makes a goal by which the chassis recognises a number.
        first: number of the first goal.
    """

    def __init__(
        self,
        client: BareClient,
        action: Any,
        name: str,
        chassis: Program,
        make_goal: Callable[[int], Any],
        first: int,
    ) -> None:
        self._spin_until = client.spin_until
        self._client = ActionClient(client.node, action, name)
        self._chassis = chassis
        self._make_goal = make_goal
        self._number = first
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
            # the agent refuses goals for a moment after its process stood still
            sent = [
                wait_until(lambda: self._send(_TIMEOUT), "a goal to succeed", _TIMEOUT)
                for _ in range(count)
            ]
        times = self._times()
        for number, begun, ended in sent:
            arrived, reported = times[str(number)]
            self._starts.append(arrived - begun)
            self._ends.append(ended - reported)

    def _send(self, timeout: float) -> tuple[int, float, float] | None:
        """Send a goal.

        Returns:
            The number of the goal, its time and that of its result; None if it did not succeed
            within `timeout` seconds for each step.
        """
        self._number += 1
        goal = self._make_goal(self._number)
        begun = time.monotonic()
        accepted = self._client.send_goal_async(goal, feedback_callback=lambda _feedback: None)
        if not self._spin_until(accepted.done, timeout):
            return None
        if not accepted.result().accepted:
            return None
        result = accepted.result().get_result_async()
        if not self._spin_until(result.done, timeout):
            return None
        if result.result().status != GoalStatus.STATUS_SUCCEEDED:
            return None
        return self._number, begun, time.monotonic()

    def _times(self) -> dict[str, list[float]]:
        """Return when each goal came to the chassis, and when it last reported, by its number."""
        self._chassis.send("goals")
        times: dict[str, list[float]] = self._chassis.receive()
        return times

    @property
    def total(self) -> float:
        """Sum of the medians of start and end, in microseconds."""
        return self.start.median + self.end.median

    @property
    def start(self) -> Spread:
        """Time from sending a goal to its first frame at the chassis."""
        return Spread.of(self._starts)

    @property
    def end(self) -> Spread:
        """Time from the last report of the chassis to the result."""
        return Spread.of(self._ends)


def measure(domain: int, options: Options) -> Measured:
    """Measure tasks of agent and floor in turn."""
    with (
        contextlib.closing(BareClient(domain)) as client,
        running_chassis(domain) as (chassis, port),
        running_agent(domain, port, options),
        running_floor("goal", domain, port),
    ):

        def sender(namespace: str) -> GoalSender:
            name = f"{namespace}/robot/ExecTask"
            return GoalSender(client, ExecTask, name, chassis, _task, _FIRST_TASK)

        return {"goal_rtt": _compare(sender(NAMESPACE), sender(FLOOR), options)}


def measure_nav2(domain: int, options: Options) -> Measured:
    """Measure goals of Nav2's action and of the agent's own one in turn."""
    with (
        contextlib.closing(BareClient(domain)) as client,
        running_chassis(domain) as (chassis, port),
        running_agent(domain, port, options, nav2="true"),
    ):
        nav2 = GoalSender(
            client, NavigateToPose, f"{NAMESPACE}/navigate_to_pose", chassis, _nav2_goal, 0
        )
        own = GoalSender(
            client, MoveBase, f"{NAMESPACE}/ros/MoveBase", chassis, _move_base, _FIRST_OWN
        )
        return {"nav2_goal_rtt": _compare(nav2, own, options)}


def _compare(ours: GoalSender, floor: GoalSender, options: Options) -> tuple[float, str]:
    """Measure two senders in turn; return the ratio of their totals, and the times as text."""
    for sender in (ours, floor):
        sender.warm_up()
    for _ in range(options.turns):
        for sender in (ours, floor):
            sender.send(options.samples(_GOALS // options.turns))
    text = f"({ours.start} + {ours.end}) / ({floor.start} + {floor.end}) µs"
    return ours.total / floor.total, text


def _task(number: int) -> Any:
    goal: Any = ExecTask.Goal()
    goal.arg.task_id = number
    return goal


def _move_base(number: int) -> Any:
    goal: Any = MoveBase.Goal()
    goal.arg.action.value = 1
    goal.arg.target_pose.x = float(number)
    return goal


def _nav2_goal(number: int) -> Any:
    goal: Any = NavigateToPose.Goal()
    goal.pose.header.frame_id = "map"
    goal.pose.pose.position.x = float(number)
    return goal
