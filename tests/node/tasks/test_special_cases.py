"""Tasks that go another way than usual: the end unseen, ids used twice, cancels and refusals."""

from __future__ import annotations

from typing import Any

import pytest
from rclpy.action import ActionClient

from tests.harness import Client, Collector, wait_future
from tests.node.goals import ABORTED, ACTION_ORDER, CANCELED, FAILED, SUCCEEDED, set_timing
from tests.node.tasks.reports import (
    DONE,
    IDLE,
    IDS,
    NAV,
    RUNS,
    assert_ended,
    empty,
    reconnect,
    report,
    reports,
    send,
    start,
    wire,
)
from tests.node.tasks.scripted_chassis import (
    EXEC_TASK,
    MODE,
    ROBOT_STATE,
    TASK_HISTORY,
    TASK_PROC,
    Body,
    ScriptedChassis,
)
from woosh_robot_msgs.action import ExecTask

STATUS_CODE = "woosh.robot.count.StatusCode"

pytestmark = pytest.mark.usefixtures("normal")


# No report yet


def test_a_goal_waits_for_its_first_report(chassis: ScriptedChassis, client: Client) -> None:
    """The first report comes up to 1.2 s after the answer; polls find nothing until then."""
    task_id = next(IDS)
    goal = start(chassis, client, task_id)
    chassis.wait_request(TASK_HISTORY, chassis.count(TASK_HISTORY) + 5)
    assert not goal.done
    chassis.push_all(TASK_PROC, reports(task_id, "pick"))
    assert_ended(goal, reports(task_id, "pick"))


def test_a_task_that_the_chassis_forgets_is_given_up(
    chassis: ScriptedChassis, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_timing(monkeypatch, first_report_timeout=0.5)
    goal = start(chassis, client, next(IDS))
    status, ret = goal.result()
    assert (status, ret.state.value) == (ABORTED, FAILED)
    assert "does not know the task any more; it is executing no task" in ret.msg
    assert not goal.feedback.messages


# The end is not seen


def test_an_empty_report_makes_the_agent_ask_at_once(
    chassis: ScriptedChassis, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_timing(monkeypatch, poll_period=3600.0)
    task_id = next(IDS)
    expected = reports(task_id, "cancelled")
    goal = start(chassis, client, task_id, expected[0])
    chassis.keep(TASK_PROC, expected[-1])
    chassis.push(TASK_PROC, empty())
    assert_ended(goal, [expected[0], expected[-1]])


def test_an_end_that_was_not_seen_is_noticed_if_polls_are_refused(
    chassis: ScriptedChassis, client: Client
) -> None:
    chassis.refused |= {TASK_PROC, TASK_HISTORY}
    task_id = next(IDS)
    goal = start(chassis, client, task_id, report(task_id, (3, NAV, RUNS)))
    chassis.push(TASK_PROC, empty())
    status, ret = goal.result()
    assert status == ABORTED
    assert "stopped executing the goal, but did not report how it ended" in ret.msg


def test_a_goal_goes_on_if_polls_are_refused(chassis: ScriptedChassis, client: Client) -> None:
    chassis.refused |= {TASK_PROC, TASK_HISTORY}
    task_id = next(IDS)
    expected = reports(task_id, "obstacle")
    goal = start(chassis, client, task_id)
    chassis.push_all(TASK_PROC, expected[:-1])
    chassis.wait_request(TASK_PROC, chassis.count(TASK_PROC) + 10)
    assert not goal.done
    chassis.push(TASK_PROC, expected[-1])
    assert_ended(goal, expected)


def test_a_late_empty_report_of_the_task_before_ends_nothing(
    chassis: ScriptedChassis, client: Client
) -> None:
    task_id = next(IDS)
    expected = reports(task_id, "pick")
    goal = start(chassis, client, task_id, expected[0])

    def disturb() -> None:
        chassis.push(TASK_PROC, empty())
        chassis.keep(TASK_PROC, expected[0])  # what the chassis answers

    chassis.at_once(disturb)
    chassis.wait_request(TASK_PROC, chassis.count(TASK_PROC) + 5)
    assert not goal.done
    chassis.push_all(TASK_PROC, expected[1:])
    assert_ended(goal, expected)


# The link is lost


def test_link_lost_between_the_acceptance_and_the_first_report(
    chassis: ScriptedChassis, client: Client
) -> None:
    task_id = next(IDS)
    goal = start(chassis, client, task_id)
    reconnect(chassis)
    chassis.wait_request(TASK_HISTORY, chassis.count(TASK_HISTORY) + 3)
    assert not goal.done
    chassis.push_all(TASK_PROC, reports(task_id, "pick"))
    assert_ended(goal, reports(task_id, "pick"))


# Several tasks


def test_a_task_that_is_refused_does_not_disturb_the_running_one(
    chassis: ScriptedChassis, client: Client
) -> None:
    task_id = next(IDS)
    expected = reports(task_id, "pick")
    goal = start(chassis, client, task_id, expected[0])
    words = "Task is excuting,request failed"
    chassis.expect(EXEC_TASK, lambda: chassis.answer(False, words))
    refused = send(client, next(IDS))
    chassis.push_all(TASK_PROC, expected[1:3])
    status, ret = refused.result()
    assert (status, ret.state.value) == (ABORTED, FAILED)
    assert ret.msg == f"{words} (the robot is executing task {task_id})"
    assert not refused.feedback.messages
    chassis.push_all(TASK_PROC, expected[3:])
    assert_ended(goal, expected)


def test_the_end_of_an_earlier_task_with_the_same_id_ends_nothing(
    chassis: ScriptedChassis, client: Client
) -> None:
    task_id = next(IDS)
    before = reports(task_id, "cancelled")
    goal = start(chassis, client, task_id)
    chassis.push_all(TASK_PROC, [*before, empty()])
    assert_ended(goal, before)
    chassis.push(TASK_PROC, {**empty(), "time": 0})  # as of a chassis that tells no time

    goal = start(chassis, client, task_id)
    chassis.wait_request(TASK_HISTORY, chassis.count(TASK_HISTORY) + 3)
    assert not goal.done
    expected = [{**body, "time": body["time"] + 60} for body in reports(task_id, "pick")]
    chassis.push_all(TASK_PROC, [*expected, empty()])
    assert_ended(goal, expected)


def test_an_old_task_with_the_same_id_in_the_history_ends_nothing(
    chassis: ScriptedChassis, client: Client
) -> None:
    task_id = next(IDS)
    chassis.keep(TASK_PROC, report(task_id, (7, NAV, DONE)))  # at that time, nobody listened
    chassis.push(TASK_PROC, empty())
    goal = start(chassis, client, task_id)
    chassis.wait_request(TASK_HISTORY, chassis.count(TASK_HISTORY) + 3)
    assert not goal.done
    expected = [{**body, "time": body["time"] + 60} for body in reports(task_id, "cancelled")]
    chassis.push_all(TASK_PROC, [*expected, empty()])
    assert_ended(goal, expected)


# Cancelled by the client


@pytest.mark.parametrize("order", ["answer first", "reports first", "answer lost", "end not seen"])
@pytest.mark.parametrize("paused", [False, True])
def test_a_cancel_by_the_client(
    chassis: ScriptedChassis, client: Client, paused: bool, order: str
) -> None:
    task_id = next(IDS)
    expected = reports(task_id, "cancelled in a pause" if paused else "cancelled")
    *before, cancels, end = expected
    goal = start(chassis, client, task_id, *before)

    def cancel() -> None:
        if order in ("answer first", "end not seen"):
            chassis.answer()
        chassis.push(TASK_PROC, cancels)
        (chassis.keep if order == "end not seen" else chassis.push)(TASK_PROC, end)
        chassis.push(TASK_PROC, empty())
        chassis.push(ROBOT_STATE, IDLE)
        if order == "reports first":
            chassis.answer()

    chassis.expect(ACTION_ORDER, cancel)
    goal.cancel()
    status, ret = goal.result()
    assert (status, wire(ret)) == (CANCELED, end)
    goal.feedback.wait_count(len(expected))
    assert [wire(fb) for fb in goal.feedback.messages] == expected


def test_a_cancel_that_the_chassis_refuses(chassis: ScriptedChassis, client: Client) -> None:
    task_id = next(IDS)
    expected = reports(task_id, "pick")
    goal = start(chassis, client, task_id, expected[0])
    chassis.expect(ACTION_ORDER, lambda: chassis.answer(False, "Request failed"))
    goal.cancel()
    chassis.push_all(TASK_PROC, [*expected[1:], empty()])
    assert_ended(goal, expected)


# Refusals


def test_the_reason_of_a_refusal_follows_the_words_of_the_chassis(
    chassis: ScriptedChassis, client: Client
) -> None:
    chassis.push(MODE, {"ctrl": 2, "work": 2})
    chassis.expect(EXEC_TASK, lambda: chassis.answer(False, "Request failed"))
    status, ret = send(client, next(IDS)).result()
    assert status == ABORTED
    assert ret.msg.startswith("Request failed (the robot is in manual mode")


def test_a_status_code_after_a_refusal_gives_the_reason(
    chassis: ScriptedChassis, client: Client
) -> None:
    def refuse() -> None:
        chassis.answer(False, "Request failed")
        chassis.push(STATUS_CODE, {"code": "140801000081", "level": 1})

    chassis.expect(EXEC_TASK, refuse)
    _, ret = send(client, next(IDS)).result()
    assert ret.msg.startswith("Request failed (status code 140801000081")


def test_a_refusal_without_a_known_reason_is_the_word_of_the_chassis(
    chassis: ScriptedChassis, client: Client
) -> None:
    chassis.expect(EXEC_TASK, lambda: chassis.answer(False, "Request failed"))
    assert send(client, next(IDS)).result()[1].msg == "Request failed"


# Feedback


def test_an_ordinary_client_gets_the_last_feedback(
    chassis: ScriptedChassis, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    """rclpy's action client drops feedback that it has not read before the result."""
    set_timing(monkeypatch, result_delay=1.0)  # enough on a busy machine
    node = client.node
    action = ActionClient(node, ExecTask, client.path("robot/ExecTask"))
    client.action(ExecTask, "robot/ExecTask")  # both ends know each other
    assert action.wait_for_server(10.0)
    for _ in range(5):
        task_id = next(IDS)
        expected = reports(task_id, "pick")
        feedback = Collector()

        def play(bodies: list[Body] = expected) -> None:
            chassis.answer()
            chassis.push_all(TASK_PROC, [*bodies, empty()])

        chassis.expect(EXEC_TASK, play)
        goal: Any = ExecTask.Goal()
        goal.arg.task_id = task_id
        handle = wait_future(
            client.in_executor(
                lambda goal=goal, feedback=feedback: action.send_goal_async(
                    goal, feedback_callback=lambda message: feedback.add(message.feedback.fb)
                )
            )
        )
        result = wait_future(client.in_executor(handle.get_result_async))
        assert result.status == SUCCEEDED
        assert [wire(fb) for fb in feedback.messages] == expected
    client.in_executor(action.destroy)


def test_the_result_does_not_wait_if_there_is_no_older_feedback_to_be_read(
    chassis: ScriptedChassis, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_timing(monkeypatch, result_delay=3600.0)
    task_id = next(IDS)
    goal = start(chassis, client, task_id)
    chassis.push_all(TASK_PROC, reports(task_id, "only the end"))
    assert_ended(goal, reports(task_id, "only the end"))
