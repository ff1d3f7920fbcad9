"""Attribution of reports: is a report on this goal, or on an earlier goal of the same name?

Reports name a task by its id, which a client may use again, and any other action only by its type.
So a report under the name of a goal may be on an earlier goal, even on one of another program.
"""

from __future__ import annotations

from collections.abc import Iterable

from woosh_robot_agent.actions.outcome import Outcome
from woosh_robot_agent.actions.phase import Phase


class Attribution:
    """Decides which reports under the name of a goal are on that goal.

    Each decision may change the later ones, so ask once per report and in the order of the reports.

    Args:
        predecessors: number of earlier goals of the name that may still be running.
        inherited: outcomes that, as the first end reported, belong to an earlier goal.
        repeats_ends: True if the chassis, when polled, tells the last end of the name even if it
            is that of an earlier goal.
        previous: the chassis's last report under the name before this goal, if it is known; only
            used with `repeats_ends`.
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
        """True once a report was found to be on this goal."""
        self._predecessors = predecessors
        self._inherited = frozenset(inherited)
        self._repeats_ends = repeats_ends
        self._previous = previous

    def is_mine(self, outcome: Outcome | None, phase: Phase, cancel_requested: bool) -> bool:
        """Return True if a report is on this goal.

        Args:
            outcome: outcome that it reports, None if the goal goes on.
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
        """Return True if a report that answers a poll may be on this goal; `is_mine` decides.

        Args:
            report: the report.
            outcome: outcome that it reports, None if the goal goes on.
            phase: phase of this goal.
        """
        if self.heard or outcome is None or not self._repeats_ends:
            return True
        previous = self._previous
        if phase.accepted:
            # the same end told a second time is this goal's, which ended in the same way
            self._previous = None
            return report != previous
        return previous is not None and report != previous

    def _progress_is_mine(self, phase: Phase) -> bool:
        if self._predecessors and not phase.accepted:
            return False
        if phase.answered:
            # the earlier goals are over; only the cancel of the last one may still be on its way
            self._inherited = frozenset([Outcome.CANCELED] if self._predecessors else [])
        return True

    def _end_is_mine(self, outcome: Outcome, phase: Phase, cancel_requested: bool) -> bool:
        inherited = self._inherited
        if phase.answered or self._predecessors < 2:
            self._inherited = frozenset()
            self._predecessors = 0
        else:  # each of the earlier goals has an end of its own
            self._predecessors -= 1
        if phase.accepted and outcome is Outcome.CANCELED and cancel_requested:
            return True
        if phase.accepted and phase.answered:
            return outcome not in inherited
        # an end before the answer is that of an earlier goal, if there was one; polling tells
        return not inherited
