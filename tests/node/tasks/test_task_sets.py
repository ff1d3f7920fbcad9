"""robot/ExecPreTask as an action: a set of tasks ends when its last task does.

The chassis reports on the tasks only, never on the set. Between two tasks it sends an empty report,
and its state is idle for some milliseconds, as at the end of the set.
"""

from __future__ import annotations

import pytest

from tests.harness import GoalClient
from tests.node.goals import (
    ABORTED,
    ACTION_ORDER,
    CANCELED,
    COMPLETED,
    EXECUTING,
    FAILED,
    SUCCEEDED,
    TASK_CANCELED,
    task_set,
)
from tests.node.tasks.reports import IDLE, TASK, ScriptedRobot, empty, wire
from tests.node.tasks.scripted_chassis import (
    ROBOT_STATE,
    TASK_HISTORY,
    TASK_PROC,
    Body,
    ScriptedChassis,
)
from tests.node.tasks.test_real_tasks import EXEC_PRE_TASK, SETS, TASKS, play, reports, script

pytestmark = pytest.mark.usefixtures("normal")
SET = 1719959961
"""Id of a set of a real robot."""


@pytest.fixture(autouse=True)
def nothing_ended(robot: ScriptedRobot, normal: None) -> None:
    """Let the chassis forget the tasks of earlier tests, which have the same ids."""
    robot.chassis.forget_history()


def proc(task_id: int, state: int, time: int = 1719991764) -> Body:
    """Return a report on a task of the set."""
    return {"robotTaskId": str(SET * 100 + task_id), "type": 1, "state": state, "time": time}


def started(robot: ScriptedRobot) -> GoalClient:
    """Start the set; its first task is running."""
    chassis = robot.chassis
    asked = chassis.count(EXEC_PRE_TASK)
    chassis.expect(EXEC_PRE_TASK, chassis.answer)
    goal = task_set(robot, SET)
    assert chassis.wait_request(EXEC_PRE_TASK, asked + 1)["taskSetId"] == SET
    chassis.push(ROBOT_STATE, TASK)
    chassis.push(TASK_PROC, proc(1, EXECUTING))
    goal.feedback.wait_count(1)
    return goal


def end_task(chassis: ScriptedChassis, task_id: int, state: int = COMPLETED) -> None:
    """End a task of the set as real robots do."""
    chassis.push(TASK_PROC, proc(task_id, state))
    chassis.push(TASK_PROC, empty())
    chassis.push(ROBOT_STATE, IDLE)


def wait_polls(chassis: ScriptedChassis) -> None:
    chassis.wait_request(TASK_PROC, chassis.count(TASK_PROC) + 3)


def fed_back(goal: GoalClient) -> list[tuple[int, int]]:
    return [(fb.robot_task_id % 100, fb.state.value) for fb in goal.feedback.messages]


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
    robot: ScriptedRobot, first: int, last: int, status: int
) -> None:
    goal = started(robot)
    end_task(robot.chassis, 1, first)
    robot.chassis.push(ROBOT_STATE, TASK)
    wait_polls(robot.chassis)
    assert not goal.done, "the next task begins only about a second later"
    robot.chassis.push(TASK_PROC, proc(2, EXECUTING))
    goal.feedback.wait_count(3)
    end_task(robot.chassis, 2, last)
    ended, ret = goal.result()
    assert (ended, ret.robot_task_id, ret.state.value) == (status, SET * 100 + 2, last)
    assert fed_back(goal) == [(1, EXECUTING), (1, first), (2, EXECUTING), (2, last)]


def test_a_set_of_the_same_tasks_again_does_not_end_as_the_time_before(
    robot: ScriptedRobot,
) -> None:
    goal = started(robot)
    end_task(robot.chassis, 1)
    assert goal.result()[0] == SUCCEEDED
    robot.set_goal_timing(first_report_timeout=0.3, poll_period=0.1)
    robot.chassis.expect(EXEC_PRE_TASK, robot.chassis.answer)
    task_set(robot, SET).wait_aborted("does not execute the task set any more")


def test_a_set_does_not_end_as_before_the_robots_clock_was_set_back(robot: ScriptedRobot) -> None:
    robot.chassis.keep(TASK_PROC, proc(1, FAILED, 1719991764 + 7200))
    goal = started(robot)
    end_task(robot.chassis, 1)
    assert goal.result()[0] == SUCCEEDED


def test_a_set_that_has_not_begun_does_not_end_as_before_although_the_time_is_unknown(
    robot: ScriptedRobot,
) -> None:
    chassis = robot.chassis
    chassis.keep(TASK_PROC, proc(1, COMPLETED))
    chassis.push(TASK_PROC, empty(0))
    asked = chassis.count(EXEC_PRE_TASK)
    chassis.expect(EXEC_PRE_TASK, chassis.answer)
    goal = task_set(robot, SET)
    chassis.wait_request(EXEC_PRE_TASK, asked + 1)
    chassis.wait_request(TASK_HISTORY, chassis.count(TASK_HISTORY) + 4)
    assert not goal.done
    chassis.push(TASK_PROC, proc(1, EXECUTING, 1719991824))
    chassis.push(TASK_PROC, proc(1, TASK_CANCELED, 1719991825))
    chassis.push(TASK_PROC, empty())
    assert goal.wait_aborted().state.value == TASK_CANCELED


@pytest.mark.parametrize("seen", ["by reports", "by polls", "by polls, without the first end"])
def test_a_cancel_is_repeated_until_the_whole_set_has_ended(
    robot: ScriptedRobot, seen: str
) -> None:
    """A real robot went on with the third task when the second one was cancelled."""
    orders = robot.chassis.count(ACTION_ORDER)
    goal = started(robot)
    goal.cancel()
    robot.chassis.wait_request(ACTION_ORDER, orders + 1)
    if seen == "by reports":
        end_task(robot.chassis, 1, TASK_CANCELED)
        robot.chassis.push(ROBOT_STATE, TASK)
        wait_polls(robot.chassis)
        assert robot.chassis.count(ACTION_ORDER) == orders + 1, "no task runs that it could end"
        robot.chassis.push(TASK_PROC, proc(2, EXECUTING))
    else:
        if seen == "by polls":
            robot.chassis.push(TASK_PROC, proc(1, TASK_CANCELED))
        robot.chassis.keep(TASK_PROC, proc(2, EXECUTING))
    robot.chassis.wait_request(ACTION_ORDER, orders + 2)
    end_task(robot.chassis, 2, TASK_CANCELED)
    status, ret = goal.result()
    assert (status, ret.robot_task_id) == (CANCELED, SET * 100 + 2)


@pytest.mark.parametrize(("last", "status"), [(COMPLETED, SUCCEEDED), (FAILED, ABORTED)])
@pytest.mark.parametrize("seen", [EXECUTING, COMPLETED])
def test_an_end_during_a_lost_link_is_found(
    robot: ScriptedRobot, seen: int, last: int, status: int
) -> None:
    goal = started(robot)
    if seen == COMPLETED:
        robot.chassis.push(TASK_PROC, proc(1, COMPLETED))
        goal.feedback.wait_count(2)
    robot.chassis.vanish()
    robot.chassis.keep(TASK_PROC, proc(1, COMPLETED, 1719991765))
    robot.chassis.keep(TASK_PROC, proc(2, last, 1719991790))
    robot.chassis.keep(TASK_PROC, empty(1719991790))
    robot.chassis.keep(ROBOT_STATE, IDLE)
    robot.chassis.listen()
    ended, ret = goal.result()
    assert (ended, ret.robot_task_id, ret.state.value) == (status, SET * 100 + 2, last)


def test_a_task_of_another_client_ends_the_set(robot: ScriptedRobot) -> None:
    """The robot executes a task all the time, but not one of the set."""
    goal = started(robot)
    robot.chassis.push(TASK_PROC, proc(1, TASK_CANCELED))
    robot.chassis.push(
        TASK_PROC, {"robotTaskId": "77", "type": 1, "state": EXECUTING, "time": 1719991770}
    )
    assert goal.wait_aborted().state.value == TASK_CANCELED


def test_without_the_history_the_last_report_counts(robot: ScriptedRobot) -> None:
    robot.chassis.refused.add(TASK_HISTORY)
    goal = started(robot)
    end_task(robot.chassis, 1)
    assert goal.result()[0] == SUCCEEDED


@pytest.mark.parametrize("number", SETS)
def test_recorded_sets_of_a_real_robot(robot: ScriptedRobot, number: int) -> None:
    """Most records end while the set goes on."""
    recorded = TASKS[number]
    steps = script(robot.chassis, recorded)
    first = recorded["task_id"]
    number = SET if recorded["refused"] else int(first) // 100
    expected = [
        body for body in reports(recorded, None) if body.get("robotTaskId", "")[:-2] == str(number)
    ]

    robot.chassis.expect(EXEC_PRE_TASK, lambda: play(steps))
    goal = task_set(robot, number)
    goal.feedback.wait_count(len(expected))
    assert [wire(fb) for fb in goal.feedback.messages] == expected
    if recorded["refused"]:
        status, ret = goal.result()
        assert (status, ret.msg.split(" (")[0]) == (ABORTED, recorded["refused"])
        return
    if recorded["end"] != "kCanceled":
        wait_polls(robot.chassis)
        assert not goal.done
        ended = {**expected[-1], "state": TASK_CANCELED}
        expected.append(ended)
        for name, body in ((TASK_PROC, ended), (TASK_PROC, empty()), (ROBOT_STATE, IDLE)):
            robot.chassis.push(name, body)
    status, ret = goal.result()
    assert (status, wire(ret)) == (ABORTED, expected[-1]), "another client cancelled it"
