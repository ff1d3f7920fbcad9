"""Handlers of requests: their registration, the dispatch of requests, and helpers for handlers."""

from __future__ import annotations

import logging
import math
from collections import ChainMap
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from google.protobuf.message import Message

from woosh_robot_agent.pb.util import common_pb2
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.refusals import RefusedError
from woosh_robot_agent.simulator.scenes.scene import Scene
from woosh_robot_agent.simulator.status_codes import Code
from woosh_robot_agent.simulator.world.geometry import Pose
from woosh_robot_agent.simulator.world.maps import Mark

_LOG = logging.getLogger(__name__)

Result = Message | str | None
"""Content of the answer: a body, a text (then the body is empty), or None (both are empty)."""

Handler = Callable[[Chassis, Any], Result]
"""Executes a request of the type for which it is registered. Raises `RefusedError` to refuse."""

QUERIES: dict[str, Handler] = {}
"""Handlers of requests that only read values, by full protobuf name; see `query`."""

COMMANDS: dict[str, Handler] = {}
"""Handlers of all other requests, by full protobuf name; see `command`."""

H = TypeVar("H", bound=Handler)


def query(request: type[Message]) -> Callable[[H], H]:
    """Make the decorated function the handler of a request that only reads values."""
    return _registering(QUERIES, request)


def command(request: type[Message]) -> Callable[[H], H]:
    """Make the decorated function the handler of a request that may change something."""
    return _registering(COMMANDS, request)


def _registering(handlers: dict[str, Handler], request: type[Message]) -> Callable[[H], H]:
    """Return a decorator that adds a handler of `request` to `handlers`."""

    def add(handler: H) -> H:
        handlers[request.DESCRIPTOR.full_name] = handler
        return handler

    return add


SUCCESS = "Request succeed"
"""Text of the answer to an executed command, as the real robot words it."""


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer to a request.

    Attributes:
        type: full protobuf name of the body; without a body, that of the request, or `error` if
            the request is unknown.
        body: body, None for an empty body.
        ok: True if the request was executed, or if its refusal is `harmless` and explained.
        msg: text for people; the reason if the request was refused; empty for most queries.
        code: status code that follows the answer, None if there is none.
    """

    type: str
    body: Message | None
    ok: bool
    msg: str
    code: Code | None = None


HANDLERS: Mapping[str, Handler] = ChainMap(QUERIES, COMMANDS)
"""All handlers, by full protobuf name."""


def dispatch(chassis: Chassis, request: Message) -> Answer:
    """Execute or refuse a request, whose type must be in `HANDLERS`, and return the answer."""
    name = request.DESCRIPTOR.full_name
    text = chassis.profile.refusals.always.get(name)  # this robot model refuses the type
    if text is not None:
        return Answer(name, None, ok=False, msg=text)
    try:
        path = non_finite(request)
        if path:
            raise RefusedError(f"{path} is not a finite number")
        if name in COMMANDS:
            chassis.auto_tasks.postpone()
        result = HANDLERS[name](chassis, request)
    except RefusedError as error:
        return _answer_refused(chassis, name, error)
    if isinstance(result, str):
        explained = chassis.profile.refusals.explained
        return Answer(name, None, ok=True, msg=result if explained else SUCCESS)
    msg = "" if name in QUERIES else SUCCESS
    if result is None:
        return Answer(name, None, ok=True, msg=msg)
    return Answer(result.DESCRIPTOR.full_name, result, ok=True, msg=msg)


def _answer_refused(chassis: Chassis, name: str, error: RefusedError) -> Answer:
    """Return the answer to a request that its handler has refused, worded as in the profile."""
    refusal, profile = error.refusal, chassis.profile.refusals
    _LOG.info("%s is refused: %s", name, error)
    if profile.explained:
        return Answer(name, None, ok=refusal.harmless, msg=str(error))
    words = profile.texts.get(name, refusal.words)
    code = refusal.code if profile.codes else None
    return Answer(name, None, ok=False, msg=words, code=code)


def refusal_answer(name: str, reason: str) -> Answer:
    """Return the answer to a request of the type `name` that is refused without a handler."""
    return Answer(name if name in HANDLERS else "error", None, ok=False, msg=reason)


MAX_POSES = 200
"""Maximum number of poses in a request. Each pose may need a search of the whole map."""


def pose(message: common_pb2.Pose2D) -> Pose:
    """Convert a message to a pose."""
    return Pose(message.x, message.y, message.theta)


def poses(messages: Iterable[common_pb2.Pose2D]) -> list[Pose]:
    """Convert messages to poses, of which there may be `MAX_POSES`."""
    converted = [pose(message) for message in messages]
    if len(converted) > MAX_POSES:
        raise RefusedError(f"{len(converted)} poses are more than {MAX_POSES}: send fewer")
    return converted


def named_scene(chassis: Chassis, name: str) -> Scene:
    """Return the scene called `name`, or the current scene if `name` is empty."""
    scene = chassis.scenes.get(name) if name else chassis.scene
    if scene is None:
        raise RefusedError(
            f"unknown scene {name}: use one of {', '.join(chassis.scenes)}, or upload it by "
            "SwitchMap with file_datas"
        )
    return scene


def named_mark(chassis: Chassis, number: str) -> Mark:
    """Return the mark of the current map with this number; raise RefusedError if there is none."""
    mark = chassis.map.marks.get(number)
    if mark is None:
        known = ", ".join(chassis.map.marks) or "none"
        raise RefusedError(
            f"unknown mark {number} in map {chassis.map.name}: its marks are {known}"
        )
    return mark


_MIN_SPEED = 0.01
"""Minimum speed of steps and navigation, in m/s or rad/s."""


_ROUNDING = 1e-6
"""Rounding error of a speed that clients send with single precision, in m/s or rad/s."""


def usable_speed(speed: float, minimum: float = _MIN_SPEED) -> float:
    """Return the absolute value of a speed: at least `minimum`, or 0, which means the default."""
    if 0.0 < abs(speed) < minimum - _ROUNDING:
        raise RefusedError(
            f"speed {speed:g} is too slow: use at least {minimum:g}, or 0 for the default"
        )
    return abs(speed)


def non_finite(message: Message, path: str = "") -> str:
    """Return the path of the first NaN or infinite number in `message`, empty if there is none."""
    for field, value in message.ListFields():
        name = f"{path}.{field.name}" if path else field.name
        is_repeated = hasattr(value, "extend")  # only the value of a repeated field has it
        for index, item in enumerate(value if is_repeated else [value]):
            item_path = f"{name}[{index}]" if is_repeated else name
            if isinstance(item, Message):
                inner = non_finite(item, item_path)
                if inner:
                    return inner
            elif isinstance(item, float) and not math.isfinite(item):
                return item_path
    return ""
