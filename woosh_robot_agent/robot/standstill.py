"""Detect that a robot does not move although it has accepted a command; name likely causes."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from woosh_robot_agent.link import Body, ChassisClient, LinkState
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.link.reports import LogOnce, RecentDict
from woosh_robot_agent.motion import AnsweredCommand, MotionGate
from woosh_robot_agent.motion.requests import commands_motion, may_move, takes_wheels
from woosh_robot_agent.motion.wheel_owner import is_held_up, is_unfinished
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ActionOrder, ExecTask, Follow, Twist
from woosh_robot_agent.pb.robot.robot_pb2 import (
    DeviceState,
    PoseSpeed,
    RobotInfo,
    TaskProc,
)
from woosh_robot_agent.pb.ros.ros_pack_pb2 import (
    CallAction,
    Feedbacks,
    kRosCancel,
    kRosExecuteFailed,
    kRosExecuting,
    kRosFailure,
    kRosPause,
    kRosSuccess,
)
from woosh_robot_agent.pb.util import action_pb2, task_pb2
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.robot.last_known import LastKnown
from woosh_robot_agent.robot.readiness import is_charging, is_located
from woosh_robot_agent.robot.refusals import TASK_TYPES, type_of
from woosh_robot_agent.robot.who_drives import command_name
from woosh_robot_agent.sentences import AND, THEN, Sentence, joined

_KEY = Sentence("the key switch is at manual")()
_MANUAL = Sentence("its control mode is manual")()
_STOP = Sentence("the emergency stop is pressed")()
_BRAKE = Sentence("the brake or the servo drives are released")()
_OBSTACLE = Sentence("an obstacle is in the way")()
_CHARGER = Sentence("the charging cable is connected")()
_LOST = Sentence("the robot does not know its position")()
_REPORTED = Sentence("the robot reports that {cause}")
_PERHAPS = Sentence("perhaps {cause}")
_LESS_LIKELY = Sentence("less likely, because the robot reports otherwise: {causes}")
_STANDS = Sentence("{command} was accepted, but the robot does not move: {causes}")


def likely_causes(info: RobotInfo) -> str:
    """Return the causes of a standstill in words: reported, then possible, then unlikely ones."""
    causes = list(_causes(info))
    reported = [_REPORTED(cause=cause) for cause, is_reported in causes if is_reported]
    possible = [_PERHAPS(cause=cause) for cause, is_reported in causes if is_reported is None]
    unlikely = [cause for cause, is_reported in causes if is_reported is False]
    text = joined(AND, [*reported, *possible])
    if unlikely:
        return THEN(one=text, other=_LESS_LIKELY(causes=joined(AND, unlikely)))
    return text


def _causes(info: RobotInfo) -> Iterator[tuple[str, bool | None]]:
    """Yield each cause, and True if the robot reports it, False if the opposite, else None."""
    has_device_state = info.HasField("device_state")
    hardware = info.device_state.hardware
    yield _STOP, bool(hardware & DeviceState.kEmgBtn) if has_device_state else None
    # software can set the reported mode to automatic while the key switch is at manual
    yield (_MANUAL, True) if info.mode.ctrl == robot.kManual else (_KEY, None)
    yield _BRAKE, True if hardware & DeviceState.kServoBtn else None
    yield _OBSTACLE, None
    yield _CHARGER, is_charging(info.battery) if info.HasField("battery") else None
    located = is_located(info)
    yield _LOST, None if located is None else not located


_LOG = logging.getLogger(__name__)

LIMIT = 2.0
"""Time after which a robot that has not moved causes a warning, in seconds.

A real robot usually starts 0.31 s after a velocity, and in 90 % of all cases within 0.66 s.
"""
KEPT = 30.0
"""Time for which a warning remains after the last velocity, in seconds.

After this time, the same warning is logged again for another command.
"""
MIN_DISTANCE = 0.003
"""Smallest change of the pose that counts as movement, in m."""
MIN_ANGLE = 0.01
"""Smallest change of the heading that counts as movement, in rad."""
MIN_SPEED = 0.005
"""Smallest reported speed that counts as movement, in m/s or rad/s."""
_DRIVING_ACTIONS = (
    action_pb2.kNav,
    action_pb2.kStepCtrl,
    action_pb2.kSecondposEnter,
    action_pb2.kSecondposQuit,
)
"""Actions of a task during which the robot should move."""
ENDED = (kRosSuccess, kRosFailure, kRosCancel, kRosExecuteFailed)
"""States of an action that has ended."""
_VELOCITY = full_name(Twist)
_MAX_ENDS = 50
"""Number of ends of tasks and actions that are remembered."""
_ANY_TASK = 0
"""Id of a task whose id is not known."""


@dataclass
class _ExpectedMotion:
    """The motion that the last command should cause.

    Attributes:
        name: name of the command, for texts.
        type: protobuf full name of the command.
        task_id: id of the task; 0 if it is not known.
        start: pose of the robot when the command was accepted.
        since: loop time from which the robot should move; None while it may stand.
        last: loop time of the last velocity; for other commands, of the command.
        begun: True once the chassis has reported that it executes the task.
        warned: True if the warning has been given.
    """

    name: str
    type: str
    task_id: int
    start: PoseSpeed
    since: float | None
    last: float
    begun: bool = False
    warned: bool = False

    @property
    def is_velocity(self) -> bool:
        """True if the command is a velocity."""
        return self.type == _VELOCITY


class Standstill:
    """Warns of a command that the chassis accepts but that moves nothing for `LIMIT` seconds.

    Commands are the velocities, tasks and driving actions that pass the motion gate. A task or
    action is observed until the robot first moves. While the chassis reports that it waits, is
    paused, charges or handles goods, the robot may stand. After a stop, a pause, a cancel and the
    end of the task or action, no movement is expected. Used in the event loop of the link.
    """

    def __init__(self, chassis: ChassisClient, gate: MotionGate, last_known: LastKnown) -> None:
        self._chassis = chassis
        self._last_known = last_known
        self._expected: _ExpectedMotion | None = None
        self._log = LogOnce(_LOG)
        self._log_cleared = -math.inf
        """Loop time at which the logged warnings were last forgotten, so that they may repeat."""
        self._rested = -math.inf
        """Loop time of the last stop, pause or cancel."""
        self._ends: RecentDict[int | str, float] = RecentDict(_MAX_ENDS)
        """Loop times of the last reports of ends: of tasks by id and by `_ANY_TASK`, of actions by
        type. The end may be reported before the command is answered."""
        gate.on_answered(self._answered)
        gate.on_stop(self._rest)
        chassis.on_state(self._link_changed)
        chassis.subscribe_raw(PoseSpeed, self._pose_pushed)
        chassis.subscribe(TaskProc, self._task_changed)
        chassis.subscribe(Feedbacks, self._action_reported)

    @property
    def warning(self) -> str:
        """The command that moves nothing, and the likely causes; empty if there is none."""
        expected = self._expected
        if expected is None or not expected.warned:
            return ""
        if expected.is_velocity and asyncio.get_running_loop().time() - expected.last > KEPT:
            return ""
        return self._text(expected)

    def _text(self, expected: _ExpectedMotion) -> str:
        """Return the warning about a command."""
        causes = likely_causes(self._last_known.value(RobotInfo) or RobotInfo())
        return _STANDS(command=expected.name, causes=causes)

    # Commands

    def _answered(self, command: AnsweredCommand) -> None:
        """Expect motion after an accepted command; none after a zero, a pause or a cancel."""
        message = command.message
        if not command.answer.ok or not commands_motion(message):
            return
        if may_move(message) and command.requested <= self._rested:
            return  # a stop, pause or cancel came after the request
        if isinstance(message, Twist):
            if may_move(message):
                self._velocity_accepted(command_name(command))
            elif (expected := self._expected) and expected.is_velocity and not expected.warned:
                self._expected = None  # a warning that was given remains until the robot moves
        elif takes_wheels(message) and not _may_stand(message):
            # an order to the running task is observed like the task
            kind = full_name(ExecTask) if isinstance(message, ActionOrder) else type_of(message)
            task_id = getattr(message, "task_id", _ANY_TASK)
            ended = self._ends.get(task_id if kind in TASK_TYPES else kind, -math.inf)
            if ended >= command.requested:
                return  # the task or action has ended already
            expected = self._expect(command_name(command), kind, task_id)
            task = self._last_known.value(TaskProc) or TaskProc()
            if isinstance(message, ActionOrder) and is_held_up(task):
                expected.since = None  # the order changes nothing, so no report may follow
        elif not may_move(message):  # a pause or a cancel
            self._rest()

    def _velocity_accepted(self, name: str) -> None:
        """Expect the robot to move by a stream of velocities."""
        now = asyncio.get_running_loop().time()
        expected = self._expected
        if expected is None or not expected.is_velocity or now - expected.last > KEPT:
            expected = self._expect(name, _VELOCITY)
        expected.last = now
        if expected.since is None:
            self._start_timer(expected)

    def _expect(self, name: str, kind: str, task_id: int = 0) -> _ExpectedMotion:
        """Expect the robot to move because of a command."""
        start = self._last_known.value(PoseSpeed) or PoseSpeed()
        now = asyncio.get_running_loop().time()
        self._expected = _ExpectedMotion(name, kind, task_id, start, since=None, last=now)
        self._start_timer(self._expected)
        return self._expected

    def _rest(self) -> None:
        """Expect no movement because of the commands given so far, and end their warning."""
        self._rested = asyncio.get_running_loop().time()
        self._expected = None

    def _start_timer(self, expected: _ExpectedMotion) -> None:
        """Expect movement within `LIMIT` from now."""
        loop = asyncio.get_running_loop()
        expected.since = loop.time()
        loop.call_later(LIMIT, self._check, expected, expected.since)

    def _check(self, expected: _ExpectedMotion, since: float) -> None:
        """Warn if the robot should have moved since a loop time, and has not."""
        is_still_expected = expected is self._expected and expected.since == since
        if not is_still_expected or expected.warned:
            return
        if expected.is_velocity and self._chassis.refusal(Twist()):
            self._expected = None  # the agent has stopped the robot, and only observes it
            return
        now = asyncio.get_running_loop().time()
        if now - since > 1.5 * LIMIT:  # this process stood still, and has read no reports
            self._start_timer(expected)
            return
        expected.warned = True
        if now - self._log_cleared > KEPT:
            self._log.clear()  # the same warning is logged again
            self._log_cleared = now
        text = self._text(expected)
        self._log.warn(text, text)

    # Reports of the robot

    def _pose_pushed(self, body: Body) -> None:
        """End the observation, or start it anew for a stream, if the robot has moved."""
        expected = self._expected
        if expected is None:  # usually; then the body need not be decoded
            return
        now = asyncio.get_running_loop().time()
        if expected.is_velocity and expected.since is None and now - expected.last > LIMIT:
            self._expected = None  # the stream has ended
            return
        pose: PoseSpeed = body.message()
        if not _is_finite(pose):
            return
        if not _is_finite(expected.start):
            expected.start = pose
        if not _has_moved(expected.start, pose):
            return
        if expected.warned:
            _LOG.info("the robot moves after %s", expected.name)
        self._log.clear()
        if expected.is_velocity:  # later velocities of the stream may move nothing
            expected.start, expected.since, expected.warned = pose, None, False
        else:
            self._expected = None

    def _task_changed(self, report: TaskProc) -> None:
        """Note whether the task that is observed drives the robot now, or has ended."""
        if not is_unfinished(report):
            now = asyncio.get_running_loop().time()
            self._ends[report.robot_task_id] = self._ends[_ANY_TASK] = now
        expected = self._expected
        if expected is None or expected.type not in TASK_TYPES:
            return
        # a report without an id says that there is no task
        if expected.task_id and report.robot_task_id not in (expected.task_id, 0):
            return
        if not is_unfinished(report):
            # if neither is 0, they are equal, see above
            has_its_id = expected.task_id and report.robot_task_id
            # before the task has begun, an end without its id is that of an earlier task
            if expected.begun or has_its_id:
                self._expected = None
            return
        expected.begun = True
        should_move = (
            report.state == task_pb2.kExecuting
            and report.action.type in _DRIVING_ACTIONS
            and report.action.state == action_pb2.kRosExecuting
        )
        self._set_standing(expected, may_stand=not should_move)

    def _action_reported(self, reports: Feedbacks) -> None:
        """Note whether the action that is observed drives the robot now, or has ended."""
        for report in reports.fbs:
            if report.state in ENDED:
                self._ends[report.action] = asyncio.get_running_loop().time()
            expected = self._expected
            if expected is None or report.action != expected.type:
                continue
            if report.state in (kRosExecuting, kRosPause):
                self._set_standing(expected, may_stand=report.state == kRosPause)
            elif report.state in ENDED:
                self._expected = None

    def _set_standing(self, expected: _ExpectedMotion, *, may_stand: bool) -> None:
        """Expect no movement, and end the warning, if the robot may stand; otherwise expect one."""
        if may_stand:
            expected.since, expected.warned = None, False
        elif expected.since is None:
            self._start_timer(expected)

    def _link_changed(self, state: LinkState) -> None:
        if state is not LinkState.READY:
            self._expected = None


def _is_finite(report: PoseSpeed) -> bool:
    """Return True if no number in a report is NaN or infinite."""
    pose, twist = report.pose, report.twist
    numbers = (pose.x, pose.y, pose.theta, twist.linear, twist.angular)
    return all(map(math.isfinite, numbers))


def _has_moved(before: PoseSpeed, now: PoseSpeed) -> bool:
    """Return True if a report shows a speed, or another pose than an earlier report."""
    if max(abs(now.twist.linear), abs(now.twist.angular)) > MIN_SPEED:
        return True
    old, new = before.pose, now.pose
    turned = math.remainder(new.theta - old.theta, math.tau)
    return math.hypot(new.x - old.x, new.y - old.y) > MIN_DISTANCE or abs(turned) > MIN_ANGLE


def _may_stand(message: Any) -> bool:
    """Return True if the robot may stand still although it executes a request that drives it.

    These are requests to follow somebody, ChargeControl (it may stand at the charger already), and
    steps that are too small to show in the reports. Tasks are not among them: their reports tell.
    """
    if not isinstance(message, CallAction):
        return isinstance(message, Follow)
    if message.HasField("charge_control"):
        return True
    steps = message.step_control.steps
    return bool(steps) and all(
        abs(step.value) <= (MIN_ANGLE if step.mode == step.kRotate else MIN_DISTANCE)
        for step in steps
    )
