"""Conversion between ROS messages and the protobuf messages that they mirror.

A converter is compiled once per pair of types: Python source is generated from the protobuf
descriptor and the ROS class, by these rules:

- An enum is a ROS message with one field `value`, or in one old message a plain integer.
- Bit i of `has_field` is the presence of the i-th protobuf field in declaration order, if that
  field is a message outside of any oneof. In the conversion to protobuf, such a field is set if its
  bit is set. In the conversion to ROS, the bit is set if the field is present.
- A oneof `x` is a ROS field `x` of its own message type. Its `which` is the number of the member,
  from 1 (0: none). `x_choice` has the same value; it is used if `which` is 0, as sent by old
  clients.
- `bytes` is `uint8[]`. Protobuf fields that are newer than the ROS messages are ignored.

JSON, the usual encoding of frames, is converted directly to ROS messages. A protobuf message in
between would take several times as long.
"""

from woosh_robot_agent.convert.converter import Converter, converter
from woosh_robot_agent.convert.mapping import BadFieldError
from woosh_robot_agent.convert.to_ros import new_message

__all__ = ["BadFieldError", "Converter", "converter", "new_message"]
