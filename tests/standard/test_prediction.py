"""The predicted pose between reports, with times given by the test."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import pairwise

import pytest

from woosh_robot_agent.ros.standard.odometry import HORIZON, Prediction
from woosh_robot_agent.ros.standard.poses import STANDSTILL, Pose2D, Velocity

ROUND = Velocity(0.5, 0.0, 1.0)
"""Velocity on a circle with a radius of 0.5 m."""


def on_circle(angle: float) -> Pose2D:
    """Return the pose after `ROUND` from the origin, by the geometry of the circle."""
    return Pose2D(0.5 * math.sin(angle), 0.5 - 0.5 * math.cos(angle), angle)


@dataclass
class Case:
    """Reports, and the pose and velocity predicted from them."""

    name: str
    reports: list[tuple[float, Pose2D, Velocity]]
    time: float
    pose: Pose2D
    velocity: Velocity
    valid: bool = field(default=True)


CASES = [
    Case(
        "straight on",
        [(0.0, Pose2D(1.0, 2.0, math.pi / 2), Velocity(0.5))],
        0.2,
        Pose2D(1.0, 2.1, math.pi / 2),
        Velocity(0.5),
    ),
    Case(
        "turning on the spot over the end of the range of angles",
        [(0.0, Pose2D(1.0, 0.0, math.pi - 0.1), Velocity(0.0, 0.0, 1.0))],
        0.2,
        Pose2D(1.0, 0.0, -math.pi + 0.1),
        Velocity(0.0, 0.0, 1.0),
    ),
    Case(
        "sideways",
        [(0.0, Pose2D(0.0, 0.0, math.pi / 2), Velocity(0.0, 0.4))],
        0.25,
        Pose2D(-0.1, 0.0, math.pi / 2),
        Velocity(0.0, 0.4),
    ),
    Case(
        "standing, for any time",
        [(0.0, Pose2D(1, 2, 3), STANDSTILL)],
        1e6,
        Pose2D(1, 2, 3),
        STANDSTILL,
    ),
    Case(
        "slowing down at 1 m/s²",
        [(0.0, Pose2D(), Velocity(0.5)), (0.2, Pose2D(0.08), Velocity(0.3))],
        0.4,
        Pose2D(0.12),
        Velocity(0.1),
    ),
    Case(
        "slowing down backwards and in the turn",
        [
            (0.0, Pose2D(), Velocity(-0.3, 0.0, 0.4)),
            (0.2, Pose2D(), Velocity(-0.1, 0.0, 0.2)),
        ],
        0.5,
        Pose2D.from_arc(-0.005, 0.0, 0.02),
        STANDSTILL,
    ),
    Case(
        "speeding up: the speed may have been reached",
        [(0.0, Pose2D(), Velocity(0.1)), (0.2, Pose2D(0.06), Velocity(0.5))],
        0.4,
        Pose2D(0.16),
        Velocity(0.5),
    ),
    Case(
        "reversing: the new direction counts",
        [(0.0, Pose2D(0.1), Velocity(0.2)), (0.2, Pose2D(0.1), Velocity(-0.2))],
        0.4,
        Pose2D(0.06),
        Velocity(-0.2),
    ),
    Case(
        "reports too close to each other to derive a deceleration",
        [(0.0, Pose2D(), Velocity(0.5)), (0.001, Pose2D(), Velocity(0.4))],
        0.201,
        Pose2D(0.08),
        Velocity(0.4),
    ),
    Case(
        "reports too far from each other to derive a deceleration",
        [(0.0, Pose2D(), Velocity(0.5)), (9.0, Pose2D(3.0), Velocity(0.4))],
        9.2,
        Pose2D(3.08),
        Velocity(0.4),
    ),
    Case(
        "no further than the horizon",
        [(0.0, Pose2D(), Velocity(0.5))],
        0.31,
        Pose2D(0.15),
        Velocity(0.5),
        valid=False,
    ),
]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_prediction(case: Case) -> None:
    prediction = Prediction()
    for time, pose, velocity in case.reports:
        prediction.report(pose, velocity, time)
    assert prediction.can_predict(case.time) is case.valid
    pose, velocity = prediction.predict(case.time)
    assert_near(pose, case.pose)
    assert velocity.forward == pytest.approx(case.velocity.forward)
    assert velocity.left == pytest.approx(case.velocity.left)
    assert velocity.turn == pytest.approx(case.velocity.turn)


def assert_near(pose: Pose2D, other: Pose2D) -> None:
    off = pose.seen_from(other)
    assert off.distance < 1e-9, f"{pose} is not {other}"
    assert abs(off.theta) < 1e-9, f"{pose} is not {other}"


def test_a_report_that_confirms_the_prediction_changes_nothing() -> None:
    prediction = Prediction()
    for step in range(100):
        time = 0.05 * step
        if step % 4 == 0:
            prediction.report(on_circle(time), ROUND, time)
        assert_near(prediction.predict(time)[0], on_circle(time))


def test_the_error_of_a_prediction_disappears_within_the_blend() -> None:
    """The robot was predicted 5 cm and 0.1 rad too far: the pose returns in small steps."""
    prediction = Prediction()
    prediction.report(Pose2D(), Velocity(0.5, 0.0, 1.0), 0.0)
    before, _ = prediction.predict(0.2)
    true = Pose2D(0.05, 0.0, 0.1)
    prediction.report(true, STANDSTILL, 0.2)
    off = [prediction.predict(0.2 + 0.01 * step)[0].seen_from(true) for step in range(17)]
    assert_near(true * off[0], before)
    for one, other in pairwise(off):
        assert other.distance <= one.distance
        assert one.distance - other.distance < 0.1 * off[0].distance
        assert -0.1 * off[0].theta < other.theta - one.theta <= 0.0
    assert_near(off[15], Pose2D())
    assert_near(off[16], Pose2D())


def test_the_shorter_way_is_taken_when_a_heading_is_corrected() -> None:
    prediction = Prediction()
    prediction.report(Pose2D(0.0, 0.0, math.pi - 0.01), STANDSTILL, 0.0)
    prediction.predict(0.1)
    prediction.report(Pose2D(0.0, 0.0, -math.pi + 0.01), STANDSTILL, 0.1)
    for step in range(20):
        assert abs(prediction.predict(0.1 + 0.01 * step)[0].theta) >= math.pi - 0.0101


PUBLISHED = 0.05
"""Time between two messages, in seconds."""


def predict_until(prediction: Prediction, begin: float, end: float) -> list[Pose2D]:
    """Return the poses of the messages between two times; there is none while they pause."""
    steps = range(math.ceil(begin / PUBLISHED - 1e-9), round(end / PUBLISHED) + 1)
    times = [PUBLISHED * step for step in steps]
    return [prediction.predict(time)[0] for time in times if prediction.can_predict(time)]


@pytest.mark.parametrize("late", [0.3, 1.0])
@pytest.mark.parametrize(
    ("velocity", "end"),
    [(Velocity(0.5), Pose2D(0.05)), (Velocity(0.0, 0.0, 1.0), Pose2D(0.0, 0.0, 0.05))],
    ids=["forward", "turn"],
)
def test_a_late_report_of_a_robot_that_stands_does_not_make_the_pose_jump(
    late: float, velocity: Velocity, end: Pose2D
) -> None:
    prediction = Prediction()
    prediction.report(Pose2D(), velocity, 0.0)
    before = predict_until(prediction, 0.0, late - PUBLISHED)[-1]
    prediction.report(end, STANDSTILL, late)
    after = predict_until(prediction, late, late + 0.4)
    error = max(each.seen_from(end).arc[0] for each in (before, *after))
    error_turn = max(each.seen_from(end).theta for each in (before, *after))
    assert error + error_turn > 0.07
    for one, other in pairwise((before, *after)):
        forward, _, turn = other.seen_from(one).arc
        assert -0.45 * error - 1e-9 <= forward <= 0.02
        assert -0.45 * error_turn - 1e-9 <= turn <= 0.02
    assert_near(after[-1], end)


@pytest.mark.parametrize("way", [0.2, 0.4, 0.5])
def test_the_pose_follows_at_once_if_the_robot_has_driven_on_without_reports(way: float) -> None:
    """The movement since the last message fits the reported speeds: it is no error."""
    prediction = Prediction()
    prediction.report(Pose2D(), Velocity(0.5), 0.0)
    prediction.predict(0.3)
    prediction.report(Pose2D(way), Velocity(0.5), 1.0)
    assert_near(prediction.predict(1.0)[0], Pose2D(way))


def test_a_pose_that_nobody_has_seen_for_long_is_not_blended_in() -> None:
    prediction = Prediction()
    prediction.report(Pose2D(), Velocity(0.5), 0.0)
    prediction.predict(0.3)
    prediction.report(Pose2D(-3.0), STANDSTILL, 60.0)
    assert_near(prediction.predict(60.0)[0], Pose2D(-3.0))


@pytest.mark.parametrize("pause", [0.0, 0.7])
@pytest.mark.parametrize("velocity", [Velocity(0.5), Velocity(0.0, 0.4)], ids=["ahead", "sideways"])
def test_a_silent_robot_stands_at_the_last_reported_pose(velocity: Velocity, pause: float) -> None:
    prediction = Prediction()
    prediction.report(Pose2D(), velocity, 0.0)
    poses = [prediction.predict(HORIZON)[0]]
    prediction.stand()
    for step in range(5):
        time = HORIZON + pause + PUBLISHED * step
        assert prediction.can_predict(time)
        pose, now = prediction.predict(time)
        assert now == STANDSTILL
        poses.append(pose)
    for one, other in pairwise(poses):
        assert one.distance - 0.06 < other.distance <= one.distance + 1e-9
    assert_near(poses[-1], Pose2D())


RESIDUAL = [Velocity(0.001), Velocity(0.0, 0.0, -1e-7), Velocity(-0.004, 0.0, 0.004)]


@pytest.mark.parametrize("residual", RESIDUAL)
def test_a_robot_with_a_residual_speed_stands(residual: Velocity) -> None:
    prediction = Prediction()
    prediction.report(Pose2D(1.0), residual, 0.0)
    assert prediction.can_predict(1e6)
    assert_near(prediction.predict(0.9)[0], Pose2D(1.0))
    prediction.stand()
    assert prediction.predict(1.0) == (Pose2D(1.0), STANDSTILL)


def test_a_late_report_is_predicted_from_the_time_at_which_it_was_true() -> None:
    prediction = Prediction()
    prediction.report(Pose2D(), Velocity(0.5), 0.0)
    prediction.predict(0.28)
    prediction.report(Pose2D(0.1), Velocity(0.5), 0.2)  # received at 0.28
    assert_near(prediction.predict(0.29)[0], Pose2D(0.145))


def test_the_last_pose_is_the_newer_one_of_report_and_prediction() -> None:
    prediction = Prediction()
    assert prediction.last == Pose2D()
    prediction.report(Pose2D(1.0), Velocity(0.5), 0.0)
    assert prediction.last == Pose2D(1.0)
    predicted, _ = prediction.predict(0.2)
    assert prediction.last == predicted
    prediction.report(Pose2D(1.2), Velocity(0.5), 0.4)
    assert prediction.last == Pose2D(1.2)
