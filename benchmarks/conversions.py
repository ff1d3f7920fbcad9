"""JSON to ROS by the agent's converters, and by the library with a copy by reflection."""

from __future__ import annotations

import json
import statistics
import time
from collections.abc import Callable
from functools import cache, partial
from typing import Any

from google.protobuf import json_format
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import Message

from benchmarks.echo_chassis import scan
from benchmarks.options import Measured, Options
from benchmarks.programs import no_collection
from woosh_robot_agent.convert import converter
from woosh_robot_agent.link.codecs.json_mapping import to_json
from woosh_robot_agent.ros_types import class_of
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.config import SimulatorConfig
from woosh_robot_agent.simulator.protocol.reports import pose_speed, robot_info

_ITEMS = 3
_TEXT = "A2: new navigation task"
_TURNS = 15


def samples() -> dict[str, tuple[Message, str]]:
    """By figure: a message as a robot sends it, and its ROS type."""
    chassis = Chassis(SimulatorConfig(seed=1))
    return {
        "convert_pose": (pose_speed(chassis), "woosh_robot_msgs/PoseSpeed"),
        "convert_scan": (scan(1080), "woosh_robot_msgs/ScannerData"),
        "convert_info": (filled(robot_info(chassis)), "woosh_robot_msgs/RobotInfo"),
    }


def filled(message: Any) -> Any:
    """The same message with every part in it, and something in every list."""
    for field in message.DESCRIPTOR.fields:
        if field.containing_oneof is not None:
            continue
        value = getattr(message, field.name)
        if field.message_type is None:
            if _is_list(value) and not value:
                value.extend([_value(field)] * _ITEMS)
        elif not _is_list(value):
            value.SetInParent()
            filled(value)
        else:
            for _ in range(0 if value else _ITEMS):
                filled_in(value.add())
    return message


def filled_in(message: Any) -> None:
    """Fill a new message, its plain fields too."""
    for field in message.DESCRIPTOR.fields:
        plain = field.containing_oneof is None and field.message_type is None
        if plain and not _is_list(getattr(message, field.name)):
            setattr(message, field.name, _value(field))
    filled(message)


def _is_list(value: Any) -> bool:
    return not isinstance(value, Message | str | bytes) and hasattr(value, "__len__")


def _value(field: Any) -> Any:
    if field.enum_type is not None:
        return field.enum_type.values[-1].number
    return {
        FieldDescriptor.CPPTYPE_STRING: _TEXT,
        FieldDescriptor.CPPTYPE_BOOL: True,
        FieldDescriptor.CPPTYPE_FLOAT: 4.23276472,
        FieldDescriptor.CPPTYPE_DOUBLE: 4.23276472,
    }.get(field.cpp_type, 1204)


def conversions(_domain: int, options: Options) -> Measured:
    """From a frame's body, as `json.loads` gives it, to the ROS message, both ways by turns."""
    found = {}
    for name, (message, ros_name) in samples().items():
        body = json.loads(json.dumps(to_json(message, defaults=True)))
        ros_class, cls = _ros_class(ros_name), type(message)
        ours = partial(converter(ros_class, cls).from_json, body)
        theirs = partial(_library, body, ros_class, cls)
        with no_collection():
            turns = [(timed(ours, options), timed(theirs, options)) for _ in range(_TURNS)]
        mine, other = (statistics.median(times) * 1e6 for times in zip(*turns, strict=True))
        found[name] = (mine / other, f"{mine:.1f} / {other:.1f} µs")
    return found


def _library(body: Any, ros_class: Any, cls: type[Message]) -> Any:
    return reflected(json_format.ParseDict(body, cls()), ros_class)


def timed(work: Callable[[], Any], options: Options) -> float:
    """s that it takes, on average over a while."""
    work()
    begun = time.perf_counter()
    count = 0
    while (now := time.perf_counter()) - begun < 0.1 * options.scale or not count:
        work()
        count += 1
    return (now - begun) / count


@cache
def _ros_class(name: str) -> Any:
    return class_of(name, "msg")


def reflected(message: Any, ros_class: Any) -> Any:
    """The copy that one writes without thinking about speed: by the names of the fields."""
    ros = class_of()
    for name, kind in ros.get_fields_and_field_types().items():
        if name in message.DESCRIPTOR.fields_by_name:
            setattr(ros, name, _copied(getattr(message, name), kind))
    return ros


def _copied(value: Any, kind: str) -> Any:
    if kind.startswith("sequence<"):
        inner = kind.removeprefix("sequence<").partition(">")[0].partition(",")[0]
        return [_copied(each, inner) for each in value]
    if "/" not in kind:
        return value
    ros_class = _ros_class(kind)
    if isinstance(value, Message):
        return reflected(value, ros_class)
    return class_of(value=value)  # an enum
