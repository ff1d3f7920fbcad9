"""Cases in which a goal is given up or not, with the time and the reason, on a simulated clock."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from woosh_robot_agent.ros.actions.giving_up import GiveUp
from woosh_robot_agent.ros.actions.goal import GoalTiming

TIMING = GoalTiming(
    link_timeout=8.0,
    fruitless_polls=3,
    first_report_timeout=4.0,
    unknown_polls=2,
    min_cancel_timeout=10.0,
)
"""Deadlines of 8 s, of 16 s after an accepted cancel, and of 4 s for the first report."""


@dataclass
class Case:
    """Events of a goal, each with its time in seconds; then the time and the reason of its end."""

    name: str
    happens: list[tuple[object, ...]]
    end: float | None
    why: str = ""


UNANSWERED = ("poll_unanswered", "no answer")
TOLD = ("poll_answered", True)
NOTHING = ("poll_answered", False)
UNKNOWN = ("poll_unknown", "not known", True)
"""The chassis does not know the goal any more."""
NOT_YET = ("poll_unknown", "not known", False)
"""The chassis does not know the goal yet."""

CASES = [
    Case("nothing happens: the wait is not limited", [], None),
    Case("a report", [(1, "report")], None),
    # A goal that the chassis does not know
    Case("unknown once: a report may be on its way", [(1, *UNKNOWN)], None),
    Case("unknown twice", [(1, *UNKNOWN), (2, *UNKNOWN)], 2, "not known"),
    Case(
        "unknown, and a report after each poll",
        [(1, *UNKNOWN), (2, "report"), (3, *UNKNOWN), (4, "report")],
        None,
    ),
    Case("unknown, then known again", [(1, *UNKNOWN), (2, *TOLD), (3, *UNKNOWN)], None),
    Case(
        "unknown before the first report",
        [(t, *NOT_YET) for t in range(5, 12)],
        9,
        "not known",
    ),
    Case(
        "unknown before the first report, which then comes",
        [*((t, *NOT_YET) for t in (5, 6, 7, 8)), (8.5, "report"), (10, *TOLD)],
        None,
    ),
    Case(
        "unknown, and the link lost meanwhile: its deadline counts too",
        [(1, *NOT_YET), (2, "link_lost", "reset")],
        10,
        "the link was lost (reset)",
    ),
    # The link
    Case("link lost", [(1, "link_lost", "reset")], 9, "the link was lost (reset)"),
    Case(
        "link restored: the wait for a report starts again",
        [(1, "link_lost", "reset"), (7, "link_restored")],
        15,
        "the link was lost, and no report on the goal came for 8 s",
    ),
    Case(
        "link restored, then a report",
        [(1, "link_lost", "reset"), (7, "link_restored"), (8, "report")],
        None,
    ),
    Case(
        "link lost, then a report that was in transit: the link is still lost",
        [(1, "link_lost", "reset"), (2, "report")],
        9,
        "the link was lost (reset)",
    ),
    Case(
        "link lost again: the later loss counts",
        [(1, "link_lost", "one"), (2, "link_restored"), (3, "link_lost", "two")],
        11,
        "(two)",
    ),
    Case(
        "link restored, and polls without news: the link's deadline counts",
        [(0, "link_lost", "reset"), (1, "link_restored"), *((t, *NOTHING) for t in range(2, 9))],
        9,
        "the link was lost",
    ),
    Case(
        "polls without an answer while the link is lost do not count",
        [
            (1, *UNANSWERED),
            (5, *UNANSWERED),
            (6, "link_lost", "reset"),
            (7, "link_restored"),
            (10, *UNANSWERED),
        ],
        15,
        "the link was lost",
    ),
    # The answer to the start request
    Case("answer lost", [(1, "answer_lost", "late")], 9, "no answer to the goal: late"),
    Case("answer lost, then a report", [(1, "answer_lost", "late"), (5, "report")], None),
    Case(
        "answer lost, then the link",
        [(1, "answer_lost", "late"), (5, "link_lost", "reset")],
        13,
        "the link was lost",
    ),
    # A silent chassis
    Case("silence", [(1, "chassis_silent", "late")], 9, "the chassis does not answer (late)"),
    Case(
        "silence goes on: the first poll counts",
        [(1, "chassis_silent", "late"), (5, "chassis_silent", "later")],
        9,
        "(late)",
    ),
    Case("silence, then an answer", [(1, "chassis_silent", "late"), (5, *TOLD)], None),
    Case("silence, then a report", [(1, "chassis_silent", "late"), (5, "report")], None),
    Case(
        "silence, then answers without news: the first of them counts as the first fruitless poll",
        [(1, "chassis_silent", "late"), *((t, *NOTHING) for t in (2, 3, 10))],
        10,
        "3 polls in a row",
    ),
    Case(
        "an answer does not lift the deadline of a lost link",
        [(1, "chassis_silent", "late"), (2, "link_lost", "reset"), (3, *TOLD)],
        10,
        "the link was lost",
    ),
    Case(
        "silence after a lost answer: the deadline of the lost answer stays",
        [(1, "answer_lost", "late"), (4, "chassis_silent", "later"), (5, *TOLD)],
        9,
        "no answer to the goal",
    ),
    # Polls without news
    Case(
        "polls without an answer",
        [(t, *UNANSWERED) for t in (1, 5, 9)],
        9,
        "3 polls in a row brought no report on it (no answer)",
    ),
    Case("too few polls, over a long time", [(1, *UNANSWERED), (60, *UNANSWERED)], None),
    Case("many polls, over too short a time", [(t / 10, *UNANSWERED) for t in range(70)], None),
    Case(
        "answers without news of a goal never reported on",
        [(t, *NOTHING) for t in (1, 2, 3, 9)],
        9,
        "4 polls in a row brought no report on it (its answers do not mention it)",
    ),
    Case(
        "answers without news of a goal reported on once: reports on long steps are rare",
        [(t, *TOLD) for t in range(1, 60)],
        None,
    ),
    Case(
        "an answer between unanswered polls: the count starts again",
        [(1, *UNANSWERED), (5, *UNANSWERED), (8, *TOLD), (9, *UNANSWERED), (13, *UNANSWERED)],
        None,
    ),
    Case(
        "a report between unanswered polls: the count starts again",
        [(1, *UNANSWERED), (5, *UNANSWERED), (8, "report"), (9, *UNANSWERED), (13, *UNANSWERED)],
        None,
    ),
    # An accepted cancel
    Case("cancel accepted", [(1, "cancel_accepted")], 17, "accepted the cancel"),
    Case(
        "cancel accepted, and reports that the goal goes on",
        [(1, "cancel_accepted"), *((t, "report") for t in range(2, 17))],
        17,
        "accepted the cancel, but the goal did not end within 16 s",
    ),
    Case(
        "cancel accepted twice: the first one counts",
        [(1, "cancel_accepted"), (10, "report"), (11, "cancel_accepted")],
        17,
        "accepted the cancel",
    ),
    Case(
        "cancel accepted, then the next task of a set: it needs a cancel of its own",
        [(1, "cancel_accepted"), (5, "part_begun"), (6, "report")],
        None,
    ),
    Case(
        "cancel accepted for two tasks of a set",
        [(1, "cancel_accepted"), (5, "part_begun"), (6, "report"), (7, "cancel_accepted")],
        23,
        "accepted the cancel",
    ),
    Case(
        "cancel accepted, the link lost for long, then a report that the goal goes on",
        [(1, "cancel_accepted"), (12, "link_lost", "reset"), (18, "link_restored")],
        26,
        "the link was lost",
    ),
    Case(
        "cancel accepted, then the link lost: the link's deadline counts, even if it is later",
        [(1, "cancel_accepted"), (12, "link_lost", "reset")],
        20,
        "the link was lost",
    ),
    Case(
        "cancel accepted, and answers without news",
        [(1, "cancel_accepted"), *((t, *TOLD) for t in range(2, 17))],
        17,
        "accepted the cancel",
    ),
]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_goal_is_given_up_in_time_and_with_its_reason(case: Case) -> None:
    now = 0.0
    give_up = GiveUp(TIMING, lambda: now)
    for time, method, *arguments in case.happens:
        assert give_up.deadline > time, "given up too early"  # type: ignore[operator]
        now = time  # type: ignore[assignment]
        reason = getattr(give_up, method)(*arguments)  # type: ignore[call-overload]
        if reason is not None:
            break
        assert give_up.overdue() is None
    else:
        if case.end is None:
            assert give_up.deadline == float("inf")
            return
        now = give_up.deadline
        reason = give_up.overdue()
    assert (now, case.why in str(reason)) == (case.end, True), reason
    # a goal that the chassis does not know is not running
    assert case.why == "not known" or "`stop` service" in str(reason)


@pytest.mark.parametrize(
    ("method", "arguments", "is_unknown"),
    [
        ("link_lost", ["reset"], True),
        ("answer_lost", ["late"], True),
        ("chassis_silent", ["late"], True),
        ("poll_unanswered", ["late"], False),
        ("cancel_accepted", [], False),
    ],
)
def test_state_is_unknown_until_a_report(
    method: str, arguments: list[str], is_unknown: bool
) -> None:
    """Then the goal is polled more often."""
    give_up = GiveUp(TIMING, lambda: 0.0)
    getattr(give_up, method)(*arguments)
    assert give_up.is_state_unknown is is_unknown
    give_up.report()
    assert give_up.is_state_unknown is (method == "link_lost")


def test_cancel_timeout_has_a_lower_bound() -> None:
    assert GoalTiming(link_timeout=1.0, min_cancel_timeout=10.0).cancel_timeout == 10.0
    assert GoalTiming(link_timeout=8.0, min_cancel_timeout=10.0).cancel_timeout == 16.0
