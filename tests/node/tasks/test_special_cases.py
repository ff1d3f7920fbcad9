"""Tasks that go another way than usual: the end unseen, ids used twice, cancels and refusals.

test_real_tasks.py has the usual course, with the disturbances that real robots send.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from rclpy.action import ActionClient

from tests.harness import Collector, wait_future, wait_until
from tests.node.goals import ACTION_ORDER, CANCELED, FAILED, SUCCEEDED
from tests.node.tasks.reports import (
    DONE,
    IDLE,
    IDS,
    NAV,
    RUNS,
    ScriptedRobot,
    assert_ended,
    empty,
    report,
    reports,
    send,
    wire,
)
from tests.node.tasks.scripted_chassis import (
    EXEC_TASK,
    MODE,
    ROBOT_STATE,
    TASK_HISTORY,
    TASK_PROC,
    Body,
)
from woosh_robot_agent.ros.actions import tasks
from woosh_robot_msgs.action import ExecTask

STATUS_CODE = "woosh.robot.count.StatusCode"

pytestmark = pytest.mark.usefixtures("normal")


# No report yet


@pytest.mark.parametrize("lost", [False, True], ids=["link up", "link lost"])
def test_a_goal_waits_for_its_first_report(robot: ScriptedRobot, lost: bool) -> None:
    """The first report comes up to 1.2 s after the answer; polls find nothing until then."""
    task_id = next(IDS)
    goal = robot.start(task_id)
    if lost:
        robot.reconnect()
    robot.chassis.wait_request(TASK_HISTORY, robot.chassis.count(TASK_HISTORY) + 5)
    assert not goal.done
    robot.chassis.push_all(TASK_PROC, reports(task_id, "pick"))
    assert_ended(goal, reports(task_id, "pick"))


@pytest.mark.parametrize("now", [1.8e9, 2.0**31], ids=["now", "from 2038 on"])
def test_a_task_that_the_chassis_forgets_is_given_up(
    robot: ScriptedRobot, monkeypatch: pytest.MonkeyPatch, now: float
) -> None:
    monkeypatch.setattr(tasks, "time", SimpleNamespace(time=lambda: now))
    robot.set_goal_timing(first_report_timeout=0.5)
    goal = robot.start(next(IDS))
    ret = goal.wait_aborted("does not know the task any more; it is executing no task")
    assert ret.state.value == FAILED
    assert not goal.feedback.messages


# The end is not seen


@pytest.mark.parametrize(
    ("seen", "told"),
    [
        ("an empty report", "by the history"),
        ("another task", "by nobody"),
        ("only the state", "by the history"),
        ("only the state", "by nobody"),
        ("nothing", "by nobody"),
    ],
)
def test_an_end_that_was_not_seen_is_noticed(robot: ScriptedRobot, seen: str, told: str) -> None:
    task_id = next(IDS)
    first, *_, end = reports(task_id, "pick")
    goal = robot.start(task_id, first)

    def finish() -> None:
        robot.chassis.keep(TASK_PROC, end)
        if told == "by nobody":
            robot.chassis.forget_history()
        now = (
            report(task_id * 100 + 53, (3, NAV, RUNS))
            if seen == "another task"
            else empty(end["time"])
        )
        is_pushed = seen in ("an empty report", "another task")
        (robot.chassis.push if is_pushed else robot.chassis.keep)(TASK_PROC, now)
        if seen != "nothing":
            robot.chassis.push(ROBOT_STATE, IDLE)

    robot.chassis.at_once(finish)
    if told == "by the history":
        assert_ended(goal, [first, end])
    else:
        assert goal.wait_aborted("does not know the task any more").state.value == FAILED
    if seen == "nothing":  # the task may go on
        assert robot.gate.wheel_owner.name == f"task {task_id}"
    else:
        wait_until(lambda: robot.gate.wheel_owner.name != f"task {task_id}")


def test_an_end_without_a_link_is_noticed_after_the_reconnect(robot: ScriptedRobot) -> None:
    task_id = next(IDS)
    first, *_, end = reports(task_id, "pick")
    goal = robot.start(task_id, first)

    def meanwhile() -> None:
        robot.chassis.keep(TASK_PROC, end)
        robot.chassis.keep(TASK_PROC, empty(end["time"]))

    robot.reconnect(meanwhile)
    assert_ended(goal, [first, end])


def test_an_empty_report_makes_the_agent_ask_at_once(robot: ScriptedRobot) -> None:
    robot.set_goal_timing(poll_period=3600.0)
    task_id = next(IDS)
    expected = reports(task_id, "cancelled")
    goal = robot.start(task_id, expected[0])
    robot.chassis.keep(TASK_PROC, expected[-1])
    robot.chassis.push(TASK_PROC, empty(expected[-1]["time"]))
    assert_ended(goal, [expected[0], expected[-1]])


def test_an_end_that_was_not_seen_is_noticed_if_polls_are_refused(robot: ScriptedRobot) -> None:
    robot.chassis.refused |= {TASK_PROC, TASK_HISTORY}
    task_id = next(IDS)
    goal = robot.start(task_id, report(task_id, (3, NAV, RUNS)))
    robot.chassis.push(TASK_PROC, empty())
    goal.wait_aborted("stopped executing the goal, but did not report how it ended")


def test_a_goal_goes_on_if_polls_are_refused(robot: ScriptedRobot) -> None:
    robot.chassis.refused |= {TASK_PROC, TASK_HISTORY}
    task_id = next(IDS)
    expected = reports(task_id, "obstacle")
    goal = robot.start(task_id)
    robot.chassis.push_all(TASK_PROC, expected[:-1])
    robot.chassis.wait_request(TASK_PROC, robot.chassis.count(TASK_PROC) + 10)
    assert not goal.done
    robot.chassis.push(TASK_PROC, expected[-1])
    assert_ended(goal, expected)


def test_a_late_empty_report_of_the_task_before_ends_nothing(robot: ScriptedRobot) -> None:
    task_id = next(IDS)
    expected = reports(task_id, "pick")
    goal = robot.start(task_id, expected[0])

    def disturb() -> None:
        robot.chassis.push(TASK_PROC, empty())
        robot.chassis.keep(TASK_PROC, expected[0])  # what the chassis answers

    robot.chassis.at_once(disturb)
    robot.chassis.wait_request(TASK_PROC, robot.chassis.count(TASK_PROC) + 5)
    assert not goal.done
    robot.chassis.push_all(TASK_PROC, expected[1:])
    assert_ended(goal, expected)


# Several tasks


def test_a_task_that_is_refused_does_not_disturb_the_running_one(robot: ScriptedRobot) -> None:
    task_id = next(IDS)
    expected = reports(task_id, "pick")
    goal = robot.start(task_id, expected[0])
    words = "Task is excuting,request failed"
    robot.chassis.expect(EXEC_TASK, lambda: robot.chassis.answer(False, words))
    refused = send(robot, next(IDS))
    robot.chassis.push_all(TASK_PROC, expected[1:3])
    ret = refused.wait_aborted()
    assert ret.state.value == FAILED
    assert ret.msg == f"{words} (the robot is executing task {task_id})"
    assert not refused.feedback.messages
    robot.chassis.push_all(TASK_PROC, expected[3:])
    assert_ended(goal, expected)


@pytest.mark.parametrize("tells_time", [True, False], ids=["with times", "without a time"])
@pytest.mark.parametrize("seen", [True, False], ids=["seen", "only in the history"])
def test_the_end_of_an_earlier_task_with_the_same_id_ends_nothing(
    robot: ScriptedRobot, seen: bool, tells_time: bool
) -> None:
    chassis, task_id = robot.chassis, next(IDS)
    idle = empty() if tells_time else empty(0)
    if seen:
        before = reports(task_id, "cancelled")
        goal = robot.start(task_id)
        chassis.push_all(TASK_PROC, [*before, empty()])
        assert_ended(goal, before)
    else:
        chassis.keep(TASK_PROC, report(task_id, (7, NAV, DONE)))  # at that time, nobody listened
    chassis.push(TASK_PROC, idle)
    goal = robot.start(task_id)
    chassis.wait_request(TASK_HISTORY, chassis.count(TASK_HISTORY) + 3)
    assert not goal.done
    sequence = "pick" if seen else "cancelled"
    expected = [{**body, "time": body["time"] + 60} for body in reports(task_id, sequence)]
    chassis.push_all(TASK_PROC, [*expected, empty()])
    assert_ended(goal, expected)


def test_an_end_is_found_after_the_robots_clock_was_set_back(robot: ScriptedRobot) -> None:
    """The history has an earlier task with the same id, which ended later by that clock."""
    chassis, task_id = robot.chassis, next(IDS)
    before = [{**body, "time": body["time"] + 7200} for body in reports(task_id, "cancelled")]
    goal = robot.start(task_id)
    chassis.push_all(TASK_PROC, [*before, empty()])
    assert_ended(goal, before)
    first, *_, end = reports(task_id, "pick")
    goal = robot.start(task_id, first)
    chassis.keep(TASK_PROC, end)
    chassis.push(TASK_PROC, empty(end["time"]))
    assert_ended(goal, [first, end])


# Cancelled by the client


@pytest.mark.parametrize(
    ("order", "paused"),
    [
        ("answer first", False),
        ("reports first", True),
        ("answer lost", False),
        ("end not seen", True),
    ],
)
def test_a_cancel_by_the_client(robot: ScriptedRobot, order: str, paused: bool) -> None:
    task_id = next(IDS)
    expected = reports(task_id, "cancelled in a pause" if paused else "cancelled")
    *before, cancels, end = expected
    goal = robot.start(task_id, *before)

    def cancel() -> None:
        if order in ("answer first", "end not seen"):
            robot.chassis.answer()
        robot.chassis.push(TASK_PROC, cancels)
        (robot.chassis.keep if order == "end not seen" else robot.chassis.push)(TASK_PROC, end)
        robot.chassis.push(TASK_PROC, empty(end["time"]))
        robot.chassis.push(ROBOT_STATE, IDLE)
        if order == "reports first":
            robot.chassis.answer()

    robot.chassis.expect(ACTION_ORDER, cancel)
    goal.cancel()
    status, ret = goal.result()
    assert (status, wire(ret)) == (CANCELED, end)
    goal.feedback.wait_count(len(expected))
    assert [wire(fb) for fb in goal.feedback.messages] == expected


# Refusals


@pytest.mark.parametrize(
    ("ctrl", "code", "reason"),
    [
        (2, None, " (the robot is in manual mode"),
        (1, "140801000081", " (status code 140801000081"),
        (1, None, ""),
    ],
    ids=["mode", "status code", "unknown"],
)
def test_the_reason_of_a_refusal_follows_the_words_of_the_chassis(
    robot: ScriptedRobot, ctrl: int, code: str | None, reason: str
) -> None:
    def refuse() -> None:
        robot.chassis.answer(False, "Request failed")
        if code:
            robot.chassis.push(STATUS_CODE, {"code": code, "level": 1})

    robot.chassis.push(MODE, {"ctrl": ctrl, "work": 2})
    robot.chassis.expect(EXEC_TASK, refuse)
    ret = send(robot, next(IDS)).wait_aborted()
    assert ret.msg.startswith(f"Request failed{reason}")
    assert reason or ret.msg == "Request failed"


# Feedback


def test_an_ordinary_client_gets_the_last_feedback(robot: ScriptedRobot) -> None:
    """rclpy's action client drops feedback that it has not read before the result."""
    robot.set_goal_timing(result_delay=1.0)  # enough on a busy machine
    node = robot.node
    action = ActionClient(node, ExecTask, robot.path("robot/ExecTask"))
    robot.action(ExecTask, "robot/ExecTask")  # both ends know each other
    assert action.wait_for_server(10.0)
    for _ in range(5):
        task_id = next(IDS)
        expected = reports(task_id, "pick")
        feedback = Collector()

        def play(bodies: list[Body] = expected) -> None:
            robot.chassis.answer()
            robot.chassis.push_all(TASK_PROC, [*bodies, empty()])

        robot.chassis.expect(EXEC_TASK, play)
        goal: Any = ExecTask.Goal()
        goal.arg.task_id = task_id
        handle = wait_future(
            robot.in_executor(
                lambda goal=goal, feedback=feedback: action.send_goal_async(
                    goal, feedback_callback=lambda message: feedback.add(message.feedback.fb)
                )
            )
        )
        result = wait_future(robot.in_executor(handle.get_result_async))
        assert result.status == SUCCEEDED
        assert [wire(fb) for fb in feedback.messages] == expected
    robot.in_executor(action.destroy)


def test_the_result_does_not_wait_if_there_is_no_older_feedback_to_be_read(
    robot: ScriptedRobot,
) -> None:
    robot.set_goal_timing(result_delay=3600.0)
    task_id = next(IDS)
    goal = robot.start(task_id)
    robot.chassis.push_all(TASK_PROC, reports(task_id, "only the end"))
    assert_ended(goal, reports(task_id, "only the end"))
