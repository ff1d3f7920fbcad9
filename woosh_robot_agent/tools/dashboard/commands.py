"""The commands that the page can give a robot, and the requests that they become."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.pb.robot.robot_pack_pb2 import (
    ActionOrder,
    ExecTask,
    InitRobot,
    SetRobotPose,
    Speak,
    SwitchControlMode,
    SwitchWorkMode,
)
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo
from woosh_robot_agent.pb.util import action_pb2 as action
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.pb.util import task_pb2 as task

_MAX_TEXT = 200
"""Maximum length of a text."""
_MAX_COORDINATE = 1e5
"""Greatest coordinate, in metres."""
INTERRUPTING = frozenset({"pause", "cancel"})
"""Names of the commands that only end or interrupt a motion: they are never too old to be sent."""


class CommandError(ValueError):
    """A command is refused."""


def request_for(name: str, args: Mapping[str, Any], info: RobotInfo) -> Message:
    """Return the request for a command of the page.

    Args:
        name: name of the command.
        args: arguments of the command.
        info: state of the robot.

    Raises:
        CommandError: the page of this program gives no such command.
    """
    try:
        make = _REQUESTS[name]
    except KeyError:
        raise CommandError("there is no such command") from None
    return make(args, info)


def _go(args: Mapping[str, Any], _info: RobotInfo) -> Message:
    request = ExecTask(task_id=_task_id(), type=task.kPick)
    _set_pose(request.pose, args)
    return request


def _go_to_mark(args: Mapping[str, Any], _info: RobotInfo) -> Message:
    return ExecTask(task_id=_task_id(), type=task.kPick, mark_no=_text(args, "mark"))


def _tell_pose(args: Mapping[str, Any], info: RobotInfo) -> Message:
    """Return the request that tells the robot its pose; before the initialisation, another one."""
    request = InitRobot() if info.state == robot.kUninit else SetRobotPose()
    _set_pose(request.pose, args)
    return request


def _order(order: Any) -> Callable[[Mapping[str, Any], RobotInfo], Message]:
    return lambda args, info: ActionOrder(order=order)


def _control_mode(args: Mapping[str, Any], _info: RobotInfo) -> Message:
    mode = _choice(args, "mode", (robot.kAuto, robot.kManual, robot.kMaintain))
    return SwitchControlMode(mode=robot.ControlMode.Name(mode))


def _work_mode(args: Mapping[str, Any], _info: RobotInfo) -> Message:
    mode = _choice(args, "mode", (robot.kDeployMode, robot.kTaskMode, robot.kScheduleMode))
    return SwitchWorkMode(mode=robot.WorkMode.Name(mode))


def _speak(args: Mapping[str, Any], _info: RobotInfo) -> Message:
    return Speak(text=_text(args, "text"))


_REQUESTS: Mapping[str, Callable[[Mapping[str, Any], RobotInfo], Message]] = MappingProxyType(
    {
        "go": _go,
        "goMark": _go_to_mark,
        "setPose": _tell_pose,
        "pause": _order(action.kPause),
        "continue": _order(action.kContinue),
        "cancel": _order(action.kCancel),
        "controlMode": _control_mode,
        "workMode": _work_mode,
        "speak": _speak,
    }
)
"""Functions that make the requests, by the name of the command."""


def number(args: Mapping[str, Any], name: str, limit: float) -> float:
    """Return an argument that is a number.

    Raises:
        CommandError: it is not a number within -`limit` to `limit`.
    """
    value = args.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= limit:
        raise CommandError(f"{name} is not a number within {-limit:g} to {limit:g}")
    return float(value)


def _set_pose(pose: Any, args: Mapping[str, Any]) -> None:
    pose.x = number(args, "x", _MAX_COORDINATE)
    pose.y = number(args, "y", _MAX_COORDINATE)
    pose.theta = number(args, "theta", math.tau)


def _text(args: Mapping[str, Any], name: str) -> str:
    text = args.get(name)
    if not isinstance(text, str) or len(text) > _MAX_TEXT or not text.isprintable():
        raise CommandError(f"{name} is not a text of at most {_MAX_TEXT} characters")
    return text


def _choice(args: Mapping[str, Any], name: str, valid: tuple[int, ...]) -> int:
    value = args.get(name)
    if isinstance(value, bool) or not isinstance(value, int) or value not in valid:
        raise CommandError(f"{name} is not one of {', '.join(map(str, valid))}")
    return value


def _task_id() -> int:
    """Return an id for a task, which the robot repeats in its reports."""
    return int(time.time() * 1000)
