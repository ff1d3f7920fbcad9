"""The last known values: decoded lazily, and in order."""

from __future__ import annotations

from typing import Any

from woosh_robot_agent.link import Body
from woosh_robot_agent.link.codecs.json_codec import JsonCodec
from woosh_robot_agent.link.frames import Envelope, FrameError
from woosh_robot_agent.pb.robot.robot_pb2 import Battery, TaskProc
from woosh_robot_agent.robot.last_known import LastKnown

INFO = "woosh.robot.RobotInfo"
BATTERY = "woosh.robot.Battery"


class Pushed:
    """Last known values fed with pushed bodies; collects the reports of bad bodies."""

    def __init__(self) -> None:
        self.known = LastKnown()
        self.bad: list[FrameError] = []

    def push(self, name: str, **value: Any) -> None:
        self.known.remember(Body(JsonCodec(), Envelope(name, value), self.bad.append))

    @property
    def info(self) -> Any:
        return self.known.get(INFO)


def test_a_part_after_robot_info_is_merged_into_it():
    said = Pushed()
    said.push(INFO, battery={"power": 50}, state=2)
    said.push(BATTERY, power=49)
    said.push("woosh.robot.RobotState", state=3)
    assert (said.info.battery.power, said.info.state) == (49, 3)
    assert said.known.get(BATTERY) == Battery(power=49)


def test_robot_info_after_a_part_replaces_it():
    said = Pushed()
    said.push(BATTERY, power=49)
    said.push(INFO, battery={"power": 50})
    assert said.info.battery.power == 50
    assert said.known.get(BATTERY) == Battery(power=50)


def test_robot_info_without_a_part_keeps_the_earlier_one():
    said = Pushed()
    said.push(INFO, battery={"power": 50})
    said.push(INFO, robotId=7)
    assert said.known.get(BATTERY) == Battery(power=50)


def test_robot_info_without_a_task_ends_the_earlier_one():
    said = Pushed()
    said.push("woosh.robot.TaskProc", robotTaskId="7", state=3)
    assert said.known.get("woosh.robot.TaskProc") == TaskProc(robot_task_id=7, state=3)
    said.push(INFO, robotId=7)
    assert said.known.get("woosh.robot.TaskProc") == TaskProc()


def test_a_bad_body_is_reported_once_and_changes_nothing():
    said = Pushed()
    said.push(BATTERY, power=49)
    assert said.known.get(BATTERY) == Battery(power=49)
    said.push(BATTERY, power="much")
    for _ in range(3):
        assert said.known.get(BATTERY) == Battery(power=49)
    assert [error.kind for error in said.bad] == ["body"]


def test_only_the_last_unread_value_of_each_type_is_kept():
    said = Pushed()
    for number in range(1000):
        said.push(BATTERY, power=f"much {number}")
        said.push("woosh.robot.PoseSpeed", mileage=number)
    assert said.known.get(BATTERY) is None
    assert ["much 999" in str(error) for error in said.bad] == [True]
