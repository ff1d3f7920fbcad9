"""The agent belongs to the first robot that answers. Another one is refused, and told of."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from std_msgs.msg import Bool

from tests.harness import Logs, Robot, wait_until
from tests.node.goals import ABORTED, EXECUTING, task
from tests.node.test_parameters import change
from tests.node.test_states import diagnostics
from tests.node.test_twist import answers, drive, speeds
from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.testing import running_chassis
from woosh_robot_msgs.srv import RobotInfo, Speak

TWIST = "woosh.robot.Twist"
FORMER, NEW = 30001, 30002
"""Ids, and serial numbers, of the two robots."""


@pytest.fixture
def other() -> Iterator[SimulatorThread]:
    """Another robot."""
    with running_chassis(robot_id=NEW, speed=20) as chassis:
        yield chassis


def test_another_robot_is_refused_and_the_first_one_taken_back(
    robot: Robot, other: SimulatorThread, logs: Logs
) -> None:
    connected = robot.echo(Bool, "connected")
    told = diagnostics(robot)
    goal = task(robot)
    goal.feedback.wait(lambda fb: fb.state.value == EXECUTING)
    assert change(robot, port=other.port, goal_link_timeout=0.5) == (True, "")
    refusal = "robot 30002 (serial number 30002) answers instead of robot 30001"
    logs.wait_text(refusal, "restart this program")
    told.wait(lambda m: any(refusal in status.message for status in m.status))
    assert not connected.messages[-1].data
    assert goal.result()[0] == ABORTED
    answer = robot.call(Speak, "robot/Speak")
    assert not answer.ok
    assert refusal in answer.msg
    # a query answers for the first robot, and says so in the log
    assert robot.call(RobotInfo, "robot/RobotInfo").info.genral.serial_number == FORMER
    assert change(robot, port=robot.chassis.port) == (True, "")
    wait_until(lambda: connected.messages[-1].data, "the first robot")
    assert robot.call(Speak, "robot/Speak").ok
    assert not other.counts["woosh.robot.Speak"]


@pytest.mark.parametrize("parameter", ["port", "robot_id"])
def test_a_robot_gets_a_zero_before_its_link_closes_and_another_one_nothing(
    robot: Robot, other: SimulatorThread, parameter: str
) -> None:
    robot.set_motion_timing(driving=3600.0)  # it counts as driving, even on a slow machine
    new = {"port": other.port, "robot_id": 5}[parameter]
    answers([drive(robot, 0.3)])
    assert change(robot, **{parameter: new}) == (True, "")
    robot.chassis.wait_received(TWIST, 2)
    wait_until(lambda: other.connections or len(robot.chassis.received) > 2)
    assert speeds(robot.chassis)[:2] == [0.3, 0.0]
    robot.agent.close()
    assert not any(speeds(robot.chassis)[2:])
    assert speeds(other) == []


def test_the_same_robot_over_another_encoding_keeps_its_topics(robot: Robot) -> None:
    batteries = robot.echo(class_of("woosh_robot_msgs/Battery", "msg"), "robot/Battery")
    batteries.wait_count(1)
    assert change(robot, encoding="protobuf") == (True, "")
    robot.agent.wait_connected(2)
    late = robot.echo(class_of("woosh_robot_msgs/Battery", "msg"), "robot/Battery")
    assert late.wait_count(1)
    assert robot.publishers("robot/Battery") == 1
