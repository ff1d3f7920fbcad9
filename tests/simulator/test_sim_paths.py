"""Navigation along paths that clients give as many poses."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

import pytest

from tests.simulator.recorded_chassis import Frame, SteppedChassis, ask
from tests.simulator.sim_wire import Json
from woosh_robot_agent.simulator.world.geometry import Pose

CALL = "woosh.ros.CallAction"
SUCCESS, EXECUTING, PAUSE = 1, 2, 3


def points(path: Callable[[float], tuple[float, float, float]]) -> list[Json]:
    """Return poses along a path, which is a function of the length from its start, in metres."""
    places = [path(0.03 * number) for number in range(200)]
    return [{"x": x, "y": y, "theta": theta} for x, y, theta in places]


PATHS = {
    "line": points(lambda s: (-2.0 + s, -2.0, 0.0)),
    "line without headings": points(lambda s: (4.0, -6.0 + s, 0.0)),
    "arc": points(lambda s: (4 + 1.5 * math.sin(s / 1.5), -4 - 1.5 * math.cos(s / 1.5), s / 1.5)),
    "waves": points(lambda s: (-3.0 + s, -2.0 + 0.3 * math.sin(2.0 * s), 0.0)),
}


@pytest.mark.parametrize("name", ["line without headings", "arc", "waves"])
def test_points_of_a_path_are_passed_without_stopping(name: str) -> None:
    poses = PATHS[name]
    chassis = SteppedChassis(profile="instant")
    first, last = poses[0], poses[-1]
    chassis.chassis.base.place(Pose(first["x"], first["y"], 0.0))
    places = [(each["x"], each["y"]) for each in poses]
    length = sum(math.dist(here, there) for here, there in pairwise(places))
    before, start = len(chassis.frames), chassis.chassis.elapsed
    ask(chassis, CALL, moveBase={"action": 1, "executionMode": 1, "poses": poses})
    off = 0.0
    while not (found := feedback_end(chassis.frames[before:])):
        chassis.run(0.05)
        here = chassis.chassis.pose.point
        off = max(off, min(math.dist(here, each) for each in places))
    assert found == SUCCESS
    # At 0.8 m/s, and with turns on the spot at both ends.
    assert chassis.chassis.elapsed - start < length / 0.8 + 6.0
    assert off < 0.05
    assert chassis.chassis.pose.distance(places[-1]) < 0.005
    assert math.remainder(chassis.chassis.pose.theta - last["theta"], math.tau) == pytest.approx(
        0.0, abs=0.005
    )


def feedback_end(frames: list[Frame]) -> int:
    """Return the state with which an action ended, 0 if it has not ended."""
    states = [
        each["state"] for frame in frames if "fbs" in frame.body for each in frame.body["fbs"]
    ]
    return next((state for state in states if state not in (EXECUTING, PAUSE)), 0)


def test_robot_on_a_path_of_points_stops_before_an_obstacle() -> None:
    chassis = SteppedChassis(profile="instant")
    chassis.chassis.base.place(Pose(-2.0, -2.0, 0.0))
    ask(chassis, CALL, moveBase={"action": 1, "executionMode": 1, "poses": PATHS["line"]})
    chassis.run(2.0)
    x = chassis.chassis.pose.x + 1.5
    chassis.chassis.obstacles.put("box", x, -2.0, 0.3)
    chassis.run(4.0)
    assert not chassis.chassis.base.moving
    assert chassis.chassis.impeded
    assert 0.7 < chassis.chassis.pose.distance((x, -2.0)) < 1.3
    chassis.chassis.obstacles.clear()
    chassis.run(20.0)
    assert chassis.chassis.pose.distance((3.97, -2.0)) < 0.005


def test_robot_turns_to_the_headings_of_distant_poses_one_by_one() -> None:
    chassis = SteppedChassis(profile="instant")
    chassis.chassis.base.place(Pose(2.0, -6.0, 0.0))
    poses = [{"x": 4, "y": -6, "theta": 2.0}, {"x": 5, "y": -6, "theta": 0}]
    ask(chassis, CALL, moveBase={"action": 1, "executionMode": 1, "poses": poses})
    headings = set()
    for _ in range(400):
        chassis.run(0.05)
        if chassis.chassis.pose.distance((4.0, -6.0)) < 0.01:
            headings.add(round(chassis.chassis.pose.theta, 2))
    assert 2.0 in headings
