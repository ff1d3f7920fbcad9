"""The serialization of messages gives what rclpy gives, except for the content of padding."""

from __future__ import annotations

import math
import random
from typing import Any

import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry, Path
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import BatteryState, LaserScan
from std_msgs.msg import Empty, Header

from tests.convert.random_messages import random_ros
from tests.convert.type_pairs import PAIRS
from woosh_robot_agent.convert.cdr import serialize
from woosh_robot_agent.pb.robot.robot_pb2 import NavPath
from woosh_robot_agent.ros.standard.states import plan


def check(message: Any) -> None:
    mine, theirs = serialize(message), serialize_message(message)
    assert len(mine) <= len(theirs) < len(mine) + 4
    # rclpy leaves whatever was in memory in the padding
    known = [(a, b) for a, b in zip(mine, theirs, strict=False) if a]
    assert all(a == b for a, b in known)
    assert repr(deserialize_message(mine, type(message))) == repr(message)


@pytest.mark.parametrize("name", PAIRS)
def test_each_type_of_the_robot_is_serialized_as_by_rclpy(name: str) -> None:
    cls, _ = PAIRS[name]
    rng = random.Random(name)
    for message in [cls(), *(random_ros(rng, cls) for _ in range(5))]:
        check(message)


def poses(frame: str, count: int) -> list[Any]:
    found = [PoseStamped() for _ in range(count)]
    for number, each in enumerate(found):
        each.header.frame_id = frame
        each.pose.position.x = number / 3
    return found


@pytest.mark.parametrize(
    "message",
    [
        Empty(),
        LaserScan(ranges=[1.0, float("inf"), float("nan")], intensities=[]),
        Odometry(child_frame_id="base_link"),
        PoseWithCovarianceStamped(),
        BatteryState(cell_voltage=[3.5], location="é", present=True),
        *(Path(poses=poses("map"[:n], n)) for n in range(4)),
    ],
    ids=lambda message: type(message).__name__,
)
def test_standard_types_are_serialized_as_by_rclpy(message: Any) -> None:
    check(message)


def test_a_type_that_the_robot_does_not_use_is_refused() -> None:
    with pytest.raises(TypeError, match="octet"):
        serialize(DiagnosticStatus())


@pytest.mark.parametrize(("frame", "count"), [("map", 0), ("robot1/map", 1), ("", 2)])
def test_a_plan_is_a_path_with_a_header_for_each_pose(frame: str, count: int) -> None:
    class Context:
        def header(self, which: str) -> Header:
            assert which == "map"
            return Header(stamp=Time(sec=3, nanosec=4), frame_id=frame)

    value = NavPath()
    for number in range(count):
        value.path.poses.add(x=number, y=-number, theta=number / 2)
    path = deserialize_message(plan(Context(), value), Path)  # type: ignore[arg-type]
    assert path.header.frame_id == frame
    assert [each.header for each in path.poses] == [path.header] * count
    for number, each in enumerate(path.poses):
        pose = each.pose
        assert (pose.position.x, pose.position.y, pose.position.z) == (number, -number, 0)
        assert 2 * math.atan2(pose.orientation.z, pose.orientation.w) == pytest.approx(number / 2)
        assert pose.orientation.x == pose.orientation.y == 0
