"""The pace of a stream that has a maximum rate."""

from __future__ import annotations

import pytest

from woosh_robot_agent.motion.velocity_driver import Pace

RATE = 10.0


def paced(pace: Pace, arrivals: list[float]) -> list[float]:
    """Send messages that arrive at some times, each when it is due; return the times."""
    times = []
    for arrival in arrivals:
        times.append(max(arrival, pace.due(RATE)))
        pace.sent(times[-1], RATE)
    return times


def test_the_first_message_is_due_at_once() -> None:
    assert paced(Pace(), [7.0]) == [7.0]


def test_messages_at_the_rate_are_not_delayed_by_one_that_is_late() -> None:
    arrivals = [1.0, 1.1, 1.24, 1.3, 1.4]
    assert paced(Pace(), arrivals) == pytest.approx(arrivals)


def test_messages_at_the_rate_are_not_delayed_after_a_late_first_one() -> None:
    arrivals = [1.008, 1.1, 1.2, 1.3, 1.4]
    assert paced(Pace(), arrivals) == pytest.approx(arrivals)


def test_faster_messages_are_sent_at_the_rate() -> None:
    arrivals = [1.0 + 0.01 * number for number in range(21)]
    assert paced(Pace(), arrivals)[-1] == pytest.approx(2.99)  # a tenth of a period early


def test_lateness_is_not_made_up_for() -> None:
    """After a gap, messages that come together are sent at the rate, not in a burst."""
    assert paced(Pace(), [1.0, 1.7, 1.7, 1.7]) == pytest.approx([1.0, 1.7, 1.79, 1.89])


def test_many_late_messages_do_not_exceed_the_rate() -> None:
    pace = Pace()
    arrivals = [1.0 + 0.1 * number + 0.04 * (number % 2) for number in range(100)]
    times = paced(pace, [*arrivals, *arrivals[-1:] * 10])
    assert times[-1] - times[0] >= 0.1 * (len(times) - 1) - 0.05
