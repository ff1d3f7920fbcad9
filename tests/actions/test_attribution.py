"""Attribution of reports to a goal, although several goals can have the same name."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import pytest

from woosh_robot_agent.ros.actions.goal import Attribution, Outcome, Phase

STARTING, REPORTED = Phase.STARTING, Phase.REPORTED
UNCONFIRMED, RUNNING = Phase.UNCONFIRMED, Phase.RUNNING
PROGRESS = None
SUCCEEDED, ABORTED, CANCELED = Outcome
ANY = tuple(Outcome)

MINE, NOT_MINE = True, False
WANTED = True
"""The client has asked to cancel the goal."""


@dataclass
class Case:
    """A goal, and the reports under its name in the order of their arrival.

    Each report has the goal's phase, the outcome, MINE or NOT_MINE, and WANTED if the goal is
    to be cancelled.
    """

    name: str
    reports: list[tuple[object, ...]]
    predecessors: int = 0
    inherited: Iterable[Outcome] = field(default=())


CASES = [
    # A new name: a task with a new id
    Case("new name, progress before the answer", [(STARTING, PROGRESS, MINE)]),
    Case("new name, end before the answer", [(STARTING, SUCCEEDED, MINE)]),
    Case("new name, cancelled before the answer", [(STARTING, CANCELED, MINE)]),
    Case("new name, progress after the answer", [(RUNNING, PROGRESS, MINE)]),
    Case("new name, end after the answer", [(RUNNING, ABORTED, MINE)]),
    Case("new name, answer lost", [(UNCONFIRMED, PROGRESS, MINE)]),
    Case("new name, answer lost, end", [(UNCONFIRMED, SUCCEEDED, MINE)]),
    # A reused name while nothing runs: an action, after the cancel of the last goal
    Case(
        "idle action, progress before the answer",
        [(STARTING, PROGRESS, MINE), (REPORTED, PROGRESS, MINE)],
        inherited=[CANCELED],
    ),
    Case("idle action, succeeds", [(RUNNING, SUCCEEDED, MINE)], inherited=[CANCELED]),
    Case("idle action, fails", [(RUNNING, ABORTED, MINE)], inherited=[CANCELED]),
    Case(
        "idle action, a late cancel of the last goal, then its own",
        [(RUNNING, CANCELED, NOT_MINE), (RUNNING, CANCELED, MINE)],
        inherited=[CANCELED],
    ),
    Case(
        "idle action, cancelled after progress",
        [(RUNNING, PROGRESS, MINE), (RUNNING, CANCELED, MINE)],
        inherited=[CANCELED],
    ),
    Case("idle action, cancel wanted", [(RUNNING, CANCELED, MINE, WANTED)], inherited=[CANCELED]),
    Case(
        "idle action, cancel wanted but not accepted yet",
        [(STARTING, CANCELED, NOT_MINE, WANTED)],
        inherited=[CANCELED],
    ),
    Case(
        "idle action, end before the answer",
        [(STARTING, SUCCEEDED, NOT_MINE), (RUNNING, SUCCEEDED, MINE)],
        inherited=[CANCELED],
    ),
    Case(
        "idle action, progress and end before the answer may be on another program's action",
        [(STARTING, PROGRESS, MINE), (REPORTED, SUCCEEDED, NOT_MINE), (RUNNING, SUCCEEDED, MINE)],
        inherited=[CANCELED],
    ),
    Case(
        "idle action, progress and cancel before the answer, cancel wanted",
        [(STARTING, PROGRESS, MINE), (REPORTED, CANCELED, MINE, WANTED)],
        inherited=[CANCELED],
    ),
    Case(
        "idle action, answer lost: the first end may be an earlier one, the second is its own",
        [(UNCONFIRMED, SUCCEEDED, NOT_MINE), (UNCONFIRMED, SUCCEEDED, MINE)],
        inherited=[CANCELED],
    ),
    # A reused name whose earlier goal has ended: a task with a used id
    Case("used id, progress before the answer", [(STARTING, PROGRESS, MINE)], inherited=ANY),
    *(
        Case(
            f"used id, the old end is repeated before the answer: {old.value}",
            [(STARTING, old, NOT_MINE), (RUNNING, PROGRESS, MINE), (RUNNING, old, MINE)],
            inherited=ANY,
        )
        for old in ANY
    ),
    Case(
        "used id, the old end is repeated after the answer",
        [(RUNNING, SUCCEEDED, NOT_MINE), (RUNNING, SUCCEEDED, MINE)],
        inherited=ANY,
    ),
    Case(
        "used id, after progress that follows the answer every end is its own",
        [(RUNNING, PROGRESS, MINE), (RUNNING, SUCCEEDED, MINE)],
        inherited=ANY,
    ),
    Case("used id, cancel wanted", [(RUNNING, CANCELED, MINE, WANTED)], inherited=ANY),
    # One earlier goal with the name may still run
    Case(
        "one predecessor, reports before the answer are on the predecessor",
        [(STARTING, PROGRESS, NOT_MINE), (STARTING, ABORTED, NOT_MINE), (RUNNING, ABORTED, MINE)],
        predecessors=1,
        inherited=ANY,
    ),
    Case(
        "one predecessor, progress after its end but before the answer",
        [(STARTING, CANCELED, NOT_MINE), (STARTING, PROGRESS, MINE), (REPORTED, SUCCEEDED, MINE)],
        predecessors=1,
        inherited=ANY,
    ),
    *(
        Case(
            f"one predecessor, its end comes after the answer: {end.value}",
            [(RUNNING, end, NOT_MINE), (RUNNING, end, MINE)],
            predecessors=1,
            inherited=ANY,
        )
        for end in ANY
    ),
    Case(
        "one predecessor, its cancel comes after progress",
        [(RUNNING, PROGRESS, MINE), (RUNNING, CANCELED, NOT_MINE), (RUNNING, CANCELED, MINE)],
        predecessors=1,
        inherited=ANY,
    ),
    Case(
        "one predecessor, another end after progress",
        [(RUNNING, PROGRESS, MINE), (RUNNING, SUCCEEDED, MINE)],
        predecessors=1,
        inherited=ANY,
    ),
    Case(
        "one predecessor, cancel wanted",
        [(RUNNING, PROGRESS, MINE), (RUNNING, CANCELED, MINE, WANTED)],
        predecessors=1,
        inherited=ANY,
    ),
    Case(
        "one predecessor, answer lost: progress is not its own before the predecessor's end",
        [
            (UNCONFIRMED, PROGRESS, NOT_MINE),
            (UNCONFIRMED, CANCELED, NOT_MINE),
            (UNCONFIRMED, PROGRESS, MINE),
            (RUNNING, SUCCEEDED, MINE),
        ],
        predecessors=1,
        inherited=ANY,
    ),
    # Several earlier goals with the name may still run
    Case(
        "two predecessors, each with an end before the answer",
        [
            (STARTING, CANCELED, NOT_MINE),
            (STARTING, PROGRESS, NOT_MINE),
            (STARTING, CANCELED, NOT_MINE),
            (STARTING, PROGRESS, MINE),
            (REPORTED, CANCELED, MINE),
        ],
        predecessors=2,
        inherited=ANY,
    ),
    Case(
        "two predecessors, an end after the answer: the chassis runs one at a time",
        [(RUNNING, CANCELED, NOT_MINE), (RUNNING, CANCELED, MINE)],
        predecessors=2,
        inherited=ANY,
    ),
]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_report_belongs_to_the_right_goal(case: Case) -> None:
    attribution = Attribution(case.predecessors, case.inherited)
    has_report = False
    for phase, outcome, mine, *wanted in case.reports:
        found = attribution.attribute(outcome, phase, cancel_requested=bool(wanted))  # type: ignore[arg-type]
        assert found is mine, (phase, outcome)
        has_report = has_report or bool(mine)
        assert attribution.has_report is has_report


ADMITTED, REPEATED = True, False
BEFORE, ANOTHER = "how the earlier goal ended", "another end"

POLLS = {
    "progress": (BEFORE, [(RUNNING, "on its way", PROGRESS, ADMITTED)]),
    "progress, answer lost": (BEFORE, [(UNCONFIRMED, "on its way", PROGRESS, ADMITTED)]),
    "the earlier end, then the same again: the goal ended in the same way": (
        BEFORE,
        [(RUNNING, BEFORE, SUCCEEDED, REPEATED), (RUNNING, BEFORE, SUCCEEDED, ADMITTED)],
    ),
    "another end": (BEFORE, [(RUNNING, ANOTHER, SUCCEEDED, ADMITTED)]),
    "an end, no earlier end known": (None, [(RUNNING, ANOTHER, SUCCEEDED, ADMITTED)]),
    "the earlier end, answer lost: it proves nothing, however often it is repeated": (
        BEFORE,
        [(UNCONFIRMED, BEFORE, SUCCEEDED, REPEATED), (UNCONFIRMED, BEFORE, SUCCEEDED, REPEATED)],
    ),
    "another end, answer lost": (BEFORE, [(UNCONFIRMED, ANOTHER, SUCCEEDED, ADMITTED)]),
    "an end, no earlier end known, answer lost": (
        None,
        [(UNCONFIRMED, ANOTHER, SUCCEEDED, REPEATED), (UNCONFIRMED, ANOTHER, SUCCEEDED, REPEATED)],
    ),
}


@pytest.mark.parametrize(("previous", "polls"), POLLS.values(), ids=POLLS.keys())
def test_polled_report_is_admitted_unless_it_may_repeat_an_earlier_end(
    previous: str | None, polls: list[tuple[Phase, str, Outcome | None, bool]]
) -> None:
    attribution = Attribution(repeats_ends=True, previous=previous)
    for phase, report, outcome, admitted in polls:
        assert attribution.admit_polled(report, outcome, phase) is admitted, (phase, report)


def test_everything_is_admitted_after_a_report_on_the_goal() -> None:
    attribution = Attribution(repeats_ends=True, previous=BEFORE)
    assert attribution.attribute(PROGRESS, RUNNING, cancel_requested=False)
    assert attribution.admit_polled(BEFORE, SUCCEEDED, RUNNING)


def test_everything_is_admitted_if_the_chassis_does_not_repeat_ends() -> None:
    assert Attribution().admit_polled(ANOTHER, SUCCEEDED, UNCONFIRMED)
