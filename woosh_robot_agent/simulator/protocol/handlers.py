"""Types of request handlers, and helpers for handlers."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

from google.protobuf.message import Message

from woosh_robot_agent.pb.util import common_pb2
from woosh_robot_agent.simulator import refusals
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.refusals import RefusedError
from woosh_robot_agent.simulator.scenes.scene import Scene
from woosh_robot_agent.simulator.world.geometry import Pose
from woosh_robot_agent.simulator.world.maps import Map, Mark

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


MAX_POSES = 200
"""Maximum number of poses in a request. Each pose may need a search of the whole map."""


def pose(message: common_pb2.Pose2D) -> Pose:
    """Convert a message to a pose."""
    return Pose(message.x, message.y, message.theta)


def poses(messages: Iterable[common_pb2.Pose2D]) -> list[Pose]:
    """Convert messages to poses.

    Raises:
        RefusedError: there are more than `MAX_POSES` poses.
    """
    converted = [pose(message) for message in messages]
    if len(converted) > MAX_POSES:
        raise RefusedError(f"{len(converted)} poses are more than {MAX_POSES}: send fewer")
    return converted


def named_scene(chassis: Chassis, name: str) -> Scene:
    """Return the scene called `name`, or the current scene if `name` is empty.

    Raises:
        RefusedError: there is no such scene.
    """
    scene = chassis.scenes.get(name) if name else chassis.scene
    if scene is None:
        raise RefusedError(
            f"unknown scene {name}: use one of {', '.join(chassis.scenes)}, or upload it by "
            "SwitchMap with file_datas"
        )
    return scene


def named_map(scene: Scene, name: str) -> Map:
    """Return the map called `name` of a scene, or its first map if `name` is empty.

    Raises:
        RefusedError: there is no such map.
    """
    area = scene.map(name)
    if area is None:
        maps = ", ".join(each.name for each in scene.maps)
        raise RefusedError(f"unknown map {name} of scene {scene.name}, which has {maps}")
    return area


def named_mark(chassis: Chassis, number: str) -> Mark:
    """Return the mark of the current map with this number; raise RefusedError if there is none."""
    mark = chassis.map.marks.get(number)
    if mark is None:
        known = ", ".join(chassis.map.marks) or "none"
        raise RefusedError(
            f"unknown mark {number} in map {chassis.map.name}: its marks are {known}"
        )
    return mark


def require_map_changeable(chassis: Chassis) -> None:
    """Check that the current map may change: nothing that depends on it runs or is paused.

    Raises:
        RefusedError: a task runs or is paused, an action drives, or a navigation is paused.
    """
    # A paused task or navigation would continue to a target on the old map.
    if chassis.tasks.paused:
        raise RefusedError(refusals.MAP_CHANGE_WHILE_PAUSED, task=chassis.tasks.proc.robot_task_id)
    if chassis.tasks.active or chassis.tasks.between_tasks:
        raise RefusedError(refusals.MAP_CHANGE_DURING_TASK)
    if chassis.ownership.driver:
        raise RefusedError(refusals.MAP_CHANGE_WHILE_DRIVING, driver=chassis.ownership.driver)
    if chassis.ownership.navigation:
        raise RefusedError(refusals.MAP_CHANGE_WHILE_NAVIGATION_PAUSED)


_MIN_SPEED = 0.01
"""Minimum speed of steps and navigation, in m/s or rad/s."""


_ROUNDING = 1e-6
"""Rounding error of a speed that clients send with single precision, in m/s or rad/s."""


def usable_speed(speed: float, minimum: float = _MIN_SPEED) -> float:
    """Return the absolute value of a requested speed; 0, which stands for the default, stays 0.

    Raises:
        RefusedError: the speed is slower than `minimum`, but not 0.
    """
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
