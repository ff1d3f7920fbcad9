"""Goals of tasks and actions alike; the usual course is in test_actions_{tasks,calls}.py."""

from __future__ import annotations

import pytest

from tests.harness import GoalClient, Robot
from tests.node.goals import (
    SUCCEEDED,
    TASK,
    Kind,
    each_kind,
    hurry,
    slow_down,
    step,
    step_goal,
    task,
    until,
)
from woosh_robot_agent.ros.actions.run import REPLACED
from woosh_robot_agent.simulator.serving.exchange import Outgoing
from woosh_ros_msgs.action import StepControl


@pytest.fixture
def robot(shared_robot: Robot) -> Robot:
    """A client of the agent that the tests of this file share, and its new chassis."""
    return shared_robot


def short(robot: Robot, kind: Kind) -> GoalClient:
    return task(robot, mark="U5") if kind is TASK else step(robot, 0.4)


@each_kind
def test_newer_goal_replaces_an_older_one(robot: Robot, kind: Kind) -> None:
    slow_down(robot.chassis)
    old = kind.running(robot)
    new = short(robot, kind)
    assert old.wait_aborted().msg == REPLACED
    hurry(robot.chassis)
    assert new.result()[0] == SUCCEEDED
    assert -2 not in [fb.state.value for fb in new.feedback.messages]
    assert robot.chassis.counts["woosh.robot.ActionOrder"] == 0


@each_kind
def test_refused_newer_goal_does_not_replace_the_older_one(robot: Robot, kind: Kind) -> None:
    slow_down(robot.chassis)
    old = until(task(robot) if kind is TASK else step(robot, 5.0), kind.runs)
    if kind is TASK:
        refused, reason = task(robot, mark="nowhere"), "nowhere"
    else:
        goal = step_goal(1.0)
        goal.arg.steps[0].mode.value = 9
        refused, reason = robot.send_goal(StepControl, "ros/StepControl", goal), "mode"
    refused.wait_aborted(reason)
    hurry(robot.chassis)
    assert old.result()[0] == SUCCEEDED


@each_kind
def test_lost_end_is_found_by_polling(robot: Robot, kind: Kind) -> None:
    """Also that of a second goal, which ends with exactly the same report."""

    def without_the_end(out: Outgoing) -> list[Outgoing]:
        if out.type != kind.polls or out.sn:
            return [out]
        state = out.body.state if kind is TASK else out.body.fbs[0].state  # type: ignore[union-attr]
        return [] if state == kind.done else [out]

    robot.set_goal_timing(poll_period=0.3)
    robot.chassis.intercept(without_the_end)
    for _ in range(2):
        assert short(robot, kind).result()[0] == SUCCEEDED
