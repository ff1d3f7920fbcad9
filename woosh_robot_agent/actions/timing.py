"""The timing of goals."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class GoalTiming:
    """Timeouts and poll periods of a goal; all times are in seconds."""

    link_timeout: float = 15.0
    """Maximum wait for a report after the link was lost or the chassis fell silent. Set by the
    parameter `goal_link_timeout`. Most losses on a factory's Wi-Fi last 4 to 9 s."""
    poll_period: float = 5.0
    """Time without a report after which the chassis is polled, in case a push was lost."""
    in_doubt_poll_factor: float = 0.2
    """Factor that shortens `poll_period` while the state of the goal is in doubt."""
    fruitless_polls: int = 3
    """Number of consecutive polls without a report after which a goal may be given up."""
    first_report_timeout: float = 5.0
    """Time after the first poll during which the chassis may not know a goal that it has accepted
    and has not reported on. Real robots report 0.5 to 1.2 s after the acceptance."""
    unknown_polls: int = 2
    """Number of consecutive polls that must find the goal unknown to the chassis before it ends."""
    cancel_report_timeout: float = 2.0
    """Maximum wait for the report that something was cancelled, if nothing is known to run. Real
    robots show the effect of an order within 1.2 s."""
    result_delay: float = 0.1
    """Minimum time from the last but one piece of feedback to the result. rclpy's action client
    reads one piece of feedback in each turn, the last one perhaps together with the result, and
    drops those that it has not read by then."""
    min_cancel_timeout: float = 10.0
    """Lower bound of `cancel_timeout`."""

    @property
    def cancel_timeout(self) -> float:
        """Maximum wait for the end of a goal after an accepted cancel."""
        return max(2 * self.link_timeout, self.min_cancel_timeout)


DEFAULT_TIMING = GoalTiming()
"""Timing of all goals, except for `link_timeout`."""
