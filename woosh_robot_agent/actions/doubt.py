"""How long a goal waits for a chassis that, on a link that is well, tells nothing of it."""

from __future__ import annotations

from math import inf

CANCEL_PATIENCE = 10.0
"""s without a report after which a cancel that the chassis took is taken to bring no end."""
REMEDY = "look, and stop it by the service `stop`"
_QUESTIONS = 3
"""Questions in a row that may bring nothing."""


class Doubt:
    """Whether enough was done to hear of a goal; all times are the event loop's, in s.

    Args:
        patience: s that have to go by, whatever else does, before the goal is given up.
    """

    def __init__(self, patience: float) -> None:
        self._patience = patience
        self._in_vain = 0
        self._since = 0.0
        self._cancel_patience = max(2 * patience, CANCEL_PATIENCE)
        self.cancel_due = inf
        """When the end that a cancel should bring is overdue."""

    def heard(self, now: float) -> None:
        """The chassis reported on the goal, though not the end."""
        self.answered()
        if self.cancel_due < inf:
            self.cancel_taken(now)

    def answered(self) -> None:
        """It answered a question, and that is enough for now."""
        self._in_vain = 0

    def in_vain(self, now: float, why: str) -> str | None:
        """It told nothing on being asked: why the goal has to be given up, if it has."""
        if not self._in_vain:
            self._since = now
        self._in_vain += 1
        if self._in_vain < _QUESTIONS or now - self._since < self._patience:
            return None
        return (
            f"the chassis took the goal, but {self._in_vain} questions in a row brought no report "
            f"on it ({why}); the robot may be doing it: {REMEDY}"
        )

    def cancel_taken(self, now: float) -> None:
        """It accepted a cancel: from now on its end is awaited."""
        self.cancel_due = now + self._cancel_patience

    def uncancelled(self, now: float) -> str | None:
        """Why a goal whose cancel was taken has to be given up, if it has."""
        if now < self.cancel_due:
            return None
        return (
            "the chassis accepted the cancel, but nothing was heard of the goal for "
            f"{self._cancel_patience:g} s; the robot may go on with it: {REMEDY}"
        )
