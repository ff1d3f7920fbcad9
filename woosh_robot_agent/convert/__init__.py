"""Conversion between the ROS messages and the protobuf messages that they mirror.

Functions are compiled once per pair of types: Python source is made from the protobuf descriptor
and the ROS class, by these rules of the mapping, and run once:

- an enum is a ROS message with one field `value` (or a plain integer, in one old message);
- bit i of `has_field` is the presence of the i-th field in declaration order, where that field is
  a message outside of any oneof; from ROS such a field is sent when its bit is set, and to ROS the
  bit is set when the field is present;
- a oneof `x` is a ROS field `x` of a message type of its own, whose `which` counts the members
  from 1 (0: none); `x_choice` repeats it, and is read where `which` is 0, as old clients leave it;
- `bytes` is `uint8[]`; protobuf fields newer than the ROS messages are left out.

ROS messages are made of protobuf messages or, as most frames are JSON, at once of JSON: filling a
protobuf message in between would take several times as long.
"""

from woosh_robot_agent.convert.converter import Converter, converter
from woosh_robot_agent.convert.new import filled
from woosh_robot_agent.convert.to_proto import BadFieldError

__all__ = ["BadFieldError", "Converter", "converter", "filled"]
