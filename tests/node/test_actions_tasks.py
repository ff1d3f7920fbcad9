"""robot/ExecTask and robot/ExecPreTask, and what holds for all goals."""

from __future__ import annotations

import time

import pytest

from tests.harness import GoalClient, Robot, wait_until
from tests.node.goals import (
    ACTION,
    ACTION_ORDER,
    CANCELED,
    COMPLETED,
    EXEC_TASK,
    EXECUTING,
    SUCCEEDED,
    TASK,
    TASK_PROC,
    Kind,
    each_kind,
    hurry,
    pause_task,
    short_task,
    slow_down,
    step,
    step_goal,
    task,
    task_set,
    until,
)
from woosh_robot_agent.motion.wheel_owner import is_unfinished
from woosh_robot_agent.pb.robot.robot_pb2 import TaskProc
from woosh_robot_agent.ros.actions.run import REPLACED
from woosh_robot_agent.simulator.serving.exchange import Outgoing
from woosh_ros_msgs.action import StepControl


@pytest.fixture
def robot(shared_robot: Robot) -> Robot:
    """A client of the agent that the tests of this file share, and its new chassis."""
    return shared_robot


def test_task_id_is_the_clients_or_a_new_one(robot: Robot) -> None:
    assert short_task(robot, 0.05, task_id=77).result()[1].robot_task_id == 77
    ids = [short_task(robot, x).result()[1].robot_task_id for x in (0.1, 0.2, 0.3)]
    assert len(set(ids)) == 3
    assert [each.message.task_id for each in robot.chassis.received if each.type == EXEC_TASK] == [
        77,
        *ids,
    ]


def test_newer_task_with_the_same_id_replaces_the_older_one(robot: Robot) -> None:
    slow_down(robot.chassis)
    old = task(robot, task_id=9)
    old.feedback.wait(lambda fb: fb.state.value == EXECUTING)
    new = task(robot, mark="U5", task_id=9)
    assert old.wait_aborted().msg == REPLACED
    hurry(robot.chassis)
    status, ret = new.result()
    assert (status, ret.dest) == (SUCCEEDED, "U5")


def test_paused_task_is_polled_at_the_poll_period(robot: Robot) -> None:
    robot.set_goal_timing(poll_period=0.2)
    slow_down(robot.chassis)
    goal = task(robot)
    goal.feedback.wait(lambda fb: fb.state.value == EXECUTING)
    pause_task(robot.chassis)
    begun = time.monotonic()
    asked = robot.chassis.counts[TASK_PROC]
    wait_until(lambda: robot.chassis.counts[TASK_PROC] >= asked + 4)
    assert time.monotonic() - begun > 0.5
    paused = [fb for fb in goal.feedback.messages if fb.state.value == 4]
    assert len(paused) == 1, "a repeated report is no feedback"
    goal.cancel()
    assert goal.result()[0] == CANCELED


# Tasks and actions alike


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


def test_refused_newer_action_does_not_replace_the_older_one(robot: Robot) -> None:
    """tasks/test_special_cases.py has the same for tasks."""
    slow_down(robot.chassis)
    old = until(step(robot, 5.0), ACTION.runs)
    goal = step_goal(1.0)
    goal.arg.steps[0].mode.value = 9
    robot.send_goal(StepControl, "ros/StepControl", goal).wait_aborted("mode")
    hurry(robot.chassis)
    assert old.result()[0] == SUCCEEDED


@each_kind
def test_lost_end_is_found_by_polling(robot: Robot, kind: Kind) -> None:
    """Also that of a second goal, which ends with exactly the same report.

    The rest of the agent learns of it, too, so that e.g. cmd_vel is not refused any more.
    """

    def without_the_end(out: Outgoing) -> list[Outgoing]:
        if out.type != kind.polls or out.sn:
            return [out]
        if isinstance(out.body, TaskProc):
            return [out] if is_unfinished(out.body) else []
        return [] if out.body.fbs[0].state == kind.done else [out]  # type: ignore[union-attr]

    robot.set_goal_timing(poll_period=0.3)
    robot.chassis.intercept(without_the_end)
    for _ in range(2):
        assert short(robot, kind).result()[0] == SUCCEEDED
        assert not robot.gate.wheel_owner.name
        last = robot.agent.agent.robot.last_known.value(TaskProc)
        assert last is not None
        assert not is_unfinished(last)


# Sets of tasks; tasks/test_task_sets.py has the rules


@pytest.mark.parametrize(
    ("number", "tasks"), [(666, [66601, 66602]), (1735291765, [173529176501] * 2)]
)
def test_a_set_runs_to_its_end(robot: Robot, number: int, tasks: list[int]) -> None:
    """The second set is one task, twice."""
    goal = task_set(robot, number)
    status, ret = goal.result()
    assert (status, ret.robot_task_id, ret.state.value) == (SUCCEEDED, tasks[-1], COMPLETED)
    ended = [fb for fb in goal.feedback.messages if fb.state.value == COMPLETED]
    assert [fb.robot_task_id for fb in ended] == tasks


@pytest.mark.parametrize("newer", ["a task", "a set"])
def test_a_newer_goal_replaces_an_older_one_of_the_other_kind(robot: Robot, newer: str) -> None:
    slow_down(robot.chassis)
    older = task_set(robot, 666) if newer == "a task" else task(robot, "A2")
    older.feedback.wait(lambda fb: fb.state.value == EXECUTING)
    goal = task(robot, "A2") if newer == "a task" else task_set(robot, 666)
    assert older.wait_aborted().msg == REPLACED
    hurry(robot.chassis)
    assert goal.result()[0] == SUCCEEDED
    assert not robot.chassis.counts[ACTION_ORDER], "a cancel would hit the newer goal"
    wait_until(lambda: not robot.agent.agent.debug()["running_goals"], "the end of all goals")
