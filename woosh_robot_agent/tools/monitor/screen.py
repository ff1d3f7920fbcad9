"""The monitor's screen and its keys."""

from __future__ import annotations

import asyncio
import math
import os
import sys
import termios
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from woosh_robot_agent.link.protos import enum_name
from woosh_robot_agent.link.reports import printable
from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode
from woosh_robot_agent.pb.robot.robot_pb2 import Battery, RobotInfo
from woosh_robot_agent.pb.ros.ros_pack_pb2 import Feedback
from woosh_robot_agent.pb.ros.ros_pack_pb2 import State as ActionState
from woosh_robot_agent.pb.util import action_pb2 as action
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.pb.util import task_pb2 as task
from woosh_robot_agent.robot.readiness import (
    accepts_task,
    all_objections,
    is_charging,
    pose_problem,
)
from woosh_robot_agent.robot.status_codes import explained
from woosh_robot_agent.tools.robot_view import LinkReport, RobotView

_CTRL_D = "\x04"


@contextmanager
def key_presses(on_key: Callable[[str], None]) -> Iterator[bool]:
    """Call `on_key` with each key pressed while the block runs; yield True if there is a keyboard.

    Without a terminal as stdin there is none. The terminal's settings are restored at the end. The
    loss of the terminal counts as the key Ctrl-D. Needs a running event loop.
    """
    if not sys.stdin.isatty():
        yield False
        return
    loop = asyncio.get_running_loop()
    stdin = sys.stdin.fileno()
    settings = termios.tcgetattr(stdin)

    def read() -> None:
        data = os.read(stdin, 100)
        if not data:  # the terminal is gone
            loop.remove_reader(stdin)
        for key in data.decode(errors="replace") or _CTRL_D:
            on_key(key)

    try:
        tty.setcbreak(stdin)
        loop.add_reader(stdin, read)
        yield True
    finally:
        loop.remove_reader(stdin)
        termios.tcsetattr(stdin, termios.TCSADRAIN, settings)


_GOOD, _BAD, _WARNING, _FAINT = "green", "bold red", "yellow", "dim"
_MAX_CODES = 8
"""Maximum number of status codes shown, the newest first."""
_LEVEL_STYLES = {StatusCode.kWarn: _WARNING, StatusCode.kFault: _BAD}
_TASK_STYLES = {task.kFailed: _BAD, task.kCompleted: _GOOD}
_LOW_BATTERY = 20
"""Highest charge that is shown as low, in percent."""
_UNKNOWN = Text("unknown", _FAINT)


def draw(name: str, link: LinkReport, view: RobotView, hint: str = "") -> RenderableType:
    """Return the display of a robot's state, for rich to print.

    Args:
        name: name of the source, for the title.
        hint: text below the display, e.g. which key quits.
    """
    rows = Table.grid(padding=(0, 2))
    rows.add_column(style="bold", no_wrap=True)
    rows.add_column()
    rows.add_row("link", _link(link))
    if not view.is_empty:
        for title, content in _robot(view.info):
            rows.add_row(title, content)
        for action_name, feedback in sorted(view.actions.items()):
            rows.add_row(printable(action_name), _action_feedback(feedback))
        rows.add_row("problems", _problems(view.info))
        rows.add_row("codes", _codes(view))
    style = "" if link.good else _FAINT
    outdated = not link.good and not view.is_empty
    warning = [Text("OUTDATED: this is the last known state", _BAD)] if outdated else []
    return Panel(
        Group(*warning, rows),
        title=Text(f"robot at {name}"),
        subtitle=Text(hint, _FAINT) if hint else None,
        title_align="left",
        subtitle_align="left",
        style=style,
        border_style=_GOOD if link.good else _BAD,
    )


def _link(link: LinkReport) -> Text:
    text = Text(printable(link.text), _GOOD if link.good else _BAD)
    return text.append(f"  {printable(link.detail)}" if link.detail else "", "not bold default")


def _robot(info: RobotInfo) -> list[tuple[str, Text]]:
    return [
        ("robot", _name(info)),
        ("mode", _mode(info)),
        ("new task", _new_task(info)),
        ("pose", _pose(info)),
        ("speed", _speed(info)),
        ("battery", _battery(info)),
        ("task", _task(info)),
        ("action", _task_action(info)),
    ]


def _name(info: RobotInfo) -> Text:
    general = info.genral  # spelled so in the robot's messages
    number = info.robot_id or general.serial_number
    name = info.setting.identity.name
    parts = [
        str(number) if number else "",
        general.display_model,
        name if name != str(number) else "",
        f"scene {info.scene.scene_name}" if info.scene.scene_name else "",
        f"map {info.scene.map_name}" if info.scene.map_name else "",
    ]
    text = "  ".join(printable(part) for part in parts if part)
    return Text(text) if text else _UNKNOWN


def _mode(info: RobotInfo) -> Text:
    state = enum_name(robot.State, info.state)
    if not info.HasField("mode"):
        return Text(f"state {state}")
    ctrl = enum_name(robot.ControlMode, info.mode.ctrl)
    work = enum_name(robot.WorkMode, info.mode.work)
    return Text(f"control {ctrl}   work {work}   state {state}")


def _new_task(info: RobotInfo) -> Text:
    """Return whether the robot would accept a new task, and if not, why."""
    objections = all_objections(info)
    if not objections:
        return Text("would be accepted", _GOOD) if accepts_task(info) else _UNKNOWN
    text = Text("would be rejected", _BAD)
    for objection in objections:
        text.append(f"\n- {printable(objection.reason)}", _BAD)
        text.append(f": {printable(objection.remedy)}", "not bold default")
    return text


def _pose(info: RobotInfo) -> Text:
    if not info.pose_speed.HasField("pose"):
        return _UNKNOWN
    pose = info.pose_speed.pose
    degrees = math.degrees(pose.theta)
    text = Text(
        f"x {pose.x:.3f} m   y {pose.y:.3f} m   theta {pose.theta:.3f} rad ({degrees:.1f}°)"
    )
    problem = pose_problem(info)
    return text if problem is None else text.append(f"\n{printable(problem.reason)}", _WARNING)


def _speed(info: RobotInfo) -> Text:
    if not info.HasField("pose_speed"):
        return _UNKNOWN
    twist, mileage = info.pose_speed.twist, info.pose_speed.mileage
    return Text(f"{twist.linear:.2f} m/s   {twist.angular:.2f} rad/s   {mileage} m driven in total")


def _battery(info: RobotInfo) -> Text:
    if not info.HasField("battery"):
        return _UNKNOWN
    battery = info.battery
    if is_charging(battery):
        state = enum_name(Battery.ChargeState, battery.charge_state)
        return Text(f"{battery.power} %   charging ({state})")
    return Text(f"{battery.power} %", _WARNING if battery.power <= _LOW_BATTERY else "")


def _task(info: RobotInfo) -> Text:
    proc = info.task_proc
    if not info.HasField("task_proc") or proc.state == task.kStateUndefined:
        return Text("none", _FAINT)
    parts = [
        str(proc.robot_task_id),
        enum_name(task.Type, proc.type),
        f"to {printable(proc.dest)}" if proc.dest else "",
    ]
    text = Text(" ".join(part for part in parts if part) + "   ")
    text.append(enum_name(task.State, proc.state), _TASK_STYLES.get(proc.state, "bold"))
    return text.append(f"   {printable(proc.msg)}" if proc.msg else "")


def _task_action(info: RobotInfo) -> Text:
    doing = info.task_proc.action
    if doing.type == action.kTypeUndefined:
        return Text("none", _FAINT)
    state = enum_name(action.State, doing.state)
    wait = f"   wait {doing.wait_id}" if doing.wait_id else ""
    return Text(f"{enum_name(action.Type, doing.type)}   {state}{wait}")


def _action_feedback(feedback: Feedback) -> Text:
    message = explained(feedback.code, feedback.msg) if feedback.code else feedback.msg
    text = Text(enum_name(ActionState, feedback.state))
    return text.append(f"   {printable(message)}" if message else "")


def _problems(info: RobotInfo) -> Text:
    """Return the status codes that the robot has not resolved."""
    if not info.HasField("abnormal_codes"):
        return _UNKNOWN
    lines = [
        Text(printable(explained(code.code, code.msg)), _LEVEL_STYLES.get(code.level, ""))
        for code in info.abnormal_codes.scs
    ]
    return Text("\n").join(lines) if lines else Text("none", _FAINT)


def _codes(view: RobotView) -> Text:
    if not view.codes:
        return Text("none", _FAINT)
    text = Text()
    for code in list(reversed(view.codes.values()))[:_MAX_CODES]:
        when = time.strftime("%m-%d %H:%M:%S", time.localtime(code.time / 1000))
        level = enum_name(StatusCode.Level, code.level)
        text.append(
            f"{when}  {level:<6}  {printable(explained(code.code, code.msg))}\n",
            _LEVEL_STYLES.get(code.level, ""),
        )
    text.rstrip()  # the last line feed
    return text
