"""The calls of Open-RMF's free_fleet in their order: its adapter for robots with Nav2.

The adapter sends requests of the action's services itself, without an action client.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
from action_msgs.msg import GoalInfo, GoalStatus
from action_msgs.srv import CancelGoal
from sensor_msgs.msg import BatteryState
from unique_identifier_msgs.msg import UUID

from tests.harness import Client, Collector, RunningAgent, wait_future
from tests.node.goals import START, hurry, slow_down
from tests.node.nav2.goals import ahead
from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.simulator import SimulatorThread

nav2_actions = pytest.importorskip("nav2_msgs.action")
parts = nav2_actions.NavigateToPose.Impl


class Adapter:
    """The adapter of one robot."""

    def __init__(self, client: Client) -> None:
        self.feedback = Collector()
        self._client = client
        client.action(nav2_actions.NavigateToPose, "navigate_to_pose")  # until it is discovered
        client.node.create_subscription(
            parts.FeedbackMessage,
            client.path("navigate_to_pose/_action/feedback"),
            self.feedback.add,
            10,
        )

    def navigate(self, number: int, distance: float) -> UUID:
        goal_id = UUID(uuid=[number] * 16)
        request = parts.SendGoalService.Request(goal_id=goal_id)
        request.goal.pose = ahead(distance)
        assert wait_future(self._call(parts.SendGoalService, "send_goal", request)).accepted
        return goal_id

    def ask_result(self, goal_id: UUID) -> Any:
        """Ask for the result; return the future of the response."""
        request = parts.GetResultService.Request(goal_id=goal_id)
        return self._call(parts.GetResultService, "get_result", request)

    def cancel_all(self) -> Any:
        return wait_future(
            self._call(CancelGoal, "cancel_goal", CancelGoal.Request(goal_info=GoalInfo()))
        )

    def _call(self, srv: Any, verb: str, request: Any) -> Any:
        name = f"navigate_to_pose/_action/{verb}"
        return self._client.service(srv, name).call_async(request)


def test_the_calls_of_the_adapter(
    client: Client, simulator: SimulatorThread, start_agent: Callable[..., RunningAgent]
) -> None:
    agent = start_agent(ip="127.0.0.1", port=simulator.port, nav2=True, publish_tf=True)
    agent.wait_connected()
    slow_down(simulator)
    transforms = client.echo_with(class_of("tf2_msgs/TFMessage"), "/tf", 10)
    to_odom, to_base = transforms.wait(lambda each: len(each.transforms) == 2).transforms
    assert (to_odom.header.frame_id, to_base.child_frame_id) == ("map", "base_link")
    x = to_odom.transform.translation.x + to_base.transform.translation.x
    assert x == pytest.approx(START[0], abs=0.05)
    for _ in range(2):  # the second one comes later, and asks for no earlier message
        battery = client.echo_with(BatteryState, "battery_state", 10).wait(lambda _: True)
        assert 0.0 < battery.percentage <= 1.0

    adapter = Adapter(client)
    first = adapter.navigate(1, 5.0)
    report = adapter.feedback.wait(lambda each: each.goal_id == first)
    assert report.feedback.estimated_time_remaining.sec >= 3
    pending = adapter.ask_result(first)  # of a goal that runs: answered at its end
    # a new destination: the adapter cancels all goals, and sends the next one at once
    assert adapter.cancel_all().goals_canceling
    second = adapter.navigate(2, 1.0)
    ended = (GoalStatus.STATUS_CANCELED, GoalStatus.STATUS_ABORTED)
    assert wait_future(pending).status in ended
    adapter.feedback.wait(
        lambda each: each.goal_id == second and each.feedback.estimated_time_remaining.sec < 1
    )
    hurry(simulator)
    assert wait_future(adapter.ask_result(second)).status == GoalStatus.STATUS_SUCCEEDED
    here = simulator.state.pose
    assert math.dist((here.x, here.y), START[:2]) == pytest.approx(1.0, abs=0.02)
    # the result is kept, and a cancel of nothing is no error
    assert wait_future(adapter.ask_result(second)).status == GoalStatus.STATUS_SUCCEEDED
    assert adapter.cancel_all().return_code == CancelGoal.Response.ERROR_NONE
