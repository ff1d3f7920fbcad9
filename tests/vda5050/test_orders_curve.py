"""Points along trajectories, and what is no trajectory."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest

from woosh_robot_agent.vda5050.messages.geometry import curve_defect, curve_points
from woosh_robot_agent.vda5050.messages.order import ControlPoint, Trajectory


def curve(degree: int, knots: list[float], *points: tuple[float, ...]) -> Trajectory:
    return Trajectory(degree, tuple(knots), tuple(ControlPoint(*each) for each in points))


QUARTER = curve(2, [0, 0, 0, 1, 1, 1], (1, 0), (1, 1, math.sqrt(0.5)), (0, 1))


def test_a_rational_curve_of_degree_two_is_an_arc() -> None:
    points = curve_points(QUARTER)
    assert points[0] == pytest.approx((1, 0))
    assert points[-1] == pytest.approx((0, 1))
    assert [math.hypot(*point) for point in points] == pytest.approx([1.0] * len(points))
    assert max(math.dist(before, after) for before, after in pairwise(points)) < 0.3
    assert curve_defect(QUARTER) == ""


def test_degree_one_is_a_polyline_of_its_control_points() -> None:
    corners = [(0.0, 0.0), (5.0, 0.0), (5.0, 4.0)]
    assert curve_points(curve(1, [0, 0, 0.5, 1, 1], *corners)) == tuple(corners)


def test_an_inner_knot_continues_the_curve() -> None:
    whole = curve_points(curve(2, [0, 0, 0, 0.5, 1, 1, 1], (0, 0), (0, 2), (4, 2), (4, 0)))
    assert (2.0, 2.0) in [(round(x, 9), round(y, 9)) for x, y in whole]
    assert whole[-1] == pytest.approx((4, 0))


def test_a_very_long_curve_has_few_points() -> None:
    points = curve_points(curve(2, [0, 0, 0, 1, 1, 1], (0, 0), (500, 0), (500, 500)))
    assert len(points) < 120


@pytest.mark.parametrize("degree", [1, 3, 5])
def test_a_curve_of_many_control_points_has_few_points(degree: int) -> None:
    wave = [(number * 0.02, math.sin(number / 50)) for number in range(500)]
    knots = [0.0] * degree + [float(number) for number in range(501 - degree)]
    long = curve(degree, knots + knots[-1:] * degree, *wave)
    assert curve_defect(long) == ""
    points = curve_points(long)
    assert (points[0], points[-1]) == (wave[0], pytest.approx(wave[-1]))
    assert len(points) < 120  # a chassis may refuse longer paths


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (curve(1, [0, 0, 1], (0, 0), (1, 0)), "4 knots: 3"),
        (curve(3, [0, 0, 1, 1, 1], (0, 0), (1, 0)), "at least 4 control points: 2"),
        (curve(300, [0.0] * 12_301, *[(0, 0)] * 12_000), "its degree is above 5: 300"),
        (curve(1, [0.0] * 602, *[(0, 0)] * 600), "more than 500 control points: 600"),
        (curve(1, [0, 1, 0.5, 1], (0, 0), (1, 0)), "knots decrease"),
        (curve(1, [0, 0, 0, 0], (0, 0), (1, 0)), "all equal"),
        (curve(1, [0, 0, 1, 1], (0, 0, 0.0), (1, 0)), "a weight is below"),
        (curve(2, [0, 0, 0, 1, 1, 1], *[(x, 0, 5e-324) for x in range(3)]), "a weight is below"),
        (curve(1, [0, 0, 1, 1], (1, 2), (1, 2)), "has no length"),
        # the knots leave only the first two points to the curve
        (curve(1, [0, 0, 1, 1, 1], (1, 2), (1, 2), (3, 2)), "has no length"),
    ],
)
def test_a_defect_is_told(bad: Trajectory, reason: str) -> None:
    assert reason in curve_defect(bad)
