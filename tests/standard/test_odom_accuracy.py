"""The error of odom on a simulated drive with curves, stops and reversals, in simulated time."""

from __future__ import annotations

import random
from dataclasses import dataclass, field

import pytest

from woosh_robot_agent.ros.standard.odometry import Odometry, Prediction
from woosh_robot_agent.ros.standard.poses import Pose2D
from woosh_robot_agent.simulator.body.base import Base
from woosh_robot_agent.simulator.body.base import Velocity as BaseVelocity
from woosh_robot_agent.simulator.profile import load_profile
from woosh_robot_agent.simulator.world.geometry import Pose

STEP = 0.001
REPORTS, RATE = 204, 50
"""Steps between two reports, and between two messages."""
DRIVE = (
    *((2.5, 0.5, 0.0), (1.5, 0.0, 0.0), (4.0, 0.5, 1.0), (1.5, 0.0, 0.0)),
    *((2.0, -0.5, 0.0), (2.0, -0.5, 1.0), (1.5, 0.0, 0.0)),
    *((2.0, 0.0, 1.0), (2.0, 0.0, -1.0), (1.5, 0.0, 0.0)),
    *((1.5, 0.5, 1.0), (1.5, 0.5, -1.0), (2.0, 0.5, 0.0), (2.0, -0.5, 0.0)),
    *((2.0, 0.5, 0.5), (2.0, -0.5, -0.5), (3.0, 0.0, 0.0)),
)
"""Duration in seconds, speed in m/s, angular speed in rad/s."""


@dataclass
class Errors:
    """Errors while the robot moves, in metres, and what else must not happen."""

    odom: list[float] = field(default_factory=list)
    reports: list[float] = field(default_factory=list)
    after_stop: list[float] = field(default_factory=list)
    """Speeds in odom when the robot had been standing for longer than between two reports."""
    backwards: list[float] = field(default_factory=list)
    """Movements against the direction of the drive between two messages."""


def drive(profile: str, delay: float, seed: int) -> Errors:
    """Drive, with a delay of the reports that is exponentially distributed."""
    driving = load_profile(profile).driving
    base = Base(
        Pose(),
        odometer=0.0,
        rolls_for=driving.rolls_for,
        stops_below=driving.stops_below,
        max_speed=driving.max_speed,
        max_turn_rate=driving.max_turn_rate,
    )
    chance, errors = random.Random(seed), Errors()
    odometry, prediction = Odometry(), Prediction()
    on_the_way: list[tuple[float, Pose2D, BaseVelocity]] = []
    last_report, stood, now, last = None, 0.0, 0.0, Pose2D()
    offset = chance.randrange(REPORTS)
    for seconds, linear, angular in DRIVE:
        for _ in range(round(seconds / STEP)):
            if linear or angular:
                base.drive(BaseVelocity(linear, 0.0, angular))
            base.tick(STEP, lambda _: 1.0)
            now += STEP
            number = round(now / STEP)
            stood = 0.0 if base.moving else stood + STEP
            true = Pose2D(base.pose.x, base.pose.y, base.pose.theta)
            report = (true, base.velocity)
            if number % REPORTS == offset and report != last_report:
                last_report = report
                received = now + chance.expovariate(1 / delay) if delay else now
                on_the_way.append((max(received, *(each[0] for each in on_the_way), 0.0), *report))
            while on_the_way and on_the_way[0][0] <= now:
                received, pose, velocity = on_the_way.pop(0)
                odometry.update(pose, velocity.forward, velocity.turn, 1, received)
                prediction.report(odometry.pose, odometry.velocity, odometry.time)
                if base.moving:
                    errors.reports.append(pose.seen_from(true).distance)
            if number % RATE or not prediction.can_predict(now) or now < 1.0:
                continue
            pose, velocity = prediction.predict(now)
            pose = odometry.map_to_odom * pose
            if base.moving:
                errors.odom.append(pose.seen_from(true).distance)
            if stood > (REPORTS + 1) * STEP + 20 * delay:
                errors.after_stop.append(abs(velocity.forward) + abs(velocity.turn))
            if linear > 0.0 and base.velocity.forward == linear:
                errors.backwards.append(-pose.seen_from(last).x)
            last = pose
    return errors


def at_share(values: list[float], share: float) -> float:
    return sorted(values)[int(share * (len(values) - 1))]


@pytest.mark.parametrize(("profile", "delay"), [("tr200", 0.005), ("instant", 0.0)])
def test_the_error_is_small(profile: str, delay: float) -> None:
    """It is compared with what the reports have at the times of their receipt."""
    errors = [drive(profile, delay, seed) for seed in range(2)]
    odom = [each for one in errors for each in one.odom]
    reports = [each for one in errors for each in one.reports]
    assert len(odom) > 1000
    assert at_share(odom, 0.5) < at_share(reports, 0.5) + 0.005
    assert at_share(odom, 0.99) < at_share(reports, 0.99) + 0.025
    assert max(odom) < 0.04
    for one in errors:
        assert one.after_stop
        assert not any(one.after_stop), "odom has a speed though the robot stands"
        assert max(one.backwards) <= 0.0, "odom moves back though the robot drives ahead"
