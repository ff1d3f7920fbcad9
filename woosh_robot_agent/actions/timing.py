"""The timing of goals."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class GoalTiming:
    """Timeouts and poll periods of a goal; all times are in seconds."""

    link_timeout: float = 5.0
    """Time without a report after which a goal is given up once the link is lost or the chassis
    falls silent. The parameter `goal_link_timeout` sets it."""
    poll_period: float = 5.0
    """Time without a report after which the chassis is asked, in case a push was lost."""
    poll_haste: float = 0.2
    """Factor on `poll_period` while the goal is in doubt."""
    fruitless_polls: int = 3
    """Number of polls in a row without news after which a goal may be given up."""
    min_cancel_timeout: float = 10.0
    """Lower bound of `cancel_timeout`."""

    @property
    def cancel_timeout(self) -> float:
        """Time without a report, after an accepted cancel, after which a goal is given up."""
        return max(2 * self.link_timeout, self.min_cancel_timeout)


DEFAULT_TIMING = GoalTiming()
"""Timing of all goals, except for `link_timeout`."""
