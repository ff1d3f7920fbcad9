"""The commands that a page can give a robot, and the request that each command sends."""

from __future__ import annotations

import math
import time
import unicodedata
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from google.protobuf.message import Message

from woosh_robot_agent.pb.robot import robot_pack_pb2 as pack
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo
from woosh_robot_agent.pb.robot.robot_setting_pb2 import Sound
from woosh_robot_agent.pb.util import action_pb2 as action
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.pb.util import task_pb2 as task
from woosh_robot_agent.sentences import Sentence
from woosh_robot_agent.tools.dashboard.texts import page_text

Args = Mapping[str, Any]
"""Arguments of a command, as the page sends them."""
_NO_NUMBER = Sentence("{name} is not a number within {least} to {greatest}")
_NOT_WHOLE = Sentence("{name} is not a whole number within 0 to {greatest}")
_NO_TEXT = Sentence("{name} is not a text of at most {length} characters")
_NO_TRUTH = Sentence("{name} is not true or false")
_NO_CHOICE = Sentence("{name} is not one of {choices}")
_MAX_TEXT = 200
"""Maximum length of a text."""
_MAX_COORDINATE = 1e5
"""Maximum coordinate, in metres."""
_MAX_NUMBER = 2**32 - 1
"""Maximum number of a task kind, and of a light effect: that of the protocol."""


class CommandError(ValueError):
    """A command is refused; the text says why."""


# The functions below that read an argument raise a CommandError if it is not valid.


def number(args: Args, name: str, limit: float, least: float | None = None) -> float:
    """Return an argument that is a number from `least`, by default -`limit`, to `limit`."""
    value = args.get(name)
    least = -limit if least is None else least
    valid = isinstance(value, int | float) and not isinstance(value, bool)
    if not valid or not least <= value <= limit:  # type: ignore[operator]
        raise _invalid(_NO_NUMBER(name=name, least=f"{least:g}", greatest=f"{limit:g}"))
    return float(value)  # type: ignore[arg-type]


def _invalid(text: str) -> CommandError:
    return CommandError(page_text("reason.invalid", text=text))


def _whole(args: Args, name: str, limit: int) -> int:
    """Return an argument that is a whole number from 0 to `limit`; 0 if it is missing."""
    value = args.get(name, 0)
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= limit:
        raise _invalid(_NOT_WHOLE(name=name, greatest=limit))
    return value


def _text(args: Args, name: str) -> str:
    """Return an argument that is a text of at most `_MAX_TEXT` characters; see `_is_no_text`."""
    text = args.get(name)
    if not isinstance(text, str) or len(text) > _MAX_TEXT or any(map(_is_no_text, text)):
        raise _invalid(_NO_TEXT(name=name, length=_MAX_TEXT))
    return text


def _is_no_text(character: str) -> bool:
    """Return True for a control character and for a surrogate, i.e. half a character."""
    return unicodedata.category(character) in ("Cc", "Cs")


def _truth(args: Args, name: str) -> bool:
    """Return an argument that is true or false."""
    value = args.get(name)
    if not isinstance(value, bool):
        raise _invalid(_NO_TRUTH(name=name))
    return value


# The stubs of protobuf do not accept a number for an enum. So the commands look up the name of the
# number that `_choice` returns.


def _choice(args: Args, name: str, choices: Mapping[str, int], default: str | None = None) -> int:
    """Return the number of the choice that an argument names.

    Args:
        choices: number of each choice.
        default: choice if the argument is missing; None if it must not be missing.
    """
    value = args.get(name, default)
    if not isinstance(value, str) or value not in choices:
        raise _invalid(_NO_CHOICE(name=name, choices=", ".join(choices)))
    return choices[value]


def set_pose(pose: Any, args: Args) -> None:
    """Set a pose from arguments."""
    pose.x = number(args, "x", _MAX_COORDINATE)
    pose.y = number(args, "y", _MAX_COORDINATE)
    pose.theta = number(args, "theta", math.tau)


_TYPES = {
    "pick": task.kPick,
    "parking": task.kParking,
    "charge": task.kCharge,
    "carry": task.kCarry,
}
_DIRECTIONS = {
    "unknown": task.kDirectionUndefined,
    "feeding": task.kFeeding,
    "cutting": task.kCutting,
}


def _task(args: Args, default: str) -> pack.ExecTask:
    """Return a task without a place; `default` is its type if the arguments have none."""
    return pack.ExecTask(
        task_id=int(time.time() * 1000),  # the robot repeats it in its reports
        type=task.Type.Name(_choice(args, "type", _TYPES, default)),
        task_type_no=_whole(args, "number", _MAX_NUMBER),
        direction=task.Direction.Name(_choice(args, "direction", _DIRECTIONS, "unknown")),
    )


def _go(args: Args, _info: RobotInfo) -> Message:
    request = _task(args, "pick")
    set_pose(request.pose, args)
    return request


def _go_to_mark(args: Args, _info: RobotInfo) -> Message:
    request = _task(args, "pick")
    request.mark_no = _text(args, "mark")
    return request


def _tell_pose(args: Args, info: RobotInfo) -> Message:
    """Return the request that sets the robot's pose: InitRobot if it is not initialised."""
    request = pack.InitRobot() if info.state == robot.kUninit else pack.SetRobotPose()
    set_pose(request.pose, args)
    return request


def _control_mode(args: Args, _info: RobotInfo) -> Message:
    modes = {"auto": robot.kAuto, "manual": robot.kManual, "maintain": robot.kMaintain}
    return pack.SwitchControlMode(mode=robot.ControlMode.Name(_choice(args, "mode", modes)))


def _work_mode(args: Args, _info: RobotInfo) -> Message:
    modes = {
        "deploy": robot.kDeployMode,
        "task": robot.kTaskMode,
        "schedule": robot.kScheduleMode,
    }
    return pack.SwitchWorkMode(mode=robot.WorkMode.Name(_choice(args, "mode", modes)))


def _sound(args: Args, _info: RobotInfo) -> Message:
    return Sound(mute=_truth(args, "mute"), volume=_whole(args, "volume", 100))


def _light(args: Args, _info: RobotInfo) -> Message:
    effect, color = _whole(args, "effect", _MAX_NUMBER), _whole(args, "color", 0xFFFFFF)
    return pack.LED(normal=effect, color=color)


def _switch_map(args: Args, _info: RobotInfo) -> Message:
    return pack.SwitchMap(scene_name=_text(args, "scene"), map_name=_text(args, "map"))


def _build_map(args: Args, _info: RobotInfo) -> Message:
    kinds = {"add": pack.BuildMap.kAdd, "update": pack.BuildMap.kUpdate}
    kind = pack.BuildMap.BuildType.Name(_choice(args, "type", kinds))
    return pack.BuildMap(type=kind, scene_name=_text(args, "scene"), map_name=_text(args, "map"))


class Command(NamedTuple):
    """A command that the page can give.

    Attributes:
        request: makes the request from the arguments and the state of the robot; raises a
            `CommandError` if the arguments are not valid.
        interrupts: True if the command only ends or interrupts a motion, so that it is never too
            old to be sent.
        on_map: True if the command has a place or mark on a map. The arguments `scene`, `map` and
            `version` name this map, and the robot must use it.
    """

    request: Callable[[Args, RobotInfo], Message]
    interrupts: bool = False
    on_map: bool = False


COMMANDS: Mapping[str, Command] = MappingProxyType(
    {
        "go": Command(_go, on_map=True),
        "goMark": Command(_go_to_mark, on_map=True),
        "charge": Command(lambda args, _: _task(args, "charge")),  # the robot chooses where
        "setPose": Command(_tell_pose, on_map=True),
        # the robot takes the pose that it had when it was switched off
        "keepPose": Command(lambda *_: pack.InitRobot(is_record=True)),
        "pause": Command(lambda *_: pack.ActionOrder(order=action.kPause), interrupts=True),
        "continue": Command(lambda *_: pack.ActionOrder(order=action.kContinue)),
        "endWait": Command(lambda *_: pack.ActionOrder(order=action.kWaitBreak)),
        "cancel": Command(lambda *_: pack.ActionOrder(order=action.kCancel), interrupts=True),
        "controlMode": Command(_control_mode),
        "workMode": Command(_work_mode),
        "speak": Command(lambda args, _: pack.Speak(text=_text(args, "text"))),
        "sound": Command(_sound),
        "light": Command(_light),
        "switchMap": Command(_switch_map),
        "buildMap": Command(_build_map),
        "saveMap": Command(lambda *_: pack.BuildMap(type=pack.BuildMap.kSave)),
        "discardMap": Command(lambda *_: pack.BuildMap(type=pack.BuildMap.kCanel)),  # spelled so
        "collectMark": Command(lambda *_: pack.Deployment(type=pack.kMark, mode=pack.kDepCollect)),
    }
)
"""All commands that send one request to the robot, by name."""
