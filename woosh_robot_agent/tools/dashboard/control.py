"""The commands of the page, and who may give them to a robot: all through the gate for motion."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Coroutine, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

from google.protobuf.message import Message

from woosh_robot_agent.link import LinkError
from woosh_robot_agent.link.reports import RecentDict
from woosh_robot_agent.motion import AnsweredCommand, MotionGate, VelocityDriver, VelocityLimits
from woosh_robot_agent.motion.wheel_owner import is_running
from woosh_robot_agent.pb.robot.robot_pack_pb2 import (
    ActionOrder,
    ExecTask,
    InitRobot,
    SetRobotPose,
    Speak,
    SwitchControlMode,
    SwitchWorkMode,
)
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo, TaskProc
from woosh_robot_agent.pb.util import action_pb2 as action
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.pb.util import task_pb2 as task
from woosh_robot_agent.robot.refusals import RefusalExplainer, type_of
from woosh_robot_agent.tools.dashboard import part_data
from woosh_robot_agent.tools.dashboard.robot import Robot
from woosh_robot_agent.tools.dashboard.viewer import Viewer

Args = Mapping[str, Any]
"""Arguments of a command, as the page sends them."""
Outcome = tuple[bool, str]
"""Success of a command, and a text for the viewer."""
_MAX_TEXT = 200
"""Maximum length of a text."""
_MAX_COORDINATE = 1e5
"""Greatest coordinate, in metres."""


class CommandError(ValueError):
    """A command is refused."""


def _go(args: Args, _info: RobotInfo) -> Message:
    request = ExecTask(task_id=_task_id(), type=task.kPick)
    _set_pose(request.pose, args)
    return request


def _go_to_mark(args: Args, _info: RobotInfo) -> Message:
    return ExecTask(task_id=_task_id(), type=task.kPick, mark_no=_text(args, "mark"))


def _tell_pose(args: Args, info: RobotInfo) -> Message:
    """Return the request that tells the robot its pose; before the initialisation, another one."""
    request = InitRobot() if info.state == robot.kUninit else SetRobotPose()
    _set_pose(request.pose, args)
    return request


def _control_mode(args: Args, _info: RobotInfo) -> Message:
    mode = _choice(args, "mode", (robot.kAuto, robot.kManual, robot.kMaintain))
    return SwitchControlMode(mode=robot.ControlMode.Name(mode))


def _work_mode(args: Args, _info: RobotInfo) -> Message:
    mode = _choice(args, "mode", (robot.kDeployMode, robot.kTaskMode, robot.kScheduleMode))
    return SwitchWorkMode(mode=robot.WorkMode.Name(mode))


def _speak(args: Args, _info: RobotInfo) -> Message:
    return Speak(text=_text(args, "text"))


def _number(args: Args, name: str, limit: float) -> float:
    """Return an argument that is a number.

    Raises:
        CommandError: it is not a number within -`limit` to `limit`.
    """
    value = args.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= limit:
        raise CommandError(f"{name} is not a number within {-limit:g} to {limit:g}")
    return float(value)


def _set_pose(pose: Any, args: Args) -> None:
    pose.x = _number(args, "x", _MAX_COORDINATE)
    pose.y = _number(args, "y", _MAX_COORDINATE)
    pose.theta = _number(args, "theta", math.tau)


def _text(args: Args, name: str) -> str:
    text = args.get(name)
    if not isinstance(text, str) or len(text) > _MAX_TEXT or not text.isprintable():
        raise CommandError(f"{name} is not a text of at most {_MAX_TEXT} characters")
    return text


def _choice(args: Args, name: str, valid: tuple[int, ...]) -> int:
    value = args.get(name)
    if isinstance(value, bool) or not isinstance(value, int) or value not in valid:
        raise CommandError(f"{name} is not one of {', '.join(map(str, valid))}")
    return value


def _task_id() -> int:
    """Return an id for a task, which the robot repeats in its reports."""
    return int(time.time() * 1000)


class _Command(NamedTuple):
    """A command that the page can give.

    Attributes:
        request: makes the request from the arguments and the state of the robot.
        interrupts: it only ends or interrupts a motion, so it is never too old to be sent.
    """

    request: Callable[[Args, RobotInfo], Message]
    interrupts: bool = False


_COMMANDS: Mapping[str, _Command] = MappingProxyType(
    {
        "go": _Command(_go),
        "goMark": _Command(_go_to_mark),
        "setPose": _Command(_tell_pose),
        "pause": _Command(lambda *_: ActionOrder(order=action.kPause), interrupts=True),
        "continue": _Command(lambda *_: ActionOrder(order=action.kContinue)),
        "cancel": _Command(lambda *_: ActionOrder(order=action.kCancel), interrupts=True),
        "controlMode": _Command(_control_mode),
        "workMode": _Command(_work_mode),
        "speak": _Command(_speak),
    }
)
"""All commands for a robot, by name, besides `STOP`."""


_STICK = "stick"
"""Name of the stream of velocities."""
STOP = "stop"
"""Name of the command that stops the robot, which every viewer may give."""
TOO_SLOW = "the connection to the dashboard is too slow; try again"
"""Reason why something from the page is too old to be sent."""
_STOP_TIMEOUT = 2.0
"""Timeout of each answer to a stop, in seconds."""
_MAX_AGE = 0.5
"""Age of the newest time known to the page from which what it sends is too old, in seconds."""
_MAX_COUNT = 1e15
"""Greatest time, in milliseconds, and number of a press in a message of the page."""
_MAX_TASKS = 20
"""Number of tasks of the page whose end is awaited."""
_STICK_RATE = 20.0
"""Maximum rate of velocities that are sent to the robot, in Hz."""
_MAX_INPUT = 100.0
"""Greatest velocity in a message of the page, in m/s and rad/s; the limits scale it down."""


@dataclass(frozen=True)
class ControlConfig:
    """Limits and timeouts of the control.

    Attributes:
        max_linear: maximum speed of the stick, in m/s.
        max_angular: maximum turning speed of the stick, in rad/s.
        stick_timeout: time without a velocity from the page after which the robot is stopped, in
            seconds.
        idle_timeout: time without a command after which a viewer loses the control, in seconds.
        close_timeout: timeout of the answer to the last zero velocity, in seconds.
    """

    max_linear: float = 0.5
    max_angular: float = 0.8
    stick_timeout: float = 0.5
    idle_timeout: float = 60.0
    close_timeout: float = 0.5


@dataclass
class _GivenTask:
    """A task that a page has given the robot.

    Attributes:
        command: name of the command.
        known: the robot has accepted or reported it.
        report: last report about it; None before the first one. Without a state, its end was not
            seen.
        at: Unix time of that report, in seconds.
    """

    command: str
    known: bool = False
    report: TaskProc | None = None
    at: float = 0.0

    @property
    def ended(self) -> bool:
        """True if no more reports are expected."""
        return self.report is not None and not is_running(self.report)

    def update(self, report: TaskProc) -> None:
        """Take a report about the task."""
        if self.report is None or self.report.state != report.state:
            self.at = time.time()
        self.known, self.report = True, report


class Control:
    """Lets one viewer at a time command a robot.

    1. The first viewer to give a command gets the control. It keeps the control until it gives it
       back, hides the page, disconnects, watches another robot, or gives no command for a minute.
    2. The others are told who has the control. All of them may stop the robot.
    3. When a viewer loses the control, its stick stops the robot.
    4. The stick drives only while the page repeats the velocity; see `VelocityDriver`.
    5. The page repeats the newest time that it got from this process. If that time is old, the
       connection is slow in one direction or the other, and neither a velocity nor a command that
       may start something is sent. The same holds for a time before the last stop: the viewer did
       not know of the stop.
    6. What becomes of the last task that a page has given is a part of its own, because a robot
       reports the end of a task only for a few milliseconds.
    7. Each press of the stick has a number. A stop, a refused velocity, a robot that sends nothing
       or a gap between the velocities ends the press. Only another press drives again.
    8. A robot that hangs may execute later what it gets now. While it sends nothing, it gets no
       command that may start something.

    Args:
        robot: the robot.
        config: limits and timeouts.

    Attributes:
        owner: the viewer that has the control; None without any.
    """

    def __init__(self, robot: Robot, config: ControlConfig) -> None:
        self._robot = robot
        self._config = config
        self._gate = MotionGate(robot.chassis)
        self._limits = VelocityLimits(
            config.max_linear, config.max_angular, _STICK_RATE, config.stick_timeout
        )
        self._stick = _Stick(self._gate, robot, self._limits, self._stick_refused)
        self._gate.on_answered(self._answered)
        self._gate.on_stop(self._stopped)
        self._explainer = RefusalExplainer(robot.chassis, robot.view.values)
        self.owner: Viewer | None = None
        self._used_at = -math.inf
        """Loop time of the last command of the owner."""
        self._stopped_at = -math.inf
        """Loop time of the last stop."""
        self._press = -1
        """Number of the press that drives; -1 if none does."""
        self._driven_at = -math.inf
        """Loop time of the last velocity of this press."""
        self._stick_task: asyncio.Task[None] | None = None
        self._tasks: RecentDict[int, _GivenTask] = RecentDict(_MAX_TASKS)
        """Tasks that pages have given, by id, the last one last."""
        robot.chassis.on_snapshot(self._find_task)
        robot.chassis.subscribe(TaskProc, self._task_reported)
        robot.parts.add("control", self._data, each_second=True)
        robot.parts.add("result", self._result)

    def start(self) -> None:
        """Start sending the velocities of the stick."""
        self._stick_task = asyncio.get_running_loop().create_task(self._stick.run(), name="stick")

    async def close(self) -> str:
        """Stop the robot if the stick drives it, and refuse further motion.

        Returns:
            The reason why the robot may still be moving; empty if it was stopped.
        """
        if self._stick_task is not None:
            self._stick_task.cancel()
        try:
            await self._gate.close(self._config.close_timeout)
        except LinkError as error:
            return str(error)
        return ""

    def command(
        self, viewer: Viewer, name: str, args: Args, clock: float
    ) -> Coroutine[Any, Any, Outcome]:
        """Give the control to a viewer, and return the execution of its command.

        A stop needs no control.

        Args:
            viewer: the viewer.
            name: name of the command.
            args: arguments of the command.
            clock: newest time that the page knew, in milliseconds.

        Raises:
            CommandError: the command is refused.
        """
        if name == STOP:
            return self._stop()
        command = _COMMANDS.get(name)
        if command is None:
            raise CommandError("there is no such command")
        request = command.request(args, self._robot.view.info)
        reason = self._outdated(clock) or self._robot.no_data
        if reason and not command.interrupts:
            raise CommandError(f"{name} was not sent: {reason}")
        if reason := self._claim(viewer):
            raise CommandError(reason)
        return self._execute(name, request)

    def drive(self, viewer: Viewer, message: Args) -> None:
        """Process a velocity of a viewer's stick.

        Raises:
            CommandError: a value is not a valid number.
        """
        linear = _number(message, "linear", _MAX_INPUT)
        angular = _number(message, "angular", _MAX_INPUT)
        clock = _number(message, "clock", _MAX_COUNT)
        press = int(_number(message, "press", _MAX_COUNT))
        if not (linear or angular):
            if viewer is self.owner:
                self._stick.drive(0.0, 0.0, 0.0)
                if press == self._press and self._gap <= self._config.stick_timeout:
                    self._driven_at = asyncio.get_running_loop().time()
            return
        if press <= viewer.ended_press:
            return
        if reason := self._objection(viewer, press, clock):
            viewer.end_press(press, reason)
            if viewer is self.owner:
                self._stick.drive(0.0, 0.0, 0.0)
            return
        if press != self._press:
            self._press = press
            self._stick.drive(0.0, 0.0, 0.0)  # after a stop, the driver waits for a zero
        self._driven_at = asyncio.get_running_loop().time()
        self._stick.drive(linear, 0.0, angular)

    def release(self, viewer: Viewer) -> None:
        """Take the control from a viewer that has it, and stop what its stick drives."""
        if viewer is self.owner:
            self._stick.drive(0.0, 0.0, 0.0)
            self.owner = None
            self._press = -1
            self._robot.parts.changed()

    def _release_idle(self) -> None:
        """Take the control from a viewer that has not used it for long."""
        now = asyncio.get_running_loop().time()
        if self.owner and now > self._used_at + self._config.idle_timeout:
            self.release(self.owner)

    def _claim(self, viewer: Viewer) -> str:
        """Give the control to a viewer; return the reason why not, or an empty text."""
        self._release_idle()
        if self.owner not in (None, viewer):
            return f"{self.owner.name} has control: wait until it is released"
        if not viewer.visible:
            return "the page is hidden"
        if self.owner is None:
            self.owner = viewer
            self._robot.parts.changed()
        self._used_at = asyncio.get_running_loop().time()
        return ""

    def _outdated(self, clock: float) -> str:
        """Return the reason why something is too old to be sent; empty if it is not.

        Args:
            clock: newest time that the page knew, in milliseconds.
        """
        known = clock / 1000.0
        if not 0.0 <= asyncio.get_running_loop().time() - known <= _MAX_AGE:
            return TOO_SLOW
        if known <= self._stopped_at:
            return "the robot was stopped in the meantime"
        return ""

    @property
    def _gap(self) -> float:
        """Time since the last velocity of the press that drives, in seconds."""
        return asyncio.get_running_loop().time() - self._driven_at

    def _objection(self, viewer: Viewer, press: int, clock: float) -> str:
        """Return the reason why a press of the stick may not drive; empty if it may."""
        if reason := self._outdated(clock) or self._robot.no_data or self._claim(viewer):
            return reason
        if press == self._press and self._gap > self._config.stick_timeout:
            return TOO_SLOW
        owner = self._gate.owner
        return f"{owner} is running: pause or cancel it to drive by hand" if owner else ""

    async def _stop(self) -> Outcome:
        report = await self._gate.stop(_STOP_TIMEOUT)
        return report.success, report.message

    async def _execute(self, name: str, request: Message) -> Outcome:
        given = _GivenTask(name)
        task_id = request.task_id if isinstance(request, ExecTask) else 0
        if task_id:
            self._tasks[task_id] = given
        try:
            answer = await self._gate.request(self._robot.requests.address(request))
        except LinkError as error:  # if the robot has got it, its reports tell
            return False, f"{name}: {error}"
        if answer.ok:
            given.known = True
            self._robot.parts.changed()
            return True, f"{name}: accepted"
        self._tasks.pop(task_id, None)
        reason = await self._explainer.reason(type_of(request))
        return False, f"{name}: {answer.msg or 'refused'}{reason and f' ({reason})'}"

    def _task_reported(self, report: TaskProc) -> None:
        """Take a report about a task. The robot reports one at a time."""
        if given := self._tasks.get(report.robot_task_id):
            given.update(report)
        self._miss_ends(report.robot_task_id)
        self._robot.parts.changed()

    def _find_task(self, info: RobotInfo) -> None:
        """Find out what has become of the tasks while there was no link."""
        for report in (*info.task_history.tes, info.task_proc):
            if given := self._tasks.get(report.robot_task_id):
                given.update(report)
        for given in self._tasks.values():
            if given.known and given.report is None:
                given.update(TaskProc())
        self._miss_ends(info.task_proc.robot_task_id)

    def _miss_ends(self, current: int) -> None:
        """Note that the end of each other task was not seen that was running."""
        for task_id, given in self._tasks.items():
            if task_id != current and given.report is not None and not given.ended:
                given.update(TaskProc(robot_task_id=task_id, dest=given.report.dest))

    def _result(self) -> dict[str, Any] | None:
        """Return what has become of the last task; None if it has not begun."""
        given = next((each for each in reversed(self._tasks.values()) if each.known), None)
        if given is None or given.report is None:
            return None
        return part_data.result_data(self._robot.view, given.command, given.report, given.at)

    def _stopped(self) -> None:
        self._stopped_at = asyncio.get_running_loop().time()
        self._stick_refused("the robot was stopped")

    def _answered(self, command: AnsweredCommand) -> None:
        if command.source == _STICK and not command.answer.ok:
            self._stick_refused(command.answer.msg or "the robot refused the velocity")

    def _stick_refused(self, reason: str) -> None:
        """End the press that drives."""
        if self.owner is not None:
            self.owner.end_press(self._press, reason)

    def _data(self) -> dict[str, Any]:
        self._release_idle()
        limits = {"linear": self._limits.max_linear, "angular": self._limits.max_angular}
        return {"owner": self.owner.name if self.owner else None, "limits": limits}


class _Stick(VelocityDriver):
    """A stream of velocities that tells the viewer why it does not drive, instead of the log."""

    def __init__(
        self,
        gate: MotionGate,
        robot: Robot,
        limits: VelocityLimits,
        on_refused: Callable[[str], None],
    ) -> None:
        super().__init__(gate, robot.chassis, _STICK, lambda: limits, log_refusals=False)
        self._on_refused = on_refused

    def refuse(self, kind: str, reason: str) -> None:
        self._on_refused(reason)
