"""What is remembered of the chassis: read only when somebody looks, and then in order."""

from __future__ import annotations

from typing import Any

from woosh_robot_agent.last_known import LastKnown
from woosh_robot_agent.link import Body
from woosh_robot_agent.link.codecs.frames import Envelope, FrameError
from woosh_robot_agent.link.codecs.json_codec import JsonCodec
from woosh_robot_agent.pb.robot.robot_pb2 import Battery, RobotInfo, RobotState

INFO = "woosh.robot.RobotInfo"
BATTERY = "woosh.robot.Battery"


class Said:
    """Bodies as frames bring them, and what was told of bad ones."""

    def __init__(self) -> None:
        self.known = LastKnown(None)
        self.bad: list[FrameError] = []

    def push(self, name: str, **value: Any) -> None:
        self.known.remember(Body(JsonCodec(), Envelope(name, value), self.bad.append))

    @property
    def info(self) -> Any:
        return self.known.get(INFO)


def test_a_part_that_comes_after_robot_info_is_in_it():
    said = Said()
    said.push(INFO, battery={"power": 50}, state=2)
    said.push(BATTERY, power=49)
    said.push("woosh.robot.RobotState", state=3)
    assert (said.info.battery.power, said.info.state) == (49, 3)
    assert said.known.get(BATTERY) == Battery(power=49)


def test_robot_info_that_comes_after_a_part_replaces_it():
    said = Said()
    said.push(BATTERY, power=49)
    said.push(INFO, battery={"power": 50})
    assert said.info.battery.power == 50
    assert said.known.get(BATTERY) == Battery(power=50)


def test_robot_info_that_lacks_a_part_leaves_the_one_before():
    said = Said()
    said.push(INFO, battery={"power": 50})
    said.push(INFO, robotId=7)
    assert said.known.get(BATTERY) == Battery(power=50)


def test_order_counts_however_often_nobody_looked():
    said = Said()
    said.push(INFO, battery={"power": 1})
    said.push(BATTERY, power=2)
    said.push(INFO, battery={"power": 3})
    assert said.info.battery.power == 3
    said.push(INFO, battery={"power": 4})
    said.push(BATTERY, power=5)
    assert said.info.battery.power == 5


def test_what_cannot_be_read_is_told_once_and_changes_nothing():
    said = Said()
    said.push(BATTERY, power=49)
    assert said.known.get(BATTERY) == Battery(power=49)
    said.push(BATTERY, power="much")
    for _ in range(3):
        assert said.known.get(BATTERY) == Battery(power=49)
    assert [error.kind for error in said.bad] == ["body"]


def test_messages_are_remembered_too():
    said = Said()
    info = RobotInfo(robot_id=7)
    said.known.remember(info)
    said.known.remember(RobotState(state=2))
    assert (said.info.robot_id, said.info.state) == (7, 2)
    assert info.state == 0  # the caller's own does not change


def test_of_what_nobody_looks_at_the_last_of_each_type_is_kept():
    said = Said()
    for power in range(1000):
        said.push(BATTERY, power=power)
        said.push("woosh.robot.PoseSpeed", mileage=power)
    assert len(said.known._unread) == 2
