"""Estimated times of reports that are delayed by known amounts."""

from __future__ import annotations

import random

import pytest

from woosh_robot_agent.ros.standard.odometry import report_time
from woosh_robot_agent.ros.standard.poses import STANDSTILL, Arc, Velocity

PERIOD = 0.204
DRIVE = Velocity(0.5, 0.0, 0.5)


def arc(seconds: float, velocity: Velocity = DRIVE) -> Arc:
    return Arc(velocity.forward * seconds, 0.0, velocity.turn * seconds)


def times(delays: list[float], velocity: Velocity = DRIVE, factor: float = 1.0) -> list[float]:
    """Return the estimated time of each report minus the true one.

    Args:
        delays: delay of each report.
        velocity: velocity of the robot.
        factor: reported speed divided by the true one.
    """
    reported = Velocity(velocity.forward * factor, 0.0, velocity.turn * factor)
    errors = [delays[0]]
    for number, delay in enumerate(delays[1:], 1):
        true = number * PERIOD
        last = errors[-1] + true - PERIOD
        received = max(true + delay, last)
        time = report_time(received, last, arc(PERIOD, velocity), reported, reported)
        errors.append(time - true)
    return errors


@pytest.mark.parametrize("factor", [0.9, 0.95, 1.0, 1.05, 1.1])
def test_without_delays_the_time_is_that_of_receipt(factor: float) -> None:
    """Speeds that are a little wrong do not let the times drift away from those of receipt."""
    assert times([0.0] * 100, factor=factor) == pytest.approx([0.0] * 100, abs=1e-9)


@pytest.mark.parametrize("velocity", [DRIVE, Velocity(-0.5), Velocity(0.0, 0.0, -1.0)])
def test_most_of_a_single_delay_is_corrected(velocity: Velocity) -> None:
    errors = times([0.0] * 5 + [0.1] + [0.0] * 5, velocity)
    assert 0.0 <= errors[5] < 0.05
    assert errors[6:] == pytest.approx([0.0] * 5, abs=1e-9)


def test_a_delay_that_lasts_is_accepted() -> None:
    """An estimate that stays behind would let the pose be predicted too far."""
    errors = times([0.0] * 5 + [0.1] * 30)
    assert errors[-1] == pytest.approx(0.1, abs=0.001)


def test_a_very_long_delay_is_not_corrected() -> None:
    errors = times([0.0] * 5 + [0.5])
    assert errors[-1] == pytest.approx(0.5)


def test_the_estimate_is_never_after_the_receipt_and_never_goes_back() -> None:
    rng = random.Random(1)
    received = last = 0.0
    for _ in range(1000):
        received += rng.choice([0.0, 0.001, PERIOD, 0.3, 3.0])
        velocities = [Velocity(rng.uniform(-1, 1), 0.0, rng.uniform(-1, 1)) for _ in range(2)]
        moved = Arc(rng.uniform(-1, 1), rng.uniform(-1, 1), rng.uniform(-1, 1))
        time = report_time(received, last, moved, *velocities)
        assert last <= time <= received
        last = time


def test_a_robot_that_stood_has_no_known_duration() -> None:
    assert report_time(0.2, 0.0, arc(0.01), STANDSTILL, DRIVE) == 0.2


def test_a_slow_robot_has_no_known_duration() -> None:
    slow = Velocity(0.05)
    assert report_time(0.3, 0.0, arc(0.2, slow), slow, slow) == 0.3
