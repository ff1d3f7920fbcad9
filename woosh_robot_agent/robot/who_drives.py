"""Find out what drives the robot: a task, an action or a source of velocities.

A source is a topic or service of the agent, e.g. cmd_vel. If several sources command velocities,
each overrides the others, and the robot stops and goes.
"""

from __future__ import annotations

import logging
import math
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import NamedTuple

from woosh_robot_agent.endpoints import ACTIONS, COMMANDS
from woosh_robot_agent.link import Body, ChassisClient
from woosh_robot_agent.link.reports import LogOnce, RecentDict
from woosh_robot_agent.motion import AnsweredCommand, MotionGate
from woosh_robot_agent.motion.requests import may_move
from woosh_robot_agent.motion.wheel_owner import TASK, TASKS_PER_SET, WITH_TASK, is_unfinished
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ExecPreTask, ExecTask, Follow, Twist
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed, RobotInfo, RobotState, TaskProc
from woosh_robot_agent.pb.task.woosh_task_pb2 import RepeatTask
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.pb.util import task_pb2
from woosh_robot_agent.robot.last_known import LastKnown
from woosh_robot_agent.robot.refusals import type_of
from woosh_robot_agent.sentences import AND, THEN, Said, Sentence

_NAMES = {
    # reversed: of two services that send the same request, the first one of the table counts
    **{command.request: command.name for command in reversed(COMMANDS)},
    **{action.arg: action.name for action in ACTIONS},
}
"""Names of the endpoints that send commands, by protobuf full name of the request."""


def command_name(command: AnsweredCommand) -> str:
    """Return the source of a command; without one, the endpoint that sends commands of its type.

    The commands of goals have no source.
    """
    request_type = type_of(command.message)
    return command.source or _NAMES.get(request_type, request_type)


_LOG = logging.getLogger(__name__)

OVERLAP = 1.0
"""Time within which the velocities of two sources count as simultaneous, in seconds."""
SHOWN = 5.0
"""Time for which simultaneous sources are reported, in seconds."""


class VelocitySources:
    """Observes the velocities that pass the motion gate. Used in the event loop of the link.

    A source drives from its first velocity until it sends a zero, or nothing for `OVERLAP`.

    Attributes:
        last: source of the last accepted velocity, zero included; empty before the first.
        last_time: monotonic time of that velocity.
    """

    def __init__(self, gate: MotionGate) -> None:
        self.last = ""
        self.last_time = -math.inf
        self._driving: dict[str, float] = {}
        """Monotonic time of the last velocity of each driving source, by name."""
        self._simultaneous: tuple[str, ...] = ()
        """The simultaneous sources that were last reported."""
        self._simultaneous_until = -math.inf
        """Monotonic time until which `simultaneous` returns these sources."""
        self._log = LogOnce(_LOG, SHOWN)
        self._callers = Interleaving()
        """Detects several clients of the service robot/Twist."""
        gate.on_answered(self._answered)

    @property
    def simultaneous(self) -> tuple[str, ...]:
        """Names of the sources that recently commanded velocities at the same time; or empty."""
        return self._simultaneous if time.monotonic() < self._simultaneous_until else ()

    def are_driving(self, now: float) -> bool:
        """Return True if a source drives at a monotonic time."""
        return any(now - sent < OVERLAP for sent in self._driving.values())

    def report(self, *sources: str) -> None:
        """Report sources that command velocities at the same time."""
        self._simultaneous = tuple(sorted(sources))
        self._simultaneous_until = time.monotonic() + SHOWN
        self._log.warn(str(self._simultaneous), simultaneous_warning(self._simultaneous))

    def note_call(self, service: str, number: int) -> None:
        """Process a call of the service robot/Twist that may move the robot.

        If the calls of several clients alternate, the clients are reported.

        Args:
            service: name of the service.
            number: sequence number of the call, counted by its client.
        """
        if self._callers.observe(number, time.monotonic()):
            self.report(f"a client of {service}", f"another client of {service}")

    def _answered(self, command: AnsweredCommand) -> None:
        """Note which source drives, and report it if another one does, too."""
        source = command.source
        # the agent itself, which has no name, only sends a zero when it closes
        if not isinstance(command.message, Twist) or not command.answer.ok or not source:
            return
        now = time.monotonic()
        self.last, self.last_time = source, now
        others = [name for name, sent in self._driving.items() if name != source]
        for name in others:
            if now - self._driving[name] < OVERLAP:
                self.report(source, name)
            else:
                del self._driving[name]
        if may_move(command.message):
            self._driving[source] = now
        else:
            self._driving.pop(source, None)


def simultaneous_warning(sources: tuple[str, ...]) -> str:
    """Return the warning about simultaneous sources of velocities."""
    return (
        f"{' and '.join(sources)} command velocities at the same time, so the robot stops and "
        "goes: stop all of them but one, or merge them (e.g. with twist_mux)"
    )


WINDOW = 2.5
"""Time within which several publishers count as simultaneous, in seconds.

Long enough to detect publishers at 1 Hz.
"""
_UNNUMBERED = (0, 2**64 - 1)
"""Sequence numbers of a middleware that does not number messages."""


class Interleaving:
    """Detects several publishers of a topic by the sequence numbers of their messages.

    Each publisher numbers its messages in ascending order. A number that is not above the previous
    one comes from another publisher, or from one that was restarted. If this happens twice within
    `WINDOW`, it was no restart. The number 1 does not count: in a shell script, each message may
    come from a publisher of its own.
    """

    def __init__(self) -> None:
        self._last = 0
        """Sequence number of the last message."""
        self._setbacks: deque[float] = deque(maxlen=2)
        """The last two monotonic times at which the number did not rise."""

    def observe(self, number: int | None, now: float) -> bool:
        """Process the number of a message.

        Args:
            number: publication sequence number; None if there is none.
            now: monotonic time.

        Returns:
            True if messages of several publishers alternate.
        """
        if number is None or number in _UNNUMBERED:
            return False
        if number != 1 and number <= self._last:
            self._setbacks.append(now)
        self._last = number
        return len(self._setbacks) == 2 and now - self._setbacks[0] < WINDOW


_NO_REPORT = Sentence("the robot has not reported its state yet")()
_FOLLOWS = Sentence("the robot is following somebody")()
_GOES_ON = Sentence("the goal has ended, but the robot continues")()
_ROLLS = Sentence("the robot is rolling to a stop")()
_UNREPORTED = Sentence("the robot is executing a task that it has not reported yet")()
_UNEXPLAINED = Sentence(
    "the robot moves without a command of this agent: another client may drive it"
)()

# Values of `Driver.name` besides the names of topics and services
NOBODY = "nobody"
GOAL = "a goal"
OTHER_CLIENT = "another client"
ROBOT = "the robot itself"
UNKNOWN = "unknown"

OWN_TASK_AGE = 5.0
"""Maximum age of a task that the robot started by itself when it is first reported, in seconds.

The id of such a task contains its start by the robot's clock: Unix time in seconds * 100 + 53.
"""
OWN_TASK_DURATION = 86400.0
"""Maximum age of a task of the robot's own whose beginning the agent has not seen, in seconds."""
_OWN_TASK_ENDING = 53
"""Last two digits of the id of a task that the robot started by itself."""
ROLL_OUT = 2.0
"""Maximum time for which the robot rolls after its last velocity, in seconds."""
REPORT_GAP = 1.0
"""Time without a PoseSpeed after which the robot counts as standing, in seconds.

A moving robot sends five per second.
"""
_OWN_TASKS = {
    task_pb2.kParking: Said("parking", "type.parking"),
    task_pb2.kCharge: Said("charging", "type.charge"),
}
"""Names of the tasks that a robot starts by itself, by type."""
_BUSY = (*WITH_TASK, robot.kFollowing)
"""States of a robot that has a task, or follows somebody."""
_MAX_TASKS = 50
"""Maximum number of the agent's tasks, and of its task sets, that are remembered."""
_BEGINS_WITHIN = 3.0
"""Time from the acceptance of a task within which the robot reports it, in seconds."""


class Driver(NamedTuple):
    """The source that drives the robot.

    Attributes:
        name: `nobody`, `a goal`, `another client`, `the robot itself`, `unknown`, or the name of a
            topic or service of the agent.
        detail: name of the task or action, or an explanation; may be empty.
    """

    name: str
    detail: str = ""


class _Starter(NamedTuple):
    """The source of an accepted command that starts something.

    Attributes:
        source: name of the source, or `GOAL`; empty without a command.
        accepted: monotonic time of the acceptance.
    """

    source: str = ""
    accepted: float = -math.inf

    @property
    def is_new(self) -> bool:
        """True if the robot may not have reported yet what the command starts."""
        return time.monotonic() < self.accepted + _BEGINS_WITHIN


class WhoDrives:
    """Finds out what drives the robot. Used in the event loop of the link.

    Args:
        goals: returns the names of the goals that the chassis executes, e.g. `task 17` or
            `task set 4`.
    """

    def __init__(
        self,
        chassis: ChassisClient,
        gate: MotionGate,
        last_known: LastKnown,
        velocities: VelocitySources,
        goals: Callable[[], Sequence[str]],
    ) -> None:
        self._gate = gate
        self._last_known = last_known
        self._velocities = velocities
        self._goals = goals
        self._tasks: RecentDict[int, _Starter] = RecentDict(_MAX_TASKS)
        """Starters of the tasks of the agent, by id."""
        self._without_id = _Starter()
        """Starter of the last task whose id the robot chooses, until it has been reported."""
        self._sets: RecentDict[int, _Starter] = RecentDict(_MAX_TASKS)
        """Starters of the task sets of the agent, by id."""
        self._follow = _Starter()
        """Starter of the following."""
        self._rests_since = math.inf
        """Monotonic time since when the robot has neither had a task nor followed somebody;
        infinite if it does so now."""
        self._task = TaskProc()
        """First report on the current task."""
        self._began_unseen = False
        """True if the current task was running when the link became ready."""
        self._pose_time = -math.inf
        """Monotonic time of the last PoseSpeed."""
        gate.on_answered(self._answered)
        chassis.on_snapshot(lambda info: self._task_reported(info.task_proc, unseen=True))
        chassis.subscribe(TaskProc, lambda task: self._task_reported(task, unseen=False))
        chassis.subscribe(RobotState, lambda _report: self._update_rest())
        chassis.subscribe_raw(PoseSpeed, self._pose_pushed)

    def now(self) -> Driver:
        """Return what drives the robot now."""
        info = self._last_known.value(RobotInfo)
        if info is None:
            return Driver(UNKNOWN, _NO_REPORT)
        # the gate knows whether a task or an action has replaced the velocities
        if self._gate.driving and self._velocities.are_driving(time.monotonic()):
            return Driver(self._velocities.last)
        if is_unfinished(info.task_proc):
            return self._task_driver(info.task_proc)
        if goals := self._goals():
            return Driver(GOAL, ", ".join(goals))
        if info.state == robot.kFollowing:
            return Driver(self._follow.source or OTHER_CLIENT, _FOLLOWS)
        if action := self._gate.wheel_owner.name:
            return Driver(OTHER_CLIENT, action)
        return self._unexplained(info)

    def _task_driver(self, task: TaskProc) -> Driver:
        """Return the source that started a task."""
        number = task.robot_task_id
        task_set = number // TASKS_PER_SET
        detail = TASK(id=number)
        if not {detail, f"task set {task_set}"}.isdisjoint(self._goals()):
            return Driver(GOAL, detail)
        source = (self._tasks.get(number) or self._sets.get(task_set, _Starter())).source
        if source == GOAL:
            return Driver(GOAL, THEN(one=detail, other=_GOES_ON))
        if source:
            return Driver(source, detail)
        kind = _OWN_TASKS.get(task.type)
        if kind and self._is_own_id(number):
            return Driver(ROBOT, AND(one=kind, other=detail))
        return Driver(OTHER_CLIENT, detail)

    def _is_own_id(self, number: int) -> bool:
        """Return True if the robot has chosen the id of the current task itself.

        Such an id is the start of the task in Unix seconds * 100 + 53. An id of a client may look
        like that, but then the start seldom fits the time of the first report on the task.
        """
        start, ending = divmod(number, 100)
        # a task that was running before the link was ready may be old
        oldest = OWN_TASK_DURATION if self._began_unseen else OWN_TASK_AGE
        return ending == _OWN_TASK_ENDING and 0 <= self._task.time - start <= oldest

    def _unexplained(self, info: RobotInfo) -> Driver:
        """Return the driver of a robot that no task, action or velocity of the agent drives."""
        now, twist = time.monotonic(), info.pose_speed.twist
        moves = twist.linear or twist.angular
        if not moves or now - self._pose_time > REPORT_GAP:
            return Driver(NOBODY)
        if now - self._velocities.last_time < ROLL_OUT:
            return Driver(self._velocities.last, _ROLLS)
        if info.state in WITH_TASK:
            return Driver(UNKNOWN, _UNREPORTED)
        return Driver(UNKNOWN, _UNEXPLAINED)

    def _answered(self, command: AnsweredCommand) -> None:
        """Remember which source started a task, a task set or a following."""
        message = command.message
        if not command.answer.ok:
            return
        # a goal sends its command without a source
        starter = _Starter(command.source or GOAL, time.monotonic())
        if isinstance(message, ExecTask):
            if message.task_id:
                self._tasks[message.task_id] = starter
            else:
                self._without_id = starter
        elif isinstance(message, ExecPreTask):
            self._sets[message.task_set_id] = starter
        elif isinstance(message, RepeatTask):
            if may_move(message):
                self._sets[message.task_set.base.id] = starter
        elif isinstance(message, Follow):
            self._follow = starter if message.type else _Starter()  # False ends the following

    def _update_rest(self) -> None:
        """Note whether the robot rests; after a long rest, forget who started what ran before."""
        info, now = self._last_known.value(RobotInfo) or RobotInfo(), time.monotonic()
        # in other states, e.g. a fault, a task may go on
        if info.state not in _BUSY and not is_unfinished(info.task_proc):
            self._rests_since = min(self._rests_since, now)
            return
        if now > self._rests_since + _BEGINS_WITHIN:  # after a shorter rest, a set may go on
            if not self._follow.is_new:
                self._follow = _Starter()
            for starters in (self._tasks, self._sets):
                for number in [each for each, starter in starters.items() if not starter.is_new]:
                    del starters[number]
        self._rests_since = math.inf

    def _task_reported(self, task: TaskProc, *, unseen: bool) -> None:
        """Keep a report if it is the first one on its task.

        Args:
            task: the report.
            unseen: True if the task may have begun before the link was ready.
        """
        self._update_rest()
        number = task.robot_task_id
        if number == self._task.robot_task_id:
            return
        self._task, self._began_unseen = task, unseen
        fits = self._without_id.is_new and not unseen and number not in self._tasks
        if fits and is_unfinished(task):  # otherwise it is a late report on an earlier task
            self._tasks[number] = self._without_id
            self._without_id = _Starter()

    def _pose_pushed(self, _body: Body) -> None:
        self._pose_time = time.monotonic()
