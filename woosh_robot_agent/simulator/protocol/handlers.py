"""What a request's handler is, and helpers that several of them need."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.pb.util import common_pb2
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.errors import RefusedError
from woosh_robot_agent.simulator.world.geometry import Pose

#: The answer's body, or a text that goes with an empty one, or None for just an empty one.
Result = Message | str | None

#: Takes the chassis and the request, which is of the type that it is registered for; raises
#: `RefusedError` if the chassis does not do it.
Handler = Callable[[Chassis, Any], Result]

#: Handlers by the message class of the request.
Handlers = dict[type[Message], Handler]

#: Poses that one request may have: each leg may need a search of the whole map.
MAX_POSES = 200


def pose(message: common_pb2.Pose2D) -> Pose:
    """A pose from a message."""
    return Pose(message.x, message.y, message.theta)


def poses(messages: Iterable[common_pb2.Pose2D]) -> list[Pose]:
    """Poses from messages.

    Raises:
        RefusedError: There are too many to plan with.
    """
    found = [pose(message) for message in messages]
    if len(found) > MAX_POSES:
        raise RefusedError(f"{len(found)} poses are more than {MAX_POSES}: give fewer")
    return found


def usable_speed(speed: float, least: float) -> float:
    """The size of a speed that a client asks for; 0 stands for the usual one.

    Raises:
        RefusedError: It is so slow that nothing would ever be done.
    """
    if 0.0 < abs(speed) < least:
        raise RefusedError(f"speed {speed:g} is too slow: {least:g} is the least, 0 the usual one")
    return abs(speed)


def copied(message: Message) -> Message:
    """A copy, so that the state cannot be changed through an answer."""
    copy = type(message)()
    copy.CopyFrom(message)
    return copy


def non_finite(message: Message, path: str = "") -> str:
    """The path of a number in `message` that is NaN or infinite, empty if there is none."""
    for field, value in message.ListFields():
        name = f"{path}.{field.name}" if path else field.name
        many = hasattr(value, "append") or hasattr(value, "extend")
        for index, item in enumerate(value if many else [value]):
            place = f"{name}[{index}]" if many else name
            if isinstance(item, Message):
                found = non_finite(item, place)
                if found:
                    return found
            elif isinstance(item, float) and not math.isfinite(item):
                return place
    return ""
