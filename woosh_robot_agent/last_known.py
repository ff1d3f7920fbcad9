"""The last value that the chassis gave of each kind, for when it cannot be asked."""

from __future__ import annotations

from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.endpoints import TOPICS
from woosh_robot_agent.link import Body, ChassisClient
from woosh_robot_agent.link.codecs.frames import FrameError
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo, RobotState
from woosh_robot_agent.protos import full_name, message_type

_INFO = full_name(RobotInfo)
_INFO_FIELDS = {
    field.message_type.full_name: field.name
    for field in RobotInfo.DESCRIPTOR.fields
    if field.message_type is not None
}


def is_part_of_info(cls: type[Message]) -> bool:
    """Whether RobotInfo has a message of this class."""
    return cls.DESCRIPTOR.full_name in _INFO_FIELDS


def parts_of(info: RobotInfo) -> list[Message]:
    """What a RobotInfo says, as the messages that are pushed one by one; only what it holds."""
    parts: list[Message] = [
        getattr(info, name) for name in _INFO_FIELDS.values() if info.HasField(name)
    ]
    if info.state:  # a bare enum there, a message of its own as a push
        parts.append(RobotState(state=info.state))
    return parts


class LastKnown:
    """Remembers what the chassis last said, by protobuf full name. Used in the link's thread.

    Args:
        chassis: what it pushes is remembered; None where somebody else calls `remember`.
    """

    def __init__(self, chassis: ChassisClient | None) -> None:
        self._values: dict[str, Message] = {}
        self._unread: dict[str, Message | Body] = {}
        """What was said since somebody last looked: the last of each type, the oldest first."""
        if chassis is None:
            return
        chassis.on_snapshot(self.remember)
        for topic in TOPICS:
            chassis.subscribe_raw(message_type(topic.push), self.remember)

    def get(self, name: str) -> Message | None:
        """The last value of the type called `name`, or None."""
        self._read()
        return self._values.get(name)

    def remember(self, said: Message | Body) -> None:
        """Keep an answer or a push of the chassis. It is read when somebody looks."""
        name = said.type if isinstance(said, Body) else full_name(said)
        if name == _INFO:  # it may lack what an earlier one has
            self._read()
        self._unread.pop(name, None)
        self._unread[name] = said

    def _read(self) -> None:
        unread, self._unread = self._unread, {}
        for said in unread.values():
            try:
                self._apply(said.message() if isinstance(said, Body) else said)
            except FrameError:  # the body has told of it
                continue

    def _apply(self, message: Message) -> None:
        """Take a value, and keep RobotInfo and its parts in step."""
        if isinstance(message, RobotInfo):
            own = RobotInfo()  # it changes with each of its parts; the caller's must not
            own.CopyFrom(message)
            self._values[_INFO] = own
            self._values.update((full_name(part), part) for part in parts_of(message))
            return
        name = full_name(message)
        self._values[name] = message
        info: Any = self._values.get(_INFO)
        if info is None:
            return
        if isinstance(message, RobotState):
            info.state = message.state
        elif name in _INFO_FIELDS:
            getattr(info, _INFO_FIELDS[name]).CopyFrom(message)
