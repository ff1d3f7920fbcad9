"""The last known value of each message type that the chassis reports."""

from __future__ import annotations

from typing import Any, TypeVar

from google.protobuf.message import Message

from woosh_robot_agent.endpoints import TOPICS
from woosh_robot_agent.link import Body, ChassisClient, FrameError
from woosh_robot_agent.link.protos import full_name, message_type
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo, RobotState

M = TypeVar("M", bound=Message)
_INFO = full_name(RobotInfo)
_INFO_FIELDS = {
    field.message_type.full_name: field.name
    for field in RobotInfo.DESCRIPTOR.fields
    if field.message_type is not None
}
"""Names of RobotInfo's message fields, by the full name of their type."""


def is_part_of_info(cls: type[Message]) -> bool:
    """Return True if RobotInfo has a field of this class."""
    return cls.DESCRIPTOR.full_name in _INFO_FIELDS


def parts_of(info: RobotInfo) -> list[Message]:
    """Return the parts that are present in a RobotInfo, as the messages that the chassis pushes.

    An absent `task_proc` is a part, too: it says that the robot has no task.
    """
    parts: list[Message] = [
        getattr(info, name)
        for name in _INFO_FIELDS.values()
        if info.HasField(name) or name == "task_proc"
    ]
    if info.state:  # an enum in RobotInfo, but pushed as a message of its own
        parts.append(RobotState(state=info.state))
    return parts


class LastKnown:
    """Store of the last known values, by protobuf full name. Use it in the link thread only.

    Args:
        chassis: source of pushes and snapshots; None if all values come from calls of `remember`.
    """

    def __init__(self, chassis: ChassisClient | None = None) -> None:
        self._values: dict[str, Message] = {}
        """Decoded values; RobotInfo as it was received."""
        self._pushed: dict[str, Message] = {}
        """Parts of RobotInfo that came after it."""
        self._merged: RobotInfo | None = None
        """RobotInfo with the newer parts; None after a change, until somebody asks for it."""
        self._unread: dict[str, Message | Body] = {}
        """Values that `_apply` has not stored yet, the last one of each type, the oldest first.

        They are decoded and stored when somebody asks for a value.
        """
        if chassis is None:
            return
        chassis.on_snapshot(self.remember)
        for topic in TOPICS:
            if not topic.on_demand:
                chassis.subscribe_raw(message_type(topic.push), self.remember)

    def get(self, name: str) -> Message | None:
        """Return the last value of a type, given by its protobuf full name; None without one."""
        self._apply_unread()
        return self._robot_info() if name == _INFO else self._values.get(name)

    def value(self, cls: type[M]) -> M | None:
        """Return the last value of a message class; None without one."""
        value = self.get(full_name(cls))
        return value if isinstance(value, cls) else None

    def remember(self, value: Message | Body) -> None:
        """Store an answer or push of the chassis; `get` decodes it."""
        name = value.type if isinstance(value, Body) else full_name(value)
        if name == _INFO:  # an earlier, unread RobotInfo may have parts that this one lacks
            self._apply_unread()
        self._unread.pop(name, None)  # the new value goes to the end
        self._unread[name] = value

    def _apply_unread(self) -> None:
        """Decode and store the values that came since the last call."""
        unread, self._unread = self._unread, {}
        for value in unread.values():
            try:
                self._apply(value.message() if isinstance(value, Body) else value)
            except FrameError:  # already counted and logged by `Body`
                continue

    def _apply(self, message: Message) -> None:
        """Store a decoded value, and update RobotInfo or its parts."""
        name = full_name(message)
        self._values[name] = message
        if isinstance(message, RobotInfo):
            self._pushed.clear()
            self._values.update((full_name(part), part) for part in parts_of(message))
        elif name in _INFO_FIELDS or isinstance(message, RobotState):
            self._pushed[name] = message
        else:
            return
        self._merged = None

    def _robot_info(self) -> RobotInfo | None:
        """Return RobotInfo with the newer parts.

        Each change creates a new message, because protobuf keeps the memory of replaced values.
        """
        received = self._values.get(_INFO)
        if self._merged is None and received is not None:
            info: Any = RobotInfo()
            info.CopyFrom(received)
            for name, part in self._pushed.items():
                if isinstance(part, RobotState):  # an enum in RobotInfo
                    info.state = part.state
                else:
                    getattr(info, _INFO_FIELDS[name]).CopyFrom(part)
            self._merged = info
        return self._merged
