"""robot/ExecPreTask as an action on the simulated robot; tasks/test_task_sets.py has the rules."""

from __future__ import annotations

import pytest

from tests.harness import Client, GoalClient, RunningAgent, wait_until
from tests.node.goals import (
    ABORTED,
    ACTION_ORDER,
    CANCELED,
    COMPLETED,
    EXECUTING,
    SUCCEEDED,
    TASK_CANCELED,
    hurry,
    slow_down,
    task,
)
from woosh_robot_agent.ros.actions.run import REPLACED
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_msgs.action import ExecPreTask

TASK_SETS = "robot/ExecPreTask"


def send(client: Client, number: int) -> GoalClient:
    goal = ExecPreTask.Goal()
    goal.arg.task_set_id = number
    return client.send_goal(ExecPreTask, TASK_SETS, goal)


def test_a_set_runs_to_its_end(agent: RunningAgent, client: Client) -> None:
    goal = send(client, 666)
    status, ret = goal.result()
    assert (status, ret.robot_task_id, ret.state.value) == (SUCCEEDED, 66602, COMPLETED)
    ids = [fb.robot_task_id for fb in goal.feedback.messages]
    assert ids == sorted(ids)
    assert set(ids) == {66601, 66602}


def test_a_repeated_set_ends_with_its_last_repetition(agent: RunningAgent, client: Client) -> None:
    goal = send(client, 1735291765)  # one task, twice
    assert goal.result()[0] == SUCCEEDED
    ends = [fb for fb in goal.feedback.messages if fb.state.value == COMPLETED]
    assert len(ends) == 2


def test_an_unknown_set_is_refused(agent: RunningAgent, client: Client) -> None:
    status, ret = send(client, 7).result()
    assert (status, "unknown task set 7" in ret.msg) == (ABORTED, True)


def test_cancel_ends_the_set(
    agent: RunningAgent, client: Client, simulator: SimulatorThread
) -> None:
    slow_down(simulator)
    goal = send(client, 666)
    goal.feedback.wait(lambda fb: fb.state.value == EXECUTING)
    goal.cancel()
    status, ret = goal.result()
    assert (status, ret.robot_task_id, ret.state.value) == (CANCELED, 66601, TASK_CANCELED)
    assert simulator.state.info.task_proc.state == TASK_CANCELED


@pytest.mark.parametrize("newer", ["a task", "a set"])
def test_a_newer_goal_replaces_an_older_one_of_the_other_kind(
    agent: RunningAgent, client: Client, simulator: SimulatorThread, newer: str
) -> None:
    slow_down(simulator)
    older = send(client, 666) if newer == "a task" else task(client, "A2")
    older.feedback.wait(lambda fb: fb.state.value == EXECUTING)
    goal = task(client, "A2") if newer == "a task" else send(client, 666)
    status, ret = older.result()
    assert (status, ret.msg) == (ABORTED, REPLACED)
    hurry(simulator)
    assert goal.result()[0] == SUCCEEDED
    assert not simulator.counts[ACTION_ORDER], "a cancel would hit the newer goal"
    wait_until(lambda: not agent.agent._actions.running_goals, "the end of all goals")
