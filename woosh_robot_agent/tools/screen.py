"""How the monitor looks: a view, drawn with rich."""

from __future__ import annotations

import math
import time

from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode
from woosh_robot_agent.pb.robot.robot_pb2 import Battery, RobotInfo
from woosh_robot_agent.pb.ros.ros_pack_pb2 import State as ActionState
from woosh_robot_agent.pb.util import action_pb2 as action
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.pb.util import task_pb2 as task
from woosh_robot_agent.readiness import is_taskable, objections
from woosh_robot_agent.tools.view import LinkReport, View
from woosh_robot_agent.tools.words import word

GOOD, BAD, ODD, FAINT = "green", "bold red", "yellow", "dim"
_CODES_SHOWN = 8
_LEVEL_STYLES = {StatusCode.kWarn: ODD, StatusCode.kFault: BAD}
_LOW_BATTERY = 20
_UNKNOWN = Text("not known yet", FAINT)


def draw(name: str, link: LinkReport, view: View, hint: str = "") -> RenderableType:
    """One picture of a robot.

    Args:
        name: where the view comes from.
        link: where the link stands.
        view: what is known.
        hint: what can be done with the picture.
    """
    rows = Table.grid(padding=(0, 2))
    rows.add_column(style="bold", no_wrap=True)
    rows.add_column()
    rows.add_row("link", _link(link))
    if view.known:
        for title, content in _robot(view.info):
            rows.add_row(title, content)
        for action_name in sorted(view.actions):
            rows.add_row(clean(action_name), _action(view, action_name))
        rows.add_row("codes", _codes(view))
    # what is old must not pass for new
    style = "" if link.good else FAINT
    old = [] if link.good or not view.known else [Text("OLD: what was known last", BAD)]
    return Panel(
        Group(*old, rows),
        title=Text(f"robot at {name}"),
        subtitle=Text(hint, FAINT) if hint else None,
        title_align="left",
        subtitle_align="left",
        style=style,
        border_style=GOOD if link.good else BAD,
    )


def clean(text: str) -> str:
    """A text of the robot's, without what could steer a terminal."""
    return "".join(char if char.isprintable() else "�" for char in text)


def _link(link: LinkReport) -> Text:
    text = Text(clean(link.text), GOOD if link.good else BAD)
    return text.append(f"  {clean(link.detail)}" if link.detail else "", "not bold default")


def _robot(info: RobotInfo) -> list[tuple[str, Text]]:
    return [
        ("robot", _name(info)),
        ("mode", _mode(info)),
        ("a task", _taskable(info)),
        ("pose", _pose(info)),
        ("speed", _speed(info)),
        ("battery", _battery(info)),
        ("task", _task(info)),
        ("action", _task_action(info)),
    ]


def _name(info: RobotInfo) -> Text:
    general, setting = info.genral, info.setting
    number = info.robot_id or general.serial_number
    parts = [
        str(number) if number else "",
        general.display_model,
        setting.identity.name if setting.identity.name != str(number) else "",
        f"scene {info.scene.scene_name}" if info.scene.scene_name else "",
        f"map {info.scene.map_name}" if info.scene.map_name else "",
    ]
    text = "  ".join(clean(part) for part in parts if part)
    return Text(text) if text else _UNKNOWN


def _mode(info: RobotInfo) -> Text:
    state = word(robot.State, info.state)
    if not info.HasField("mode"):
        return Text(f"state {state}")
    ctrl = word(robot.ControlMode, info.mode.ctrl)
    work = word(robot.WorkMode, info.mode.work)
    return Text(f"control {ctrl}   work {work}   state {state}")


def _taskable(info: RobotInfo) -> Text:
    found = objections(info)
    if found:
        text = Text("would be refused", BAD)
        for objection in found:
            text.append(f"\n- {clean(objection.reason)}", BAD)
            text.append(f": {clean(objection.remedy)}", "not bold default")
        return text
    if is_taskable(info) is None:
        return _UNKNOWN
    return Text("would be taken", GOOD)


def _pose(info: RobotInfo) -> Text:
    if not info.pose_speed.HasField("pose"):
        return _UNKNOWN
    pose = info.pose_speed.pose
    degrees = math.degrees(pose.theta)
    return Text(
        f"x {pose.x:.3f} m   y {pose.y:.3f} m   theta {pose.theta:.3f} rad ({degrees:.1f}°)"
    )


def _speed(info: RobotInfo) -> Text:
    if not info.HasField("pose_speed"):
        return _UNKNOWN
    twist = info.pose_speed.twist
    driven = f"   {info.pose_speed.mileage} m driven in all"
    return Text(f"{twist.linear:.2f} m/s   {twist.angular:.2f} rad/s{driven}")


def _battery(info: RobotInfo) -> Text:
    if not info.HasField("battery"):
        return _UNKNOWN
    battery = info.battery
    charging = battery.charge_state in (Battery.kManual, Battery.kAuto)
    how = f"charging ({word(Battery.ChargeState, battery.charge_state)})" if charging else ""
    low = battery.power <= _LOW_BATTERY and not charging
    return Text(f"{battery.power} %   {how}".rstrip(), ODD if low else "")


def _task(info: RobotInfo) -> Text:
    proc = info.task_proc
    if not info.HasField("task_proc") or proc.state == task.kStateUndefined:
        return Text("none", FAINT)
    parts = [
        str(proc.robot_task_id),
        word(task.Type, proc.type),
        f"to {clean(proc.dest)}" if proc.dest else "",
    ]
    text = Text(" ".join(part for part in parts if part) + "   ")
    style = BAD if proc.state == task.kFailed else GOOD if proc.state == task.kCompleted else "bold"
    text.append(word(task.State, proc.state), style)
    return text.append(f"   {clean(proc.msg)}" if proc.msg else "")


def _task_action(info: RobotInfo) -> Text:
    doing = info.task_proc.action
    if doing.type == action.kTypeUndefined:
        return Text("none", FAINT)
    state = word(action.State, doing.state)
    wait = f"   wait {doing.wait_id}" if doing.wait_id else ""
    return Text(f"{word(action.Type, doing.type)}   {state}{wait}")


def _action(view: View, name: str) -> Text:
    feedback = view.actions[name]
    text = Text(word(ActionState, feedback.state))
    if feedback.code:
        text.append(f"   {feedback.code}")
    return text.append(f"   {clean(feedback.msg)}" if feedback.msg else "")


def _codes(view: View) -> Text:
    text = Text()
    for code in list(view.codes)[: -_CODES_SHOWN - 1 : -1]:
        when = time.strftime("%m-%d %H:%M:%S", time.localtime(code.time / 1000))
        level = word(StatusCode.Level, code.level)
        text.append(
            f"{when}  {level:<6}  {code.code}  {clean(code.msg)}\n".replace("\n\n", "\n"),
            _LEVEL_STYLES.get(code.level, ""),
        )
    text.rstrip()
    return text if view.codes else Text("none", FAINT)
