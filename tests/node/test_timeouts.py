"""Timeouts of answers: `poll_timeout`, and the longer ones of slow requests."""

from __future__ import annotations

from collections.abc import Callable

from tests.harness import Client, RunningAgent
from woosh_robot_agent.endpoints import minimum_timeouts
from woosh_robot_agent.simulator import SimulatorThread

INIT_ROBOT = "woosh.robot.InitRobot"
LONGEST_ANSWERS = {
    "woosh.robot.BuildMap": 235.538,
    "woosh.robot.NavPath": 8.833,
    "woosh.robot.SwitchWorkMode": 6.469,
    INIT_ROBOT: 4.9,
    "woosh.robot.RobotInfo": 3.497,
    "woosh.map.SceneData": 4.562,
    "woosh.map.Download": 9.789,
    "woosh.map.Upload": 5.141,
}
"""Longest answer times of a real robot, in seconds."""


def test_a_slow_request_may_take_longer_than_poll_timeout(
    connect: Callable[..., RunningAgent], client: Client, simulator: SimulatorThread
) -> None:
    connect(poll_timeout=1000)
    simulator.delay(INIT_ROBOT, 1.5)
    response = client.command("robot/InitRobot", is_record=True)
    assert (response.ok, "did not answer" in response.msg) == (True, False), response.msg


def test_a_poll_timeout_beyond_the_minimum_wins(
    connect: Callable[..., RunningAgent],
) -> None:
    chassis = connect(poll_timeout=40_000).agent.robot.chassis
    assert chassis.timeout_of(INIT_ROBOT) == 40.0
    assert chassis.timeout_of("woosh.robot.BuildMap") == minimum_timeouts()["woosh.robot.BuildMap"]
    assert chassis.timeout_of("woosh.robot.Speak") == 40.0


def test_the_longest_real_answers_fit_twice() -> None:
    for request, longest in LONGEST_ANSWERS.items():
        assert minimum_timeouts().get(request, 10.0) >= 2 * longest, request
