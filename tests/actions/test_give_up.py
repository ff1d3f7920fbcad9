"""When a goal is given up and why, on a simulated clock; and a cancel that is not repeated.

tests/node/test_cancel.py has when cancels are sent and repeated.
"""

from __future__ import annotations

import asyncio
from math import inf
from types import SimpleNamespace
from typing import Any

import pytest

from woosh_robot_agent.ros.actions.giving_up import Cancellation, GiveUp
from woosh_robot_agent.ros.actions.goal import GoalTiming

TIMING = GoalTiming(
    link_timeout=8.0,
    fruitless_polls=3,
    first_report_timeout=4.0,
    unknown_polls=2,
    min_cancel_timeout=10.0,
)
"""Deadlines of 8 s, of 16 s after an accepted cancel, and of 4 s for the first report."""


UNANSWERED = ("poll_fruitless", "no answer")
TOLD = ("poll_answered", True)
NOTHING = ("poll_answered", False)
UNKNOWN = ("poll_unknown", "not known", True)
"""The chassis does not know the goal any more."""
NOT_YET = ("poll_unknown", "not known", False)
"""The chassis does not know the goal yet."""

GOES_ON = {
    "nothing happens: the wait is not limited": [],
    "a report": [(1, "report")],
    "unknown, then known again": [(1, *UNKNOWN), (2, *TOLD), (3, *UNKNOWN)],
    "unknown before the first report, which then comes": [
        *((t, *NOT_YET) for t in (5, 6, 7, 8)),
        (8.5, "report"),
        (10, *TOLD),
    ],
    "answer lost, then a report": [(1, "answer_lost", "late"), (5, "report")],
    "silence, then an answer": [(1, "chassis_silent", "late"), (5, *TOLD)],
    "too few polls, over a long time": [(1, *UNANSWERED), (60, *UNANSWERED)],
    "many polls, over too short a time": [(t / 10, *UNANSWERED) for t in range(70)],
    "answers without news of a goal reported on once: reports on long steps are rare": [
        (t, *TOLD) for t in range(1, 60)
    ],
    "an answer between unanswered polls: the count starts again": [
        (1, *UNANSWERED),
        (5, *UNANSWERED),
        (8, *TOLD),
        (9, *UNANSWERED),
        (13, *UNANSWERED),
    ],
    "cancel accepted, then the next task of a set: it needs a cancel of its own": [
        (1, "cancel_accepted"),
        (5, "part_begun"),
        (6, "report"),
    ],
}
"""Events of a goal that is not given up, each with its time in seconds."""

ENDS = {
    "unknown twice": ([(1, *UNKNOWN), (2, *UNKNOWN)], 2, "not known"),
    "unknown before the first report": ([(t, *NOT_YET) for t in range(5, 12)], 9, "not known"),
    "unknown, and the link lost meanwhile: its deadline counts too": (
        [(1, *NOT_YET), (2, "link_lost", "reset")],
        10,
        "the link was lost (reset)",
    ),
    # The link
    "link restored: the wait for a report starts again": (
        [(1, "link_lost", "reset"), (7, "link_restored")],
        15,
        "the link was lost, and no report on the goal came for 8 s",
    ),
    "link lost, then a report that was in transit: the link is still lost": (
        [(1, "link_lost", "reset"), (2, "report")],
        9,
        "the link was lost (reset)",
    ),
    "link restored, and polls without news: the link's deadline counts": (
        [(0, "link_lost", "reset"), (1, "link_restored"), *((t, *NOTHING) for t in range(2, 9))],
        9,
        "the link was lost",
    ),
    "polls without an answer while the link is lost do not count": (
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
    "answer lost, then the link": (
        [(1, "answer_lost", "late"), (5, "link_lost", "reset")],
        13,
        "the link was lost",
    ),
    # A silent chassis
    "silence goes on: the first poll counts": (
        [(1, "chassis_silent", "late"), (5, "chassis_silent", "later")],
        9,
        "(late)",
    ),
    "silence, then answers without news: the first of them counts as the first fruitless poll": (
        [(1, "chassis_silent", "late"), *((t, *NOTHING) for t in (2, 3, 10))],
        10,
        "3 polls in a row",
    ),
    "an answer does not lift the deadline of a lost link": (
        [(1, "chassis_silent", "late"), (2, "link_lost", "reset"), (3, *TOLD)],
        10,
        "the link was lost",
    ),
    "silence after a lost answer: the deadline of the lost answer stays": (
        [(1, "answer_lost", "late"), (4, "chassis_silent", "later"), (5, *TOLD)],
        9,
        "no answer to the goal",
    ),
    # Polls without news
    "polls without an answer": (
        [(t, *UNANSWERED) for t in (1, 5, 9)],
        9,
        "3 polls in a row brought no report on it (no answer)",
    ),
    "answers without news of a goal never reported on": (
        [(t, *NOTHING) for t in (1, 2, 3, 9)],
        9,
        "4 polls in a row brought no report on it (its answers do not mention it)",
    ),
    # An accepted cancel
    "cancel accepted, and reports that the goal goes on": (
        [(1, "cancel_accepted"), *((t, "report") for t in range(2, 17))],
        17,
        "accepted the cancel, but the goal did not end within 16 s",
    ),
    "cancel accepted twice: the first one counts": (
        [(1, "cancel_accepted"), (10, "report"), (11, "cancel_accepted")],
        17,
        "accepted the cancel",
    ),
    "cancel accepted for two tasks of a set": (
        [(1, "cancel_accepted"), (5, "part_begun"), (6, "report"), (7, "cancel_accepted")],
        23,
        "accepted the cancel",
    ),
    "cancel accepted, the link lost for long, then a report that the goal goes on": (
        [(1, "cancel_accepted"), (12, "link_lost", "reset"), (18, "link_restored")],
        26,
        "the link was lost",
    ),
}
"""Events of a goal that is given up; then the time and the reason of its end."""


def happen(happens: list[tuple[Any, ...]]) -> tuple[GiveUp, float, str | None]:
    """Let events happen until one gives up; return the object, the time and the reason, if any."""
    now = 0.0
    give_up = GiveUp(TIMING, lambda: now)
    for time, method, *arguments in happens:
        assert give_up.deadline > time, "given up too early"
        now = time
        reason: str | None = getattr(give_up, method)(*arguments)
        if reason is not None:
            return give_up, now, reason
        assert give_up.overdue() is None
    now = give_up.deadline
    return give_up, now, give_up.overdue() if now < inf else None


@pytest.mark.parametrize("happens", GOES_ON.values(), ids=GOES_ON)
def test_goal_is_not_given_up(happens: list[tuple[Any, ...]]) -> None:
    give_up, _, reason = happen(happens)
    assert (give_up.deadline, reason) == (inf, None)


@pytest.mark.parametrize(("happens", "end", "why"), ENDS.values(), ids=ENDS)
def test_goal_is_given_up_in_time_and_with_its_reason(
    happens: list[tuple[Any, ...]], end: float, why: str
) -> None:
    _, now, reason = happen(happens)
    assert (now, why in str(reason)) == (end, True), reason
    # a goal that the chassis does not know is not running
    assert why == "not known" or "`stop` service" in str(reason)


@pytest.mark.parametrize(
    ("method", "arguments", "is_unknown"),
    [
        ("link_lost", ["reset"], True),
        ("answer_lost", ["late"], True),
        ("chassis_silent", ["late"], True),
        ("poll_fruitless", ["late"], False),
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


class Chassis:
    """A chassis that receives cancels, and answers them when the test does."""

    def __init__(self) -> None:
        self.sent: list[asyncio.Future[Any]] = []
        self.has_begun = self.replaced = False
        self.cancellation = Cancellation(
            "task 5",
            self._send,
            self._is_replaced,
            on_accepted=lambda: None,
            on_refused=lambda: None,
            has_begun=lambda: self.has_begun,
        )

    async def _send(self) -> Any:
        self.sent.append(asyncio.get_running_loop().create_future())
        return await self.sent[-1]

    async def _is_replaced(self) -> bool:
        return self.replaced


async def settled() -> None:
    """Let all tasks run until each of them waits."""
    for _ in range(5):
        await asyncio.sleep(0)


async def test_an_early_cancel_is_not_sent_again_if_another_goal_has_replaced_this_one() -> None:
    """It would hit the other goal."""
    chassis = Chassis()
    chassis.cancellation.pending = True
    chassis.cancellation.send_soon()
    await settled()
    chassis.has_begun = chassis.replaced = True
    chassis.sent[-1].set_result(SimpleNamespace(ok=True, msg=""))
    await settled()
    assert len(chassis.sent) == 1
