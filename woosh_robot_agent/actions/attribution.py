"""Attribution of each report to a goal or to an earlier one of the same name.

A report identifies a task by its id, which clients may reuse, and any other action only by its
type. So a report with the name of a goal may belong to an earlier goal, even to one of another
program.
"""

from __future__ import annotations

from collections.abc import Iterable

from woosh_robot_agent.actions.outcome import Outcome
from woosh_robot_agent.actions.phase import Phase


class Attribution:
    """Decides which reports with the name of a goal belong to that goal.

    Each decision may affect later ones: ask once for each report, in the order of arrival.

    Args:
        predecessors: number of earlier goals with the same name that may still be running.
        inherited: outcomes that, if reported first, belong to an earlier goal.
        repeats_ends: True if the chassis answers a poll with the last reported end, even if it
            belongs to an earlier goal.
        previous: the chassis's last report with the name before this goal, if known; only used with
            `repeats_ends`.
    """

    def __init__(
        self,
        predecessors: int = 0,
        inherited: Iterable[Outcome] = (),
        *,
        repeats_ends: bool = False,
        previous: object = None,
    ) -> None:
        self.heard = False
        """True once a report has been attributed to this goal."""
        self._predecessors = predecessors
        self._inherited = frozenset(inherited)
        self._repeats_ends = repeats_ends
        self._previous = previous

    def is_mine(self, outcome: Outcome | None, phase: Phase, cancel_requested: bool) -> bool:
        """Return True if a report belongs to this goal.

        Args:
            outcome: reported outcome; None if the goal is still running.
            phase: phase of this goal.
            cancel_requested: True if the client of this goal asked to cancel it.
        """
        if outcome is None:
            mine = self._progress_is_mine(phase)
        else:
            mine = self._end_is_mine(outcome, phase, cancel_requested)
        self.heard |= mine
        return mine

    def is_news(self, report: object, outcome: Outcome | None, phase: Phase) -> bool:
        """Return True if a report in a poll's answer may belong to this goal; then ask `is_mine`.

        Args:
            report: the report.
            outcome: reported outcome; None if the goal is still running.
            phase: phase of this goal.
        """
        if self.heard or outcome is None or not self._repeats_ends:
            return True
        previous = self._previous
        if phase.accepted:
            # if the same end is reported again, this goal ended like the earlier one
            self._previous = None
            return report != previous
        return previous is not None and report != previous

    def _progress_is_mine(self, phase: Phase) -> bool:
        if self._predecessors and not phase.accepted:
            return False
        if phase.answered:
            # the earlier goals have ended; only the last one's cancel may still be reported
            self._inherited = frozenset([Outcome.CANCELED] if self._predecessors else [])
        return True

    def _end_is_mine(self, outcome: Outcome, phase: Phase, cancel_requested: bool) -> bool:
        inherited = self._inherited
        if phase.answered or self._predecessors < 2:
            self._inherited = frozenset()
            self._predecessors = 0
        else:  # each earlier goal reports its own end
            self._predecessors -= 1
        if phase.accepted and outcome is Outcome.CANCELED and cancel_requested:
            return True
        if phase.accepted and phase.answered:
            return outcome not in inherited
        # an end before the answer belongs to an earlier goal, if any; a poll will tell
        return not inherited
