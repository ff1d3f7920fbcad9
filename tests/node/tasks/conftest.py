"""A chassis that a test scripts, with an agent and a client that all tests of a file share."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing

import pytest

from tests.harness import RunningAgent, own_domain
from tests.node.tasks.reports import IDLE, ScriptedRobot, empty
from tests.node.tasks.scripted_chassis import MODE, ROBOT_STATE, TASK_PROC, ScriptedChassis
from woosh_robot_agent.ros.actions.goal import GoalTiming


@pytest.fixture(scope="module")
def chassis() -> Iterator[ScriptedChassis]:
    with ScriptedChassis() as running:
        yield running


@pytest.fixture(scope="module")
def domain() -> Iterator[int]:
    with own_domain() as number:
        yield number


@pytest.fixture(scope="module")
def goal_link_timeout() -> float:
    """Time after which a goal without a link is given up, in seconds."""
    return 5.0


@pytest.fixture(scope="module")
def agent(
    chassis: ScriptedChassis, domain: int, goal_link_timeout: float
) -> Iterator[RunningAgent]:
    """An agent that executes all tasks one after the other."""
    running = RunningAgent(
        domain,
        ip="127.0.0.1",
        port=chassis.port,
        goal_link_timeout=goal_link_timeout,
        backoff_min=0.05,
        backoff_max=0.05,
    )
    running.wait_connected()
    yield running
    running.close()


@pytest.fixture(scope="module")
def robot(agent: RunningAgent, chassis: ScriptedChassis) -> Iterator[ScriptedRobot]:
    with closing(ScriptedRobot(agent, chassis)) as running:  # type: ignore[arg-type]
        yield running


@pytest.fixture
def normal(robot: ScriptedRobot) -> None:
    """Poll often, and let the chassis start the test in its normal state."""
    robot.agent.agent.actions.timing = GoalTiming(poll_period=0.1, unknown_state_poll_factor=0.5)
    chassis = robot.chassis
    chassis.refused.clear()
    chassis.push(MODE, {"ctrl": 1, "work": 2})
    chassis.push(ROBOT_STATE, IDLE)
    chassis.push(TASK_PROC, empty())
