"""Every usual sequence of reports on a task, with each thing that may go wrong.

The agent must notice each end, must not wait for ever, and must not end a goal too early.
"""

from __future__ import annotations

import pytest

from tests.node.goals import FAILED
from tests.node.tasks.reports import (
    IDLE,
    IDS,
    NAV,
    RUNS,
    SEQUENCES,
    TASK,
    ScriptedRobot,
    assert_ended,
    empty,
    report,
    reports,
    send,
)
from tests.node.tasks.scripted_chassis import (
    EXEC_TASK,
    ROBOT_STATE,
    TASK_PROC,
    Body,
)

pytestmark = pytest.mark.usefixtures("normal")

every_sequence = pytest.mark.parametrize("sequence", SEQUENCES)


ANSWERS = ("first", "after the state", "after a report", "last", "never")
NOISES = ("none", "twice", "empty before", "other tasks", "next task")


@pytest.mark.parametrize(
    ("sequence", "answer", "noise"),
    [
        (sequence, answer, NOISES[(number + other) % len(NOISES)])
        for number, sequence in enumerate(SEQUENCES)
        for other, answer in enumerate(ANSWERS)
    ],
)
def test_goal_ends_with_the_task(
    robot: ScriptedRobot, sequence: str, answer: str, noise: str
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
                robot.chassis.answer()
            if push is not None:
                robot.chassis.push(*push)

    robot.chassis.expect(EXEC_TASK, play)
    expected = pushed[:-1] if noise == "twice" else pushed  # the goal ends with the first end
    assert_ended(send(robot, task_id), expected)


@pytest.mark.parametrize(
    ("sequence", "seen", "told"),
    [
        (sequence, seen, ("by the history", "by nobody")[(number + other) % 2])
        for number, sequence in enumerate(SEQUENCES)
        for other, seen in enumerate(
            ("an empty report", "another task", "only the state", "nothing")
        )
    ],
)
def test_an_end_that_was_not_seen_is_noticed(
    robot: ScriptedRobot, sequence: str, seen: str, told: str
) -> None:
    task_id = next(IDS)
    first = report(task_id, (3, NAV, RUNS))
    *_, end = reports(task_id, sequence)
    goal = robot.start(task_id, first)

    def finish() -> None:
        robot.chassis.keep(TASK_PROC, end)
        if told == "by nobody":
            robot.chassis.forget_history()
        now = report(task_id * 100 + 53, (3, NAV, RUNS)) if seen == "another task" else empty()
        tell = (
            robot.chassis.push
            if seen in ("an empty report", "another task")
            else robot.chassis.keep
        )
        tell(TASK_PROC, now)
        if seen != "nothing":
            robot.chassis.push(ROBOT_STATE, IDLE)

    robot.chassis.at_once(finish)
    if told == "by the history":
        assert_ended(goal, [first, end])
    else:
        assert goal.wait_aborted("does not know the task any more").state.value == FAILED


@every_sequence
def test_goal_goes_on_after_a_lost_link(robot: ScriptedRobot, sequence: str) -> None:
    task_id = next(IDS)
    expected = [report(task_id, (3, NAV, RUNS)), *reports(task_id, sequence)[1:]]
    if sequence == "only the end":
        expected = [expected[0], *reports(task_id, sequence)]
    goal = robot.start(task_id, expected[0])
    robot.reconnect()
    robot.chassis.push_all(TASK_PROC, expected[1:])
    assert_ended(goal, expected)


@every_sequence
def test_an_end_without_a_link_is_noticed_after_the_reconnect(
    robot: ScriptedRobot, sequence: str
) -> None:
    task_id = next(IDS)
    first, end = report(task_id, (3, NAV, RUNS)), reports(task_id, sequence)[-1]
    goal = robot.start(task_id, first)

    def meanwhile() -> None:
        robot.chassis.keep(TASK_PROC, end)
        robot.chassis.keep(TASK_PROC, empty())

    robot.reconnect(meanwhile)
    assert_ended(goal, [first, end])
