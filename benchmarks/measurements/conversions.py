"""Conversion from JSON to ROS: compiled converters, compared with ParseDict and a generic copy."""

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

from benchmarks.figures import MICROSECONDS, Measured, Target, no_garbage_collection
from benchmarks.options import Options
from benchmarks.programs.chassis import scan
from woosh_robot_agent.convert import converter
from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.link.codecs.json_codec import to_json
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.config import SimulatorConfig
from woosh_robot_agent.simulator.protocol.reports import pose_speed, robot_info

FIGURES = {
    "convert_pose": Target(1 / 8, 1 / 15, "PoseSpeed, JSON to ROS / ParseDict and reflection"),
    "convert_scan": Target(1 / 15, 1 / 25, "the same for a scan of 1080 beams"),
    "convert_info": Target(1 / 6, 1 / 12, "the same for a full RobotInfo"),
}
_ITEMS = 3
"""Number of items that an empty list is filled with."""
_TEXT = "A2: new navigation task"
_TURNS = 15
_DURATION = 0.1
"""Time for which a conversion is repeated, in seconds."""


def samples() -> dict[str, tuple[Message, str]]:
    """Return for each figure a message as a robot sends it, and its ROS type."""
    chassis = Chassis(SimulatorConfig(seed=1, profile="instant"))
    return {
        "convert_pose": (pose_speed(chassis), "woosh_robot_msgs/PoseSpeed"),
        "convert_scan": (scan(1080), "woosh_robot_msgs/ScannerData"),
        "convert_info": (fill(robot_info(chassis)), "woosh_robot_msgs/RobotInfo"),
    }


def fill(message: Any) -> Any:
    """Set every part of a message and put items into every empty list; return the message."""
    for field in message.DESCRIPTOR.fields:
        if field.containing_oneof is not None:
            continue
        value = getattr(message, field.name)
        if field.message_type is None:
            if _is_list(value) and not value:
                value.extend([_value(field)] * _ITEMS)
        elif not _is_list(value):
            value.SetInParent()
            fill(value)
        else:
            for _ in range(0 if value else _ITEMS):
                _fill_new(value.add())
    return message


def _fill_new(message: Any) -> None:
    """Fill a new message, plain fields included."""
    for field in message.DESCRIPTOR.fields:
        plain = field.containing_oneof is None and field.message_type is None
        if plain and not _is_list(getattr(message, field.name)):
            setattr(message, field.name, _value(field))
    fill(message)


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


def measure(_domain: int, options: Options) -> Measured:
    """Measure compiled conversion and conversion by reflection, alternately, from JSON to ROS."""
    figures = {}
    for name, (message, ros_name) in samples().items():
        body = json.loads(json.dumps(to_json(message, defaults=True)))
        ros_class, cls = _ros_class(ros_name), type(message)
        compiled = partial(converter(ros_class, cls).from_json, body)
        by_reflection = partial(_convert_by_reflection, body, ros_class, cls)
        with no_garbage_collection():
            turns = [
                (_mean_time(compiled, options), _mean_time(by_reflection, options))
                for _ in range(_TURNS)
            ]
        ours, floor = (
            statistics.median(times) * MICROSECONDS for times in zip(*turns, strict=True)
        )
        figures[name] = (ours / floor, f"{ours:.1f} / {floor:.1f} µs")
    return figures


def _mean_time(work: Callable[[], Any], options: Options) -> float:
    """Return the mean duration of `work`, in seconds."""
    work()
    begin = time.perf_counter()
    count = 0
    while (now := time.perf_counter()) - begin < _DURATION * options.scale or not count:
        work()
        count += 1
    return (now - begin) / count


@cache
def _ros_class(name: str) -> Any:
    return class_of(name, "msg")


def _convert_by_reflection(body: Any, ros_class: Any, cls: type[Message]) -> Any:
    return _copy(json_format.ParseDict(body, cls()), ros_class)


def _copy(message: Any, ros_class: Any) -> Any:
    """Return a ROS copy of a protobuf message, field by field and by name."""
    ros = ros_class()
    for name, kind in ros.get_fields_and_field_types().items():
        if name in message.DESCRIPTOR.fields_by_name:
            setattr(ros, name, _copy_value(getattr(message, name), kind))
    return ros


def _copy_value(value: Any, kind: str) -> Any:
    if kind.startswith("sequence<"):
        inner = kind.removeprefix("sequence<").partition(">")[0].partition(",")[0]
        return [_copy_value(each, inner) for each in value]
    if "/" not in kind:
        return value
    ros_class = _ros_class(kind)
    if isinstance(value, Message):
        return _copy(value, ros_class)
    return ros_class(value=value)  # an enum
