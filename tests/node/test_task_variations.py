"""Tasks as a real robot may report them: every usual sequence, with whatever may go wrong.

The agent must notice each end, must not wait for ever, and must not end a goal too early.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import count
from typing import Any

import pytest
from rclpy.action import ActionClient

from tests.harness import Client, Collector, GoalClient, RunningAgent, own_domain, wait_future
from tests.node.goals import (
    ABORTED,
    ACTION_ORDER,
    CANCELED,
    COMPLETED,
    FAILED,
    SUCCEEDED,
    TASK_CANCELED,
    set_timing,
)
from tests.node.scripted_chassis import (
    EXEC_TASK,
    ROBOT_INFO,
    ROBOT_STATE,
    TASK_HISTORY,
    TASK_PROC,
    Body,
    ScriptedChassis,
)
from tests.node.test_real_tasks import wire
from woosh_robot_msgs.action import ExecTask

MODE = "woosh.robot.Mode"
STATUS_CODE = "woosh.robot.count.StatusCode"

IDLE, TASK, UNINIT = {"state": 2}, {"state": 4}, {"state": 1}
NAV, STEP, ENTER, QUIT, WAIT, CHARGE = 1, 2, 3, 4, 6, 7
"""Types of an action."""
RUNS, WARNS, CANCELS, DONE, FAILS, SUSPENDED = 1, 2, 3, 4, 5, 10
"""States of an action."""
PICK = [(3, NAV, RUNS), (3, NAV, DONE), (5, WAIT, RUNS), (5, WAIT, DONE), (7, WAIT, DONE)]
SEQUENCES = {
    "pick": PICK,
    "two waits": [*PICK[:-1], (5, WAIT, RUNS), (5, WAIT, DONE), (7, WAIT, DONE)],
    "parking": [(3, NAV, RUNS), (3, NAV, DONE), (7, NAV, DONE)],
    "out of a dock": [(3, QUIT, RUNS), (3, QUIT, DONE), *PICK],
    "charge": [
        *((3, action, state) for action in (NAV, ENTER, STEP, STEP) for state in (RUNS, DONE)),
        *((3, CHARGE, RUNS), (3, CHARGE, DONE), (7, CHARGE, DONE)),
    ],
    "cancelled": [(3, NAV, RUNS), (3, NAV, CANCELS), (8, NAV, CANCELS)],
    "cancelled in a pause": [
        *((3, NAV, RUNS), (4, NAV, SUSPENDED)),
        *((4, NAV, CANCELS), (8, NAV, CANCELS)),
    ],
    "paused and resumed": [(3, NAV, RUNS), (4, NAV, SUSPENDED), *PICK],
    "obstacle": [(3, NAV, RUNS), (4, NAV, WARNS), (4, NAV, WARNS), *PICK],
    "obstacle, cancelled": [
        *((3, NAV, RUNS), (4, NAV, WARNS)),
        *((4, NAV, CANCELS), (8, NAV, CANCELS)),
    ],
    "failed": [(3, NAV, RUNS), (9, NAV, FAILS)],
    "only the end": [(7, NAV, DONE)],
}
"""Task state, type and state of the action of each report on a task."""
STATUSES = {COMPLETED: SUCCEEDED, TASK_CANCELED: ABORTED, FAILED: ABORTED}
"""Status of a goal, by the state in the last report."""
IDS = count(1_719_959_303_788)

every_sequence = pytest.mark.parametrize("sequence", SEQUENCES)


@pytest.fixture(scope="module")
def chassis() -> Iterator[ScriptedChassis]:
    with ScriptedChassis() as running:
        yield running


@pytest.fixture(scope="module")
def client(chassis: ScriptedChassis) -> Iterator[Client]:
    """Return a ROS client of an agent that executes all tasks one after the other."""
    with own_domain() as domain:
        agent = RunningAgent(
            domain,
            ip="127.0.0.1",
            port=chassis.port,
            goal_link_timeout=5.0,
            backoff_min=0.05,
            backoff_max=0.05,
        )
        agent.wait_connected()
        running = Client(domain)
        yield running
        running.close()
        agent.close()


@pytest.fixture(autouse=True)
def normal(chassis: ScriptedChassis, monkeypatch: pytest.MonkeyPatch) -> None:
    """Poll often, and let the chassis start each test in its normal state."""
    set_timing(monkeypatch, poll_period=0.1, in_doubt_poll_factor=0.5)
    chassis.refused.clear()
    chassis.silent.clear()
    chassis.push(MODE, {"ctrl": 1, "work": 2})
    chassis.push(ROBOT_STATE, IDLE)
    chassis.push(TASK_PROC, empty())


def empty() -> Body:
    """Return the report of a robot that executes no task."""
    return {"action": {}, "time": 1719991764, "robotId": 10001}


def report(task_id: int, step: tuple[int, int, int], time: int = 1719991764) -> Body:
    state, action, action_state = step
    doing = {"type": action, "state": action_state, **({"waitId": 1} if action == WAIT else {})}
    return {
        "robotTaskId": str(task_id),
        "type": 1,
        "state": state,
        "action": doing,
        "dest": "758033B0",
        "time": time,
        "robotId": 10001,
    }


def reports(task_id: int, sequence: str) -> list[Body]:
    return [
        report(task_id, step, 1719991764 + number)
        for number, step in enumerate(SEQUENCES[sequence])
    ]


def send(client: Client, task_id: int) -> GoalClient:
    goal = ExecTask.Goal()
    goal.arg.task_id = task_id
    goal.arg.type.value = 1
    return client.send_goal(ExecTask, "robot/ExecTask", goal)


def start(chassis: ScriptedChassis, client: Client, task_id: int) -> GoalClient:
    """Start a task that the chassis accepts, and that it executes from now on."""
    asked = chassis.count(EXEC_TASK)
    chassis.expect(EXEC_TASK, chassis.answer)
    goal = send(client, task_id)
    chassis.wait_request(EXEC_TASK, asked + 1)
    chassis.push(ROBOT_STATE, TASK)
    return goal


def assert_ended(goal: GoalClient, expected: list[Body]) -> None:
    """Check that a goal ends like the last of these reports, and got all of them as feedback."""
    status, ret = goal.result()
    assert status == STATUSES[expected[-1]["state"]]
    assert wire(ret) == expected[-1]
    goal.feedback.wait_count(len(expected))
    assert [wire(fb) for fb in goal.feedback.messages] == expected


# Whatever the order


@pytest.mark.parametrize("noise", ["none", "twice", "empty before", "other tasks", "next task"])
@pytest.mark.parametrize("answer", ["first", "after the state", "after a report", "last", "never"])
@every_sequence
def test_goal_ends_with_the_task(
    chassis: ScriptedChassis, client: Client, sequence: str, answer: str, noise: str
) -> None:
    task_id = next(IDS)
    pushed = reports(task_id, sequence)
    if noise == "twice":
        pushed = [body for body in pushed for _ in range(2)]
    own = task_id * 100 + 53

    def play() -> None:
        pushes: list[tuple[str, Body]] = [(ROBOT_STATE, TASK)]
        if noise == "empty before":
            pushes += [(TASK_PROC, empty()), (TASK_PROC, empty())]
        for body in pushed:
            if noise == "other tasks":
                pushes += [(TASK_PROC, report(own, (3, NAV, RUNS)))]
            pushes += [(TASK_PROC, body)]
        pushes += [(TASK_PROC, empty()), (ROBOT_STATE, IDLE)]
        if noise == "next task":
            pushes += [(TASK_PROC, body) for body in reports(own, "pick")]
        place = {"first": 0, "after the state": 1, "after a report": 2, "last": len(pushes)}
        for number, push in enumerate([*pushes, None]):
            if number == place.get(answer):
                chassis.answer()
            if push is not None:
                chassis.push(*push)

    chassis.expect(EXEC_TASK, play)
    expected = pushed[:-1] if noise == "twice" else pushed  # the goal ends with the first end
    assert_ended(send(client, task_id), expected)


def test_a_goal_waits_for_its_first_report(chassis: ScriptedChassis, client: Client) -> None:
    """The first report comes up to 1.2 s after the answer; polls find nothing until then."""
    task_id = next(IDS)
    goal = start(chassis, client, task_id)
    chassis.wait_request(TASK_HISTORY, chassis.count(TASK_HISTORY) + 5)
    assert not goal.done
    for body in reports(task_id, "pick"):
        chassis.push(TASK_PROC, body)
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


@pytest.mark.parametrize("told", ["by the history", "by nobody"])
@pytest.mark.parametrize("seen", ["an empty report", "another task", "only the state", "nothing"])
@every_sequence
def test_an_end_that_was_not_seen_is_noticed(
    chassis: ScriptedChassis, client: Client, sequence: str, seen: str, told: str
) -> None:
    task_id = next(IDS)
    first = report(task_id, (3, NAV, RUNS))
    *_, end = reports(task_id, sequence)
    goal = start(chassis, client, task_id)
    chassis.push(TASK_PROC, first)
    goal.feedback.wait_count(1)

    def finish() -> None:
        chassis.keep(TASK_PROC, end)
        if told == "by nobody":
            chassis.forget_history()
        now = report(task_id * 100 + 53, (3, NAV, RUNS)) if seen == "another task" else empty()
        tell = chassis.push if seen in ("an empty report", "another task") else chassis.keep
        tell(TASK_PROC, now)
        if seen != "nothing":
            chassis.push(ROBOT_STATE, IDLE)

    chassis.at_once(finish)
    if told == "by the history":
        assert_ended(goal, [first, end])
    else:
        status, ret = goal.result()
        assert (status, ret.state.value) == (ABORTED, FAILED)
        assert "does not know the task any more" in ret.msg


def test_an_empty_report_makes_the_agent_ask_at_once(
    chassis: ScriptedChassis, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_timing(monkeypatch, poll_period=3600.0)
    task_id = next(IDS)
    expected = reports(task_id, "cancelled")
    goal = start(chassis, client, task_id)
    chassis.push(TASK_PROC, expected[0])
    goal.feedback.wait_count(1)
    chassis.keep(TASK_PROC, expected[-1])
    chassis.push(TASK_PROC, empty())
    assert_ended(goal, [expected[0], expected[-1]])


def test_an_end_that_was_not_seen_is_noticed_if_polls_are_refused(
    chassis: ScriptedChassis, client: Client
) -> None:
    chassis.refused |= {TASK_PROC, TASK_HISTORY}
    task_id = next(IDS)
    goal = start(chassis, client, task_id)
    chassis.push(TASK_PROC, report(task_id, (3, NAV, RUNS)))
    goal.feedback.wait_count(1)
    chassis.push(TASK_PROC, empty())
    status, ret = goal.result()
    assert status == ABORTED
    assert "stopped executing the goal, and does not say how it ended" in ret.msg


def test_a_goal_goes_on_if_polls_are_refused(chassis: ScriptedChassis, client: Client) -> None:
    chassis.refused |= {TASK_PROC, TASK_HISTORY}
    task_id = next(IDS)
    expected = reports(task_id, "obstacle")
    goal = start(chassis, client, task_id)
    for body in expected[:-1]:
        chassis.push(TASK_PROC, body)
    chassis.wait_request(TASK_PROC, chassis.count(TASK_PROC) + 10)
    assert not goal.done
    chassis.push(TASK_PROC, expected[-1])
    assert_ended(goal, expected)


def test_a_late_empty_report_of_the_task_before_ends_nothing(
    chassis: ScriptedChassis, client: Client
) -> None:
    task_id = next(IDS)
    expected = reports(task_id, "pick")
    goal = start(chassis, client, task_id)
    chassis.push(TASK_PROC, expected[0])
    goal.feedback.wait_count(1)

    def disturb() -> None:
        chassis.push(TASK_PROC, empty())
        chassis.keep(TASK_PROC, expected[0])  # what the chassis answers

    chassis.at_once(disturb)
    chassis.wait_request(TASK_PROC, chassis.count(TASK_PROC) + 5)
    assert not goal.done
    for body in expected[1:]:
        chassis.push(TASK_PROC, body)
    assert_ended(goal, expected)


# The link is lost


def reconnect(chassis: ScriptedChassis, meanwhile: Callable[[], None]) -> None:
    known = chassis.count(ROBOT_INFO)
    chassis.vanish()
    meanwhile()
    chassis.listen()
    chassis.wait_request(ROBOT_INFO, known + 1)


@every_sequence
def test_goal_goes_on_after_a_lost_link(
    chassis: ScriptedChassis, client: Client, sequence: str
) -> None:
    task_id = next(IDS)
    expected = [report(task_id, (3, NAV, RUNS)), *reports(task_id, sequence)[1:]]
    if sequence == "only the end":
        expected = [expected[0], *reports(task_id, sequence)]
    goal = start(chassis, client, task_id)
    chassis.push(TASK_PROC, expected[0])
    goal.feedback.wait_count(1)
    reconnect(chassis, lambda: None)
    for body in expected[1:]:
        chassis.push(TASK_PROC, body)
    assert_ended(goal, expected)


@every_sequence
def test_an_end_without_a_link_is_noticed_after_the_reconnect(
    chassis: ScriptedChassis, client: Client, sequence: str
) -> None:
    task_id = next(IDS)
    first, end = report(task_id, (3, NAV, RUNS)), reports(task_id, sequence)[-1]
    goal = start(chassis, client, task_id)
    chassis.push(TASK_PROC, first)
    goal.feedback.wait_count(1)

    def meanwhile() -> None:
        chassis.keep(TASK_PROC, end)
        chassis.keep(TASK_PROC, empty())

    reconnect(chassis, meanwhile)
    assert_ended(goal, [first, end])


def test_link_lost_between_the_acceptance_and_the_first_report(
    chassis: ScriptedChassis, client: Client
) -> None:
    task_id = next(IDS)
    goal = start(chassis, client, task_id)
    reconnect(chassis, lambda: None)
    chassis.wait_request(TASK_HISTORY, chassis.count(TASK_HISTORY) + 3)
    assert not goal.done
    for body in reports(task_id, "pick"):
        chassis.push(TASK_PROC, body)
    assert_ended(goal, reports(task_id, "pick"))


# Several tasks


def test_a_task_that_is_refused_does_not_disturb_the_running_one(
    chassis: ScriptedChassis, client: Client
) -> None:
    task_id = next(IDS)
    expected = reports(task_id, "pick")
    goal = start(chassis, client, task_id)
    chassis.push(TASK_PROC, expected[0])
    goal.feedback.wait_count(1)
    words = "Task is excuting,request failed"
    chassis.expect(EXEC_TASK, lambda: chassis.answer(False, words))
    refused = send(client, next(IDS))
    for body in expected[1:3]:
        chassis.push(TASK_PROC, body)
    status, ret = refused.result()
    assert (status, ret.state.value) == (ABORTED, FAILED)
    assert ret.msg == f"{words} (the robot is executing task {task_id})"
    assert not refused.feedback.messages
    for body in expected[3:]:
        chassis.push(TASK_PROC, body)
    assert_ended(goal, expected)


def test_the_end_of_an_earlier_task_with_the_same_id_ends_nothing(
    chassis: ScriptedChassis, client: Client
) -> None:
    task_id = next(IDS)
    before = reports(task_id, "cancelled")
    goal = start(chassis, client, task_id)
    for body in [*before, empty()]:
        chassis.push(TASK_PROC, body)
    assert_ended(goal, before)
    chassis.push(TASK_PROC, {**empty(), "time": 0})  # as of a chassis that tells no time

    goal = start(chassis, client, task_id)
    chassis.wait_request(TASK_HISTORY, chassis.count(TASK_HISTORY) + 3)
    assert not goal.done
    expected = [{**body, "time": body["time"] + 60} for body in reports(task_id, "pick")]
    for body in [*expected, empty()]:
        chassis.push(TASK_PROC, body)
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
    for body in [*expected, empty()]:
        chassis.push(TASK_PROC, body)
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
    goal = start(chassis, client, task_id)
    for body in before:
        chassis.push(TASK_PROC, body)
    goal.feedback.wait_count(len(before))

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
    goal = start(chassis, client, task_id)
    chassis.push(TASK_PROC, expected[0])
    goal.feedback.wait_count(1)
    chassis.expect(ACTION_ORDER, lambda: chassis.answer(False, "Request failed"))
    goal.cancel()
    for body in [*expected[1:], empty()]:
        chassis.push(TASK_PROC, body)
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
            for body in [*bodies, empty()]:
                chassis.push(TASK_PROC, body)

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
    action.destroy()
