"""The records of a recording, and the channels of its files."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from google.protobuf import message_factory, text_format
from google.protobuf.descriptor_pb2 import FileDescriptorProto
from google.protobuf.descriptor_pool import DescriptorPool
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap_protobuf.schema import build_file_descriptor_set

Side = Literal["client", "chassis", "recorder"]
"""A side of a connection; `recorder` is the program that records it."""
EventKind = Literal["open", "close", "refused", "unreadable"]
SIDES: tuple[Side, ...] = get_args(Side)
EVENT_KINDS: tuple[EventKind, ...] = get_args(EventKind)


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame, byte for byte.

    Attributes:
        t: time since the start of the recording, in seconds.
        connection: number of the connection, from 1.
        data: text of a text frame, bytes of a binary frame.
        invalid: True for a text frame that is not valid UTF-8; `data` holds its bytes.
    """

    t: float
    connection: int
    sender: Side
    data: str | bytes
    invalid: bool = False


@dataclass(frozen=True, slots=True)
class Event:
    """A change of a connection between a client and the chassis, such as its end.

    Attributes:
        t: time since the start of the recording, in seconds.
        connection: number of the connection, from 1.
        kind: `open`, `close`, `refused` (a client connected, but the chassis could not be reached)
            or `unreadable` (the rest of one direction cannot be parsed into frames).
        by: side that caused the event.
        text: explanation for people, e.g. the client's address; may be empty.
    """

    t: float
    connection: int
    kind: EventKind
    by: Side
    text: str = ""


Record = Frame | Event


@dataclass(frozen=True)
class Recording:
    """Contents of a recording.

    Attributes:
        address: address of the recorded chassis.
        started: Unix time of the start, in seconds.
        records: frames and events, in the order of the files.
        damage: why the end of a file, or of several, is missing; empty if all are complete.
        missing_parts: zero-based numbers of the missing files of a split recording. Files missing
            at its end cannot be detected.
    """

    address: str
    started: float
    records: tuple[Record, ...]
    damage: str = ""
    missing_parts: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class Channel:
    """A channel of an MCAP file; it is registered in a file with its first message there.

    Attributes:
        topic: name of the channel.
        schema_name: name of the messages' type.
        schema: definition of the type and of all types that it uses.
        schema_encoding: language of the definition, by MCAP's name, e.g. `protobuf` or `ros2msg`.
        message_encoding: encoding of the messages, by MCAP's name, e.g. `protobuf` or `cdr`.
        metadata: further properties, e.g. the QoS profiles of a ROS topic.
    """

    topic: str
    schema_name: str
    schema: bytes
    schema_encoding: str = SchemaEncoding.Protobuf
    message_encoding: str = MessageEncoding.Protobuf
    metadata: dict[str, str] = field(default_factory=dict)


def protobuf_channel(topic: str, cls: Any) -> Channel:
    """Return a channel for messages of a protobuf class."""
    schema = build_file_descriptor_set(cls).SerializeToString()
    return Channel(topic, cls.DESCRIPTOR.full_name, schema)


METADATA = "woosh_robot_agent"
"""Name of the metadata with the version of the layout, the robot's address and the start."""
ROBOT_METADATA = "robot"
"""Name of the metadata with the robot's number, model and software."""
VERSION = "2"
"""Version of the layout."""
ROS_PROFILE = "ros2"
"""MCAP profile of the files of ROS topics, by which rosbag2 knows them."""
_PROTO = """
name: "woosh_robot_agent.recording.proto"
package: "woosh_robot_agent.recording"
syntax: "proto3"
message_type {
  name: "Frame"
  field { number: 1 name: "connection" type: TYPE_UINT32 }
  field { number: 2 name: "sender" type: TYPE_STRING }
  # a text frame, a binary frame, or a text frame that is not valid UTF-8
  field { number: 3 name: "text" type: TYPE_STRING oneof_index: 0 }
  field { number: 4 name: "binary" type: TYPE_BYTES oneof_index: 0 }
  field { number: 5 name: "invalid_text" json_name: "invalid_text" type: TYPE_BYTES oneof_index: 0 }
  oneof_decl { name: "content" }
}
message_type {
  name: "ConnectionEvent"
  field { number: 1 name: "connection" type: TYPE_UINT32 }
  field { number: 2 name: "kind" type: TYPE_STRING }
  field { number: 3 name: "by" type: TYPE_STRING }
  field { number: 4 name: "text" type: TYPE_STRING }
}
"""
"""The message types of the recorder's own channels, as a FileDescriptorProto in text format."""


def _compile() -> dict[str, Any]:
    """Return the message classes of `_PROTO` by name.

    The classes are not in the default pool of descriptors, and not in `pb`, which holds only the
    chassis's messages.
    """
    file = text_format.Parse(_PROTO, FileDescriptorProto())
    pool = DescriptorPool()
    pool.Add(file)
    # protobuf before 4.22 has only MessageFactory
    make: Any = getattr(message_factory, "GetMessageClass", None) or (
        message_factory.MessageFactory(pool).GetPrototype  # type: ignore[attr-defined]
    )
    names = [message.name for message in file.message_type]
    return {name: make(pool.FindMessageTypeByName(f"{file.package}.{name}")) for name in names}


_CLASSES = _compile()
FrameMessage = _CLASSES["Frame"]
"""Message on `FRAMES`."""
EventMessage = _CLASSES["ConnectionEvent"]
"""Message on `EVENTS`."""
FRAMES = protobuf_channel("/frames", FrameMessage)
"""All frames, byte for byte and in order."""
EVENTS = protobuf_channel("/connections", EventMessage)
"""Begin and end of the connections, in order with the frames."""
