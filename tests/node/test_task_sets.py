"""robot/ExecPreTask as an action: it ends when the last task of the set does.

The chassis reports on the tasks only, never on the set. Between two tasks it sends an empty report,
and its state is idle for some milliseconds, as at the end of the set.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.harness import Client, GoalClient, RunningAgent, own_domain, wait_until
from tests.node.goals import (
    ABORTED,
    ACTION_ORDER,
    CANCELED,
    COMPLETED,
    EXECUTING,
    FAILED,
    SUCCEEDED,
    TASK_CANCELED,
    hurry,
    set_timing,
    slow_down,
    task,
)
from tests.node.scripted_chassis import (
    ROBOT_STATE,
    TASK_HISTORY,
    TASK_PROC,
    Body,
    ScriptedChassis,
)
from tests.node.test_real_tasks import (
    EXEC_PRE_TASK,
    SETS,
    TASKS,
    reports,
    script,
    wire,
)
from woosh_robot_agent.actions.run import REPLACED
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_msgs.action import ExecPreTask

IDLE, TASK = {"state": 2}, {"state": 4}
EMPTY: Body = {"action": {}, "time": 1719991764}
SET = 1719959961


def proc(task_id: int, state: int, time: int = 1719991764) -> Body:
    """Return a report on a task of the set."""
    return {"robotTaskId": str(SET * 100 + task_id), "type": 1, "state": state, "time": time}


@pytest.fixture(scope="module")
def chassis() -> Iterator[ScriptedChassis]:
    with ScriptedChassis() as running:
        yield running


@pytest.fixture(scope="module")
def robot(chassis: ScriptedChassis) -> Iterator[RunningAgent]:
    """An agent that executes all sets on the scripted chassis, one after the other."""
    with own_domain() as domain:
        running = RunningAgent(
            domain,
            ip="127.0.0.1",
            port=chassis.port,
            goal_link_timeout=5.0,
            backoff_min=0.05,
            backoff_max=0.05,
        )
        running.wait_connected()
        yield running
        running.close()


@pytest.fixture(scope="module")
def user(robot: RunningAgent) -> Iterator[Client]:
    """A ROS client of that agent."""
    running = Client(robot.domain)
    yield running
    running.close()


@pytest.fixture
def normal(chassis: ScriptedChassis, monkeypatch: pytest.MonkeyPatch) -> None:
    """Poll often, and let the chassis start in its normal state."""
    set_timing(monkeypatch, poll_period=0.1, in_doubt_poll_factor=1.0)
    chassis.refused.clear()
    chassis.forget_history()
    chassis.push(ROBOT_STATE, IDLE)
    chassis.push(TASK_PROC, EMPTY)


def send(client: Client, number: int = SET) -> GoalClient:
    goal = ExecPreTask.Goal()
    goal.arg.task_set_id = number
    return client.send_goal(ExecPreTask, "robot/ExecPreTask", goal)


def started(chassis: ScriptedChassis, client: Client) -> GoalClient:
    """Start the set; its first task is running."""
    asked = chassis.count(EXEC_PRE_TASK)
    chassis.expect(EXEC_PRE_TASK, chassis.answer)
    goal = send(client)
    assert chassis.wait_request(EXEC_PRE_TASK, asked + 1)["taskSetId"] == SET
    chassis.push(ROBOT_STATE, TASK)
    chassis.push(TASK_PROC, proc(1, EXECUTING))
    goal.feedback.wait_count(1)
    return goal


def end_task(chassis: ScriptedChassis, task_id: int, state: int = COMPLETED) -> None:
    """End a task of the set as real robots do."""
    chassis.push(TASK_PROC, proc(task_id, state))
    chassis.push(TASK_PROC, EMPTY)
    chassis.push(ROBOT_STATE, IDLE)


def wait_polls(chassis: ScriptedChassis, count: int = 3) -> None:
    chassis.wait_request(TASK_PROC, chassis.count(TASK_PROC) + count)


def fed_back(goal: GoalClient) -> list[tuple[int, int]]:
    return [(fb.robot_task_id % 100, fb.state.value) for fb in goal.feedback.messages]


# A robot that behaves as real ones do


@pytest.mark.usefixtures("normal")
@pytest.mark.parametrize(
    ("first", "last", "status"),
    [
        (COMPLETED, COMPLETED, SUCCEEDED),
        (COMPLETED, FAILED, ABORTED),
        (COMPLETED, TASK_CANCELED, ABORTED),
        (TASK_CANCELED, COMPLETED, SUCCEEDED),
    ],
)
def test_a_set_ends_as_its_last_task_does(
    chassis: ScriptedChassis, user: Client, first: int, last: int, status: int
) -> None:
    goal = started(chassis, user)
    end_task(chassis, 1, first)
    chassis.push(ROBOT_STATE, TASK)
    wait_polls(chassis)
    assert not goal.done, "the next task begins only about a second later"
    chassis.push(TASK_PROC, proc(2, EXECUTING))
    goal.feedback.wait_count(3)
    end_task(chassis, 2, last)
    ended, ret = goal.result()
    assert (ended, ret.robot_task_id, ret.state.value) == (status, SET * 100 + 2, last)
    assert fed_back(goal) == [(1, EXECUTING), (1, first), (2, EXECUTING), (2, last)]


@pytest.mark.usefixtures("normal")
def test_a_set_of_the_same_tasks_again_does_not_end_as_the_time_before(
    chassis: ScriptedChassis, user: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    goal = started(chassis, user)
    end_task(chassis, 1)
    assert goal.result()[0] == SUCCEEDED
    set_timing(monkeypatch, first_report_timeout=0.3, poll_period=0.1)
    chassis.expect(EXEC_PRE_TASK, chassis.answer)
    status, ret = send(user).result()
    assert (status, "does not execute the task set any more" in ret.msg) == (ABORTED, True)


@pytest.mark.usefixtures("normal")
def test_a_refusal_reaches_the_client(chassis: ScriptedChassis, user: Client) -> None:
    chassis.expect(EXEC_PRE_TASK, lambda: chassis.answer(False, "Request failed"))
    status, ret = send(user).result()
    assert (status, ret.state.value) == (ABORTED, FAILED)
    assert ret.msg.startswith("Request failed")


@pytest.mark.usefixtures("normal")
def test_a_cancel_is_repeated_until_the_whole_set_has_ended(
    chassis: ScriptedChassis, user: Client
) -> None:
    """A real robot went on with the third task when the second one was cancelled."""
    orders = chassis.count(ACTION_ORDER)
    goal = started(chassis, user)
    goal.cancel()
    chassis.wait_request(ACTION_ORDER, orders + 1)
    end_task(chassis, 1, TASK_CANCELED)
    chassis.push(ROBOT_STATE, TASK)
    wait_polls(chassis)
    assert chassis.count(ACTION_ORDER) == orders + 1, "no task is running that it could end"
    chassis.push(TASK_PROC, proc(2, EXECUTING))
    chassis.wait_request(ACTION_ORDER, orders + 2)
    end_task(chassis, 2, TASK_CANCELED)
    status, ret = goal.result()
    assert (status, ret.robot_task_id) == (CANCELED, SET * 100 + 2)


@pytest.mark.usefixtures("normal")
@pytest.mark.parametrize(("last", "status"), [(COMPLETED, SUCCEEDED), (FAILED, ABORTED)])
@pytest.mark.parametrize("seen", [EXECUTING, COMPLETED])
def test_an_end_during_a_lost_link_is_found(
    chassis: ScriptedChassis,
    robot: RunningAgent,
    user: Client,
    seen: int,
    last: int,
    status: int,
) -> None:
    goal = started(chassis, user)
    if seen == COMPLETED:
        chassis.push(TASK_PROC, proc(1, COMPLETED))
        goal.feedback.wait_count(2)
    chassis.vanish()
    chassis.keep(TASK_PROC, proc(1, COMPLETED, 1719991765))
    chassis.keep(TASK_PROC, proc(2, last, 1719991790))
    chassis.keep(TASK_PROC, EMPTY)
    chassis.keep(ROBOT_STATE, IDLE)
    chassis.listen()
    ended, ret = goal.result()
    assert (ended, ret.robot_task_id, ret.state.value) == (status, SET * 100 + 2, last)


@pytest.mark.usefixtures("normal")
def test_a_task_of_another_client_ends_the_set(chassis: ScriptedChassis, user: Client) -> None:
    """The robot executes a task all the time, but not one of the set."""
    goal = started(chassis, user)
    chassis.push(TASK_PROC, proc(1, TASK_CANCELED))
    chassis.push(
        TASK_PROC, {"robotTaskId": "77", "type": 1, "state": EXECUTING, "time": 1719991770}
    )
    status, ret = goal.result()
    assert (status, ret.state.value) == (ABORTED, TASK_CANCELED)


@pytest.mark.usefixtures("normal")
def test_without_the_history_the_last_report_counts(chassis: ScriptedChassis, user: Client) -> None:
    chassis.refused.add(TASK_HISTORY)
    goal = started(chassis, user)
    end_task(chassis, 1)
    assert goal.result()[0] == SUCCEEDED


@pytest.mark.usefixtures("normal")
@pytest.mark.parametrize("number", SETS)
def test_recorded_sets_of_a_real_robot(chassis: ScriptedChassis, user: Client, number: int) -> None:
    """Most records end while the set goes on."""
    recorded = TASKS[number]
    steps = script(chassis, recorded)
    first = recorded["task_id"]
    number = SET if recorded["refused"] else int(first) // 100
    expected = [
        body for body in reports(recorded, None) if body.get("robotTaskId", "")[:-2] == str(number)
    ]

    def play() -> None:
        for step in steps:
            step()

    chassis.expect(EXEC_PRE_TASK, play)
    goal = send(user, number)
    goal.feedback.wait_count(len(expected))
    assert [wire(fb) for fb in goal.feedback.messages] == expected
    if recorded["refused"]:
        status, ret = goal.result()
        assert (status, ret.msg.split(" (")[0]) == (ABORTED, recorded["refused"])
        return
    if recorded["end"] != "kCanceled":
        wait_polls(chassis)
        assert not goal.done
        ended = {**expected[-1], "state": TASK_CANCELED}
        expected.append(ended)
        for name, body in ((TASK_PROC, ended), (TASK_PROC, EMPTY), (ROBOT_STATE, IDLE)):
            chassis.push(name, body)
    status, ret = goal.result()
    assert (status, wire(ret)) == (ABORTED, expected[-1]), "another client cancelled it"


# The simulated robot


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
