"""Goals and their clients, which may be late or vanish; an agent that stops."""

from __future__ import annotations

from typing import Any

import pytest

from tests.harness import TIMEOUT, Client, Logs, Robot, wait_future, wait_until
from tests.node.goals import CALL_ACTION, SUCCEEDED, step
from woosh_robot_agent.ros.actions import server
from woosh_robot_agent.ros.actions.run import STOPPING
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_msgs.srv import Mode


@pytest.fixture(scope="module")
def shared_parameters() -> dict[str, Any]:
    return {"result_timeout": 3}


@pytest.fixture
def client(shared_robot: Robot) -> Robot:
    """A client of the agent that the tests of this file share."""
    return shared_robot


def test_result_is_kept_for_late_clients_until_the_timeout(client: Robot) -> None:
    goal = step(client, 0.2)
    assert goal.result()[0] == SUCCEEDED

    def ask_again() -> int:
        return int(wait_future(goal.ask_result()).status)

    assert ask_again() == SUCCEEDED
    wait_until(lambda: ask_again() == 0, "the result to expire")
    assert step(client, 0.2).result()[0] == SUCCEEDED


def test_only_the_last_results_are_kept(client: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each status message lists all goals that are kept, so a flood of goals would take longer."""
    monkeypatch.setattr(server, "_MAX_RESULTS", 1)
    first = step(client, 0.2)
    assert first.result()[0] == SUCCEEDED
    second = step(client, 0.2)
    assert second.result()[0] == SUCCEEDED
    assert wait_future(first.ask_result()).status == 0
    assert wait_future(second.ask_result()).status == SUCCEEDED


def test_other_clients_are_served_after_one_vanishes(
    client: Robot, simulator: SimulatorThread, logs: Logs
) -> None:
    """Clients leave while goals are running and responses are pending."""
    simulator.delay("woosh.robot.Mode", 0.2)
    gone = Client(client.agent.domain)
    step(gone, 3.0)
    gone.call_async(Mode, "robot/Mode")
    gone.close()
    status, ret = step(client, 0.2).result()
    assert status == SUCCEEDED, ret
    assert client.call(Mode, "robot/Mode").info.ctrl.value == 1
    assert not [record for record in logs.messages if record.levelname == "ERROR"]


def test_goal_during_shutdown_is_aborted(robot: Robot) -> None:
    robot.agent.agent.robot.thread.run(robot.agent.agent.actions.stop(), TIMEOUT)
    assert step(robot, 0.2).wait_aborted().msg == STOPPING
    assert robot.chassis.counts[CALL_ACTION] == 0
