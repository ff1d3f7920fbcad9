"""With an rclpy that has no EventsExecutor, the agent uses the executor `single`."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import pytest
from rclpy.executors import SingleThreadedExecutor

from tests.harness import Client, Collector, RunningAgent
from tests.node.goals import SUCCEEDED, step
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_msgs.srv import Mode


@pytest.mark.parametrize("chosen", [{}, {"executor": "events"}], ids=["default", "by name"])
def test_single_is_used_instead_with_one_warning(
    simulator: SimulatorThread,
    start_agent: Callable[..., RunningAgent],
    client: Client,
    logs: Collector,
    monkeypatch: pytest.MonkeyPatch,
    chosen: dict[str, Any],
) -> None:
    monkeypatch.setitem(sys.modules, "rclpy.experimental", None)
    agent = start_agent(ip="127.0.0.1", port=simulator.port, **chosen)
    agent.wait_connected()
    assert type(agent.executor) is SingleThreadedExecutor
    assert client.call(Mode, "robot/Mode").info.ctrl.value == 1
    assert step(client, 0.2).result()[0] == SUCCEEDED
    told = [record for record in logs.messages if "EventsExecutor" in record.getMessage()]
    assert [record.levelname for record in told] == ["WARNING"]
    assert "'single'" in told[0].getMessage()


def test_no_warning_if_single_was_chosen(
    start_agent: Callable[..., RunningAgent], logs: Collector, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rclpy.experimental", None)
    agent = start_agent(ip="127.0.0.1", port=1, executor="single")
    assert type(agent.executor) is SingleThreadedExecutor
    assert not [record for record in logs.messages if "Executor" in record.getMessage()]
