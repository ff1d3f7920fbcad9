"""Control a robot from the page: by commands, and by the stick, i.e. the joystick on the page.

All commands pass through the motion gate.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from google.protobuf.message import Message

from woosh_robot_agent.link import LinkError
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.motion import (
    AnsweredCommand,
    MotionGate,
    Sender,
    SpeedLimiter,
    VelocityDriver,
    VelocityLimits,
)
from woosh_robot_agent.motion.requests import may_move
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ExecTask, Twist
from woosh_robot_agent.robot.refusals import RefusalExplainer, type_of
from woosh_robot_agent.robot.standstill import Standstill
from woosh_robot_agent.robot.who_drives import VelocitySources, WhoDrives
from woosh_robot_agent.sentences import THEN, Said, Sentence, joined, said_by
from woosh_robot_agent.tools.dashboard import part_data
from woosh_robot_agent.tools.dashboard.commands import COMMANDS, Args, CommandError, number
from woosh_robot_agent.tools.dashboard.robot import Robot
from woosh_robot_agent.tools.dashboard.stop_alarm import StopAlarm
from woosh_robot_agent.tools.dashboard.tasks import TaskLog
from woosh_robot_agent.tools.dashboard.texts import page_text, value_data
from woosh_robot_agent.tools.dashboard.viewer import Viewer


class Outcome(NamedTuple):
    """The outcome of a command.

    Attributes:
        data: data that the page requested, or the id of an accepted task; otherwise None.
    """

    ok: bool
    text: str
    data: Any = None


_STICK = page_text("driver.stick")
"""Name of the stick as a source of velocities."""
STOP = "stop"
"""Name of the command that stops the robot; a viewer needs no control to give it."""
SPEED_LIMIT = "speedLimit"
"""Name of the command that limits the speed of the robot."""
TOO_SLOW = page_text("reason.tooSlow")
"""Reason for a command or velocity from the page that is too old to be sent."""
UNANSWERED = page_text("reason.unanswered")
"""Reason for a velocity that is not sent, because the answer to an earlier one is overdue."""
_STOPPED_MEANWHILE = page_text("reason.stoppedMeanwhile")
_OTHER_MODE = page_text("reason.otherMode")
_IDLE = page_text("reason.idle")
_VELOCITY_REFUSED = Sentence("the robot refused the velocity")
_BECAUSE = Sentence("{text} ({reason})")
_MAX_COUNT = 1e15
"""Maximum number of a press, and maximum time in milliseconds, in a message of the page."""
_STOP_TIMEOUT = 2.0
"""Timeout of each answer to a stop, in seconds."""
_CLOSE_TIMEOUT = 0.5
"""Timeout of the answer to the last zero velocity, in seconds."""
_IDLE_TIMEOUT = 60.0
"""Time without a command after which a viewer loses the control, in seconds."""
_LOWEST_LIMIT = 0.05
"""Lowest speed limit that a viewer can set, in m/s."""
_HIGHEST_LIMIT = 3.0
"""Highest speed limit that a viewer can set, in m/s."""
_STICK_RATE = 20.0
"""Maximum rate of velocities that are sent to the robot, in Hz."""
_MAX_INPUT = 100.0
"""Maximum velocity in a message of the page, in m/s and rad/s; the limits scale it down."""


@dataclass(frozen=True)
class ControlConfig:
    """Limits and timeouts of the control.

    Attributes:
        max_linear: maximum speed of the stick, in m/s.
        max_angular: maximum turning speed of the stick, in rad/s.
        stick_timeout: time without a velocity from the page after which the robot is stopped, in
            seconds.
        max_age: maximum age of a command or velocity, in seconds. The dashboard sends its time to
            the page, and the page returns the last time that it had when the viewer gave the
            command. The age counts from that time.
    """

    max_linear: float = 0.5
    max_angular: float = 0.8
    stick_timeout: float = 0.5
    max_age: float = 0.5


class Control:
    """Lets one viewer at a time command a robot.

    1. The first viewer to give a command gets the control. It keeps the control until it gives it
       back, hides the page, disconnects, watches another robot, or gives no command for a minute.
    2. The other viewers are told who has the control. Every viewer with the permission to control
       may stop the robot.
    3. When a viewer loses the control, its stick stops the robot.
    4. The stick drives only while the page repeats the velocity; see `VelocityDriver`.
    5. The page repeats the newest time that it got from this process. If that time is old, the
       connection is slow in one direction or the other, and neither a velocity nor a command that
       may start a motion is sent. The same holds if that time is before the last stop, because
       the viewer did not know of the stop, or before the end of a stall of this process.
    6. Each press of the stick has a number. A stop, a refused velocity, a velocity that the robot
       does not answer, another control mode, a robot that sends nothing, the loss of the control or
       a gap between the velocities ends the press. Only another press drives again.
    7. A robot that hangs may execute a command later. While it sends nothing, it gets no command
       that may start a motion.
    8. The page sends a place with the map that it shows. The place is sent to the robot only if the
       robot uses this map.

    Args:
        on_card_changed: called when the robot's card in the fleet view may have changed: after each
            answer to a stop and each new speed limit.

    Attributes:
        owner: the viewer that has the control; None if no viewer has it.
        alarm: the alarm of a stop after which the robot may move.
        speed_limit: speed limit that a viewer has set, in m/s; None without one.
    """

    def __init__(
        self,
        robot: Robot,
        config: ControlConfig,
        on_card_changed: Callable[[], None] = lambda: None,
    ) -> None:
        self._robot = robot
        self._config = config
        self.alarm = StopAlarm(robot, on_card_changed)
        self._gate = MotionGate(robot.chassis, on_late_stop=self.alarm.answered)
        self._limits = VelocityLimits(
            config.max_linear, config.max_angular, _STICK_RATE, config.stick_timeout
        )
        self.speed_limit: float | None = None
        self._speed_limiter = SpeedLimiter(
            robot.chassis,
            self._gate,
            start=lambda work: asyncio.get_running_loop().create_task(work, name="speed limit"),
            on_refused=lambda reason: robot.parts.changed(),
        )
        self._stick = VelocityDriver(
            self._gate, robot.chassis, _STICK, self._stick_limits, self._stick_refused
        )
        self._gate.on_answered(self._answered)
        self._gate.on_stop(self._stopped)
        last_known = robot.view.values
        self._explainer = RefusalExplainer(robot.chassis, last_known)
        self._standstill = Standstill(robot.chassis, self._gate, last_known)
        self._who_drives = WhoDrives(
            robot.chassis,
            self._gate,
            last_known,
            VelocitySources(self._gate),
            goals=lambda: (),  # the dashboard executes no ROS goals
        )
        self.tasks = TaskLog(robot, self._who_drives.now)
        self._on_card_changed = on_card_changed
        self.owner: Viewer | None = None
        self._used_at = -math.inf
        """Loop time at which the owner last used the control."""
        self._stopped_at = -math.inf
        """Loop time of the last stop."""
        self._press = -1
        """Number of the owner's last press that was admitted; -1 without one.

        The press has ended if `owner.ended_press` is at least as high.
        """
        self._press_mode = 0
        """Control mode of the robot at the beginning of `_press`."""
        self._driven_at = -math.inf
        """Loop time of the last velocity of the last press."""
        self._stick_task: asyncio.Task[None] | None = None
        """Task that sends the velocities; None before `start`."""
        self._explaining: asyncio.Task[None] | None = None
        """Task of `_explain`; kept, because the event loop has only a weak reference."""
        robot.parts.add("control", self._data, each_second=True)

    def start(self) -> asyncio.Task[None]:
        """Start sending the velocities of the stick; return the task that does so."""
        self._stick_task = asyncio.get_running_loop().create_task(self._stick.run(), name="stick")
        return self._stick_task

    async def close(self) -> str:
        """Stop the robot if the stick drives it, and refuse further motion.

        Returns:
            The reason why the robot may still be moving; empty if it was stopped, or if the stick
            did not drive it.
        """
        if self._stick_task is not None:
            self._stick_task.cancel()
        try:
            await self._gate.close(_CLOSE_TIMEOUT)
        except LinkError as error:
            return str(error)
        return ""

    def command(
        self, viewer: Viewer, name: str, args: Args, clock: float
    ) -> Coroutine[Any, Any, Outcome]:
        """Give the control to a viewer, and return the execution of its command.

        A stop needs no control. `clock` is the newest time that the page had received, in ms.

        Raises:
            CommandError: the command is refused.
        """
        if name == STOP:
            return self._stop(viewer)
        reason = self._outdated(clock) or self._robot.no_data
        if name == SPEED_LIMIT:
            limit = _speed_limit(args)
            self._admit(viewer, name, reason)
            return self._limit_speed(limit)
        command = COMMANDS.get(name)
        if command is None:
            raise CommandError(page_text("reason.unknownCommand"))
        request = command.request(args, self._robot.view.info)
        if command.on_map:
            reason = reason or self._other_map(args)
        self._admit(viewer, name, None if command.interrupts else reason)
        if isinstance(request, ExecTask):
            self.tasks.given(request.task_id, viewer.name, name, args)
        return self._execute(name, request)

    def _admit(self, viewer: Viewer, name: str, reason: Said | None) -> None:
        """Claim the control for a command; raise a `CommandError` for a reason against it."""
        if reason:
            raise CommandError(page_text("reply.notSent", command=_name(name), reason=reason))
        if reason := self._claim(viewer):
            raise CommandError(reason)

    def drive(self, viewer: Viewer, message: Args) -> None:
        """Process a velocity of a viewer's stick.

        The message has `linear` in m/s, `angular` in rad/s, `clock` as for a command, and `press`.

        Raises:
            CommandError: a value is not a valid number.
        """
        linear = number(message, "linear", _MAX_INPUT)
        angular = number(message, "angular", _MAX_INPUT)
        clock = number(message, "clock", _MAX_COUNT)
        press = int(number(message, "press", _MAX_COUNT))
        if press > viewer.press:
            viewer.press, viewer.press_clock = press, clock
        if not (linear or angular):  # the viewer has let go, or holds the stick in its middle
            if viewer is self.owner:
                self._stick.drive(0.0, 0.0, 0.0)
                # the stick may rest in its middle during a press: that is no gap
                if press == self._press and self._gap <= self._config.stick_timeout:
                    self._driven_at = asyncio.get_running_loop().time()
            return
        if press <= viewer.ended_press:
            return
        if reason := self._admit_press(viewer, press, clock):
            viewer.end_press(press, reason)
            if viewer is self.owner:
                self._stick.drive(0.0, 0.0, 0.0)
            return
        if press != self._press:
            self._press = press
            self._press_mode = self._robot.view.info.mode.ctrl
            self._stick.drive(0.0, 0.0, 0.0)  # after a stop, the driver waits for a zero
        self._driven_at = asyncio.get_running_loop().time()
        self._stick.drive(linear, 0.0, angular)

    def release(self, viewer: Viewer) -> None:
        """Take the control from a viewer that has it, and end the press of its stick."""
        if viewer is self.owner:
            viewer.ended_press = max(viewer.ended_press, self._press)
            self._end_control()

    def _end_control(self) -> None:
        self._stick.drive(0.0, 0.0, 0.0)
        self.owner = None
        self._press = -1
        self._robot.parts.changed()

    def _release_idle(self) -> None:
        """Take the control from a viewer that has not used it for `_IDLE_TIMEOUT`."""
        now = asyncio.get_running_loop().time()
        if self.owner and now > self._used_at + _IDLE_TIMEOUT:
            if self._gap <= self._config.stick_timeout:  # the viewer holds the stick in its middle
                self._end_press(_IDLE)
            self.release(self.owner)

    def _claim(self, viewer: Viewer) -> Said | None:
        """Give the control to a viewer, or extend its time; return the reason if that cannot be."""
        self._release_idle()
        if self.owner not in (None, viewer):
            return page_text("reason.controlled", name=self.owner.name)
        if not viewer.visible:
            return page_text("reason.hidden")
        if self.owner is None:
            self.owner = viewer
            self._robot.parts.changed()
        self._used_at = asyncio.get_running_loop().time()
        return None

    def _outdated(self, clock: float) -> Said | None:
        """Return the reason if a command or velocity is too old to be sent (rule 5), or None."""
        known = clock / 1000.0
        if not 0.0 <= asyncio.get_running_loop().time() - known <= self._config.max_age:
            return TOO_SLOW
        # the time of the event loop does not count a suspension of this computer
        if known < self._gate.stall_ended + self._gate.timing.settle:
            return TOO_SLOW
        if known <= self._stopped_at:
            return _STOPPED_MEANWHILE
        return None

    def _other_map(self, args: Args) -> Said | None:
        """Return the reason if the place of a command is not on the map that the robot uses."""
        used = part_data.map_data(self._robot.view.info.scene)
        if all(args.get(name) == value for name, value in used.items()):
            return None
        return page_text("reason.otherMap", map=used["map"])

    @property
    def _gap(self) -> float:
        """Time since the last velocity of the last press, in seconds."""
        return asyncio.get_running_loop().time() - self._driven_at

    def _admit_press(self, viewer: Viewer, press: int, clock: float) -> Said | None:
        """Claim the control for a press; return the reason why it may not drive, or None."""
        if viewer.press_clock / 1000.0 <= self._stopped_at:  # begun before the stop was known
            return _STOPPED_MEANWHILE
        if reason := self._outdated(clock) or self._robot.no_data or self._claim(viewer):
            return reason
        if press == self._press:  # the press that drives already
            if self._gap > self._config.stick_timeout:
                return TOO_SLOW
            if self._press_mode != self._robot.view.info.mode.ctrl:
                return _OTHER_MODE
        if self._gate.is_answer_overdue:
            return UNANSWERED
        owner = self._gate.owner
        return page_text("reason.running", owner=owner) if owner else None

    async def _stop(self, viewer: Viewer) -> Outcome:
        driving, given = (self.owner, self._press), asyncio.get_running_loop().time()
        report = await self._gate.stop(_STOP_TIMEOUT)
        self.alarm.answered(report, given)
        key = "reply.stopped" if report.success else "reply.notStopped"
        text = page_text(key, text=report.message)
        if driving == (self.owner, self._press):  # a press that began meanwhile goes on
            by_other = self.owner is not viewer and report.success
            self._end_press(page_text("reply.stoppedBy", name=viewer.name) if by_other else text)
        return Outcome(report.success, text)

    async def _execute(self, name: str, request: Message) -> Outcome:
        try:
            request = self._robot.requests.address(request)
            answer = await self._gate.request(request, sender=Sender(_name(name)))
        except LinkError as error:  # if the robot has got the request, its reports will show that
            return Outcome(
                False, page_text("reply.refused", command=_name(name), text=said_by(error))
            )
        if isinstance(request, ExecTask):
            self.tasks.answered(request.task_id, answer.ok)
        if answer.ok:
            task_id = str(request.task_id) if isinstance(request, ExecTask) else None
            return Outcome(True, page_text("reply.accepted", command=_name(name)), task_id)
        text = await self._explained(type_of(request), answer.reason)
        return Outcome(False, page_text("reply.refused", command=_name(name), text=text))

    async def _explained(self, request_type: str, text: str) -> str:
        """Return the text of a refusal that just came, with its reasons if they are known."""
        reasons = await self._explainer.reasons(request_type)
        if not reasons:
            return text
        return _BECAUSE(text=text, reason=joined(THEN, (each.said for each in reasons)))

    async def _limit_speed(self, limit: float | None) -> Outcome:
        self.speed_limit = limit
        self._speed_limiter.limit(math.inf if limit is None else limit)
        self._robot.parts.changed()
        self._on_card_changed()
        return Outcome(True, page_text("reply.accepted", command=_name(SPEED_LIMIT)))

    def _stick_limits(self) -> VelocityLimits:
        """Return the limits of the stick, which obeys the speed limit of the viewers, too."""
        linear = min(self._limits.max_linear, self.speed_limit or math.inf)
        return replace(self._limits, max_linear=linear)

    def _stopped(self) -> None:
        """Note the beginning of a stop, and end the press."""
        self._stopped_at = asyncio.get_running_loop().time()
        self._end_press(page_text("reply.stopping"))

    def _answered(self, command: AnsweredCommand) -> None:
        """End the press if the robot has refused its velocity."""
        viewer, answer = self.owner, command.answer
        if answer.ok and may_move(command.message):
            self.alarm.motion_commanded()
        refused = command.source == _STICK and not answer.ok
        if refused and viewer is not None and viewer.ended_press < self._press:
            viewer.ended_press = self._press  # at once: finding the reason takes time
            explain = self._explain(viewer, self._press, answer.msg or _VELOCITY_REFUSED())
            self._explaining = asyncio.get_running_loop().create_task(explain, name="refusal")

    async def _explain(self, viewer: Viewer, press: int, text: str) -> None:
        """Tell a viewer why the robot has refused the velocity of a press."""
        text = await self._explained(full_name(Twist), text)
        viewer.end_press(press, page_text("reason.said", text=text))

    def _stick_refused(self, reason: str) -> None:
        """End the press whose velocity `VelocityDriver` has refused."""
        if self.owner is not None and self.owner.ended_press < self._press:  # told once
            self._end_press(page_text("reason.said", text=reason))

    def _end_press(self, reason: Said) -> None:
        """End the owner's last press, and tell its page why."""
        if self.owner is not None:
            self.owner.end_press(self._press, reason)

    def _data(self) -> dict[str, Any]:
        """Take the control from an idle viewer, and return the data of the part `control`."""
        self._release_idle()
        limits, driver = self._stick_limits(), self._who_drives.now()
        return {
            "owner": self.owner.name if self.owner else None,
            "limits": {"linear": limits.max_linear, "angular": limits.max_angular},
            "maximum": self._limits.max_linear,
            "speedLimit": self.speed_limit,
            # not without a limit: if the robot refuses to end the last one, it is only too slow
            "speedRefusal": value_data(self._speed_limiter.refusal if self.speed_limit else ""),
            "driver": {"name": value_data(driver.name), "detail": value_data(driver.detail)},
            "standstill": value_data(self._standstill.warning),
        }


def _name(command: str) -> Said:
    return page_text(f"command.{command}")


def _speed_limit(args: Args) -> float | None:
    """Return the limit in the arguments, in m/s; None to remove the limit."""
    if args.get("limit") is None:
        return None
    return number(args, "limit", _HIGHEST_LIMIT, _LOWEST_LIMIT)
