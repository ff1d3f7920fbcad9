"""Attribution of reports to a goal, although several goals can have the same name."""

from __future__ import annotations

from typing import Any, NamedTuple

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


class Situation(NamedTuple):
    """What may come under the name of a goal besides its own reports."""

    text: str
    predecessors: int
    inherited: tuple[Outcome, ...]


CASES = {
    # a task with a new id
    Situation("new name", 0, ()): {
        "progress before the answer": [(STARTING, PROGRESS, MINE)],
        "end before the answer": [(STARTING, SUCCEEDED, MINE)],
        "end after the answer": [(RUNNING, ABORTED, MINE)],
        "answer lost, end": [(UNCONFIRMED, SUCCEEDED, MINE)],
    },
    # nothing runs, but the cancel of the last goal may still be reported
    Situation("idle action", 0, (CANCELED,)): {
        "fails": [(RUNNING, ABORTED, MINE)],
        "a late cancel of the last goal, then its own": [
            (RUNNING, CANCELED, NOT_MINE),
            (RUNNING, CANCELED, MINE),
        ],
        "cancel wanted": [(RUNNING, CANCELED, MINE, WANTED)],
        "cancel wanted but not accepted yet": [(STARTING, CANCELED, NOT_MINE, WANTED)],
        "end before the answer": [(STARTING, SUCCEEDED, NOT_MINE), (RUNNING, SUCCEEDED, MINE)],
        "progress and end before the answer may be on another program's action": [
            (STARTING, PROGRESS, MINE),
            (REPORTED, SUCCEEDED, NOT_MINE),
            (RUNNING, SUCCEEDED, MINE),
        ],
        "progress and cancel before the answer, cancel wanted": [
            (STARTING, PROGRESS, MINE),
            (REPORTED, CANCELED, MINE, WANTED),
        ],
        "answer lost: the first end may be an earlier one, the second is its own": [
            (UNCONFIRMED, SUCCEEDED, NOT_MINE),
            (UNCONFIRMED, SUCCEEDED, MINE),
        ],
    },
    # a task with the id of a task that has ended
    Situation("used id", 0, ANY): {
        "progress before the answer": [(STARTING, PROGRESS, MINE)],
        **{
            f"the old end is repeated before the answer: {old.value}": [
                (STARTING, old, NOT_MINE),
                (RUNNING, PROGRESS, MINE),
                (RUNNING, old, MINE),
            ]
            for old in ANY
        },
        "after progress that follows the answer every end is its own": [
            (RUNNING, PROGRESS, MINE),
            (RUNNING, SUCCEEDED, MINE),
        ],
        "cancel wanted": [(RUNNING, CANCELED, MINE, WANTED)],
    },
    # an earlier goal with the name may still run
    Situation("one predecessor", 1, ANY): {
        "reports before the answer are on the predecessor": [
            (STARTING, PROGRESS, NOT_MINE),
            (STARTING, ABORTED, NOT_MINE),
            (RUNNING, ABORTED, MINE),
        ],
        "progress after its end but before the answer": [
            (STARTING, CANCELED, NOT_MINE),
            (STARTING, PROGRESS, MINE),
            (REPORTED, SUCCEEDED, MINE),
        ],
        **{
            f"its end comes after the answer: {end.value}": [
                (RUNNING, end, NOT_MINE),
                (RUNNING, end, MINE),
            ]
            for end in ANY
        },
        "its cancel comes after progress": [
            (RUNNING, PROGRESS, MINE),
            (RUNNING, CANCELED, NOT_MINE),
            (RUNNING, CANCELED, MINE),
        ],
        "cancel wanted": [(RUNNING, PROGRESS, MINE), (RUNNING, CANCELED, MINE, WANTED)],
        "cancel wanted before it has begun": [
            (RUNNING, CANCELED, NOT_MINE, WANTED),
            (RUNNING, CANCELED, MINE, WANTED),
        ],
        "answer lost: progress is not its own before the predecessor's end": [
            (UNCONFIRMED, PROGRESS, NOT_MINE),
            (UNCONFIRMED, CANCELED, NOT_MINE),
            (UNCONFIRMED, PROGRESS, MINE),
            (RUNNING, SUCCEEDED, MINE),
        ],
    },
    Situation("two predecessors", 2, ANY): {
        "each with an end before the answer": [
            (STARTING, CANCELED, NOT_MINE),
            (STARTING, PROGRESS, NOT_MINE),
            (STARTING, CANCELED, NOT_MINE),
            (STARTING, PROGRESS, MINE),
            (REPORTED, CANCELED, MINE),
        ],
        "an end after the answer: the chassis runs one at a time": [
            (RUNNING, CANCELED, NOT_MINE),
            (RUNNING, CANCELED, MINE),
        ],
    },
}
"""Reports under the name of a goal in the order of their arrival, by situation and description.

Each report has the goal's phase, the outcome, MINE or NOT_MINE, and WANTED if the goal is to be
cancelled."""


@pytest.mark.parametrize(
    ("situation", "reports"),
    [
        pytest.param(situation, reports, id=f"{situation.text}, {text}")
        for situation, cases in CASES.items()
        for text, reports in cases.items()
    ],
)
def test_report_belongs_to_the_right_goal(
    situation: Situation, reports: list[tuple[Any, ...]]
) -> None:
    attribution = Attribution(situation.predecessors, situation.inherited)
    has_report = False
    for phase, outcome, mine, *wanted in reports:
        found = attribution.attribute(outcome, phase, cancel_requested=bool(wanted))
        assert found is mine, (phase, outcome)
        has_report = has_report or bool(mine)
        assert attribution.has_report is has_report


ADMITTED, REPEATED = True, False
BEFORE, ANOTHER = "how the earlier goal ended", "another end"

# test_link_loss.py has goals whose answer was lost: an earlier end proves nothing
POLLS = {
    "progress": (BEFORE, [(RUNNING, "on its way", PROGRESS, ADMITTED)]),
    "the earlier end, then the same again: the goal ended in the same way": (
        BEFORE,
        [(RUNNING, BEFORE, SUCCEEDED, REPEATED), (RUNNING, BEFORE, SUCCEEDED, ADMITTED)],
    ),
    "another end": (BEFORE, [(RUNNING, ANOTHER, SUCCEEDED, ADMITTED)]),
    "an end, no earlier end known": (None, [(RUNNING, ANOTHER, SUCCEEDED, ADMITTED)]),
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


def test_a_push_that_repeats_an_earlier_end_is_known_after_a_poll_too() -> None:
    attribution = Attribution(repeats_ends=True, previous=BEFORE)
    assert attribution.repeats_previous(BEFORE, SUCCEEDED)
    assert not attribution.admit_polled(BEFORE, SUCCEEDED, RUNNING)
    assert attribution.repeats_previous(BEFORE, SUCCEEDED)
