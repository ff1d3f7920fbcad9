"""JSON to ROS by the agent's converters, and by the library with a copy by reflection."""

from __future__ import annotations

import json
import statistics
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from google.protobuf import json_format
from google.protobuf.message import Message

from woosh_robot_agent.convert import converter
from woosh_robot_agent.link.json_codec import JsonCodec
from woosh_robot_agent.pb.robot.robot_pb2 import ScannerData
from woosh_robot_agent.services import ros_type
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.config import SimulatorConfig
from woosh_robot_agent.simulator.reports import pose_speed, robot_info

if TYPE_CHECKING:
    from bench.speed import Options

_CODEC = JsonCodec()


def samples() -> dict[str, tuple[Message, str]]:
    """By figure: a message as a robot sends it, and its ROS type."""
    chassis = Chassis(SimulatorConfig(seed=1))
    scan = ScannerData(angle_min=-2.2, angle_max=2.2, range_max=25.0)
    scan.ranges.extend(1.0 + beam / 137.0 for beam in range(1080))
    return {
        "convert_pose": (pose_speed(chassis), "woosh_robot_msgs/PoseSpeed"),
        "convert_scan": (scan, "woosh_robot_msgs/ScannerData"),
        "convert_info": (robot_info(chassis), "woosh_robot_msgs/RobotInfo"),
    }


def conversions(_domain: int, options: Options) -> dict[str, tuple[float, str]]:
    """From the frame's text to the ROS message, both ways by turns."""
    found = {}
    for name, (message, ros_name) in samples().items():
        ros_class = ros_type(ros_name, "msg")
        cls: type[Message] = type(message)
        text = JsonCodec(defaults=True).encode(cls.DESCRIPTOR.full_name, message)
        convert = converter(ros_class, cls)

        def ours(text: Any = text, cls: Any = cls, convert: Any = convert) -> Any:
            return convert.to_ros(_CODEC.body(_CODEC.decode(text), cls))

        def theirs(text: Any = text, cls: Any = cls, ros_class: Any = ros_class) -> Any:
            body = json.loads(text)["body"]
            return reflected(json_format.ParseDict(body, cls()), ros_class)

        assert message.ByteSize() > 0
        parsing = statistics.median(timed(lambda: json.loads(text), options) for _ in range(5))  # noqa: B023
        pairs = [(timed(ours, options), timed(theirs, options)) for _ in range(5)]
        mine, other = (statistics.median(times) for times in zip(*pairs, strict=True))
        # the text's parsing is the same for both, and no conversion
        found[name] = (
            (mine - parsing) / (other - parsing),
            f"{(mine - parsing) * 1e6:.1f} / {(other - parsing) * 1e6:.0f} µs, without json.loads",
        )
    return found


def timed(work: Callable[[], Any], options: Options) -> float:
    """s that it takes, on average over a while."""
    work()
    begun = time.perf_counter()
    count = 0
    while (now := time.perf_counter()) - begun < 0.3 * options.scale or not count:
        work()
        count += 1
    return (now - begun) / count


def reflected(message: Any, ros_class: Any) -> Any:
    """The copy that one writes without thinking about speed: by the names of the fields."""
    ros = ros_class()
    for name, kind in ros.get_fields_and_field_types().items():
        if name not in message.DESCRIPTOR.fields_by_name:
            continue
        setattr(ros, name, _copied(getattr(message, name), kind))
    return ros


def _copied(value: Any, kind: str) -> Any:
    if kind.startswith("sequence<"):
        inner = kind.removeprefix("sequence<").partition(">")[0].partition(",")[0]
        return [_copied(each, inner) for each in value]
    if "/" not in kind:
        return value
    ros_class = ros_type(kind, "msg")
    if isinstance(value, Message):
        return reflected(value, ros_class)
    return ros_class(value=value)  # an enum
