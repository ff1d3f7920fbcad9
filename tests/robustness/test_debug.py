"""The debug state of an agent shows what is in flight."""

from __future__ import annotations

from tests.harness import Client, RunningAgent
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.testing import wait_until
from woosh_robot_msgs.srv import Speak


def test_requests_in_flight_are_shown_until_they_are_answered(
    simulator: SimulatorThread, agent: RunningAgent, client: Client
) -> None:
    client.service(Speak, "robot/Speak")
    slow = simulator.inject("freeze")
    answer = client.call_async(Speak, "robot/Speak")
    state = wait_until(lambda: (s := agent.agent.debug())["requests"] and s, "the request")
    assert state["state"] == "ready"
    slow.clear()
    wait_until(answer.done, "the answer")
    wait_until(lambda: not agent.agent.debug()["requests"], "no request in flight")
