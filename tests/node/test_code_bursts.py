"""Bursts of status codes, as a real robot sends them, reach every subscriber that keeps up."""

from __future__ import annotations

from typing import Any

import pytest

from tests.harness import Robot
from woosh_robot_agent.pb.robot import robot_count_pb2 as pb
from woosh_robot_agent.simulator import Outgoing, SimulatorThread
from woosh_robot_msgs.msg import StatusCode

TYPE = "woosh.robot.count.StatusCode"
FIRST = 110301000042
COUNT = 308
"""Number of codes in the greatest burst that a real robot has sent within a second."""


@pytest.fixture
def sent(simulator: SimulatorThread) -> list[tuple[int, int]]:
    """Numbers and times of all codes that the chassis has sent, in order."""
    found: list[tuple[int, int]] = []

    def record(frame: Outgoing) -> list[Outgoing]:
        body: Any = frame.body
        if frame.type == TYPE and not frame.is_answer:
            found.append((body.code, body.time))
        return [frame]

    simulator.intercept(record)
    return found


def test_every_code_of_a_burst_arrives_in_order(robot: Robot, sent: list[tuple[int, int]]) -> None:
    codes = robot.echo(StatusCode, "robot/StatusCode", depth=1000)
    robot.chassis.push(pb.StatusCode(code=FIRST))  # the publisher keeps it for late subscribers
    codes.wait(lambda each: each.code == FIRST)  # now it has discovered this one
    for burst in range(1, 3):
        robot.chassis.inject("code_burst", count=COUNT, rate=0)
        codes.wait_count(1 + burst * COUNT)
    assert [(each.code, each.time) for each in codes.messages] == sent
    assert len({code for code, _ in sent}) < 10  # the same ones again and again
