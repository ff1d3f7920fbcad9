"""Goals of Nav2's actions, each of which the chassis executes as one or several goals of its own.

A Nav2 goal is a coroutine in the link thread. If something other than the chassis ends it, e.g. a
cancel of its client, a newer goal or a timeout, the reason is a `GoalEnd`. The chassis's goal is
cancelled first, here or by the service `stop`. When that has ended, the `GoalEnd` is raised in the
coroutine, or a `FailedCommand` if the cancel had no effect.
"""

from __future__ import annotations

import asyncio
import logging
from abc import ABC, abstractmethod
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from typing import Any, TypeVar

from builtin_interfaces.msg import Duration
from google.protobuf.message import Message

from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.link import ChassisClient, LinkError, LinkState
from woosh_robot_agent.link.tasks import start_task
from woosh_robot_agent.motion import MotionGate
from woosh_robot_agent.motion.wheel_owner import is_held_up
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ExecTask
from woosh_robot_agent.pb.robot.robot_pb2 import DeviceState, Mode, RobotInfo, Scene, TaskProc
from woosh_robot_agent.pb.ros.action_pb2 import kResume
from woosh_robot_agent.pb.ros.ros_pack_pb2 import kRosCancel, kRosPause
from woosh_robot_agent.pb.util import action_pb2 as action
from woosh_robot_agent.pb.util.task_pb2 import kCanceled, kPaused
from woosh_robot_agent.robot.readiness import (
    CONTROL_MODES,
    EMERGENCY_STOP,
    Objection,
    objections,
    objections_except_busy,
)
from woosh_robot_agent.robot.status_codes import explained
from woosh_robot_agent.ros.actions.actions import Actions, AgentGoal
from woosh_robot_agent.ros.actions.goal import Cause, End, Outcome
from woosh_robot_agent.ros.actions.run import STOPPING
from woosh_robot_agent.ros.actions.server import Goal, GoalServer
from woosh_robot_agent.ros.nav2.cancels import CancelLog
from woosh_robot_agent.ros.nav2.frames import Frames
from woosh_robot_agent.ros.nav2.pose import RobotPose
from woosh_robot_agent.ros.qos import RARE_QOS
from woosh_robot_agent.ros.standard.part import PartContext
from woosh_robot_agent.ros.standard_endpoints import BY_NAME

T = TypeVar("T")

_LOG = logging.getLogger(__name__)
_PERIOD = 0.1
"""Period of feedback, in seconds."""
_LONGEST = 2.0**31 - 1.0
"""Longest time in a Duration, in seconds."""
_REPLACED = "replaced by a newer goal"
_NO_LINK = "there is no link to the robot: send the goal again when the link is back"
_CANCELLED = (kRosCancel, kCanceled)
"""States in reports on an action or a task that was cancelled."""


class GoalEnd(Exception):
    """The reason why a goal ends before it is reached.

    Args:
        text: the reason; empty for a cancel.
        code: name of the error code in the action's result. If the result's type lacks that code,
            it becomes UNKNOWN.
        outcome: final state of the goal.
    """

    def __init__(
        self,
        text: str = "",
        code: str = "UNKNOWN",
        *,
        outcome: Outcome = Outcome.ABORTED,
    ) -> None:
        super().__init__(text)
        self.code = code
        self.outcome = outcome


class FailedCommand(GoalEnd):
    """The chassis refused or failed to execute a command.

    Args:
        canceller: what has cancelled it; empty if it was not cancelled.

    Attributes:
        cause: who decided the end.
        status_code: the status code in the report; 0 without one.
    """

    def __init__(self, end: End, canceller: str) -> None:
        text, code = getattr(end.result, "msg", ""), int(getattr(end.result, "code", 0))
        if code:
            text = f"status code {explained(code, text)}"
        if canceller:
            details = "" if text in ("", "cancelled") else f" ({text})"
            text = f"cancelled by {canceller}{details}"
        text = text or "the chassis ended it, and did not say why"
        super().__init__(text)
        self.cause = end.cause
        self.status_code = code


def _is_paused(report: Message) -> bool:
    """Return True if an action or a task is paused, and does not go on by itself."""
    if isinstance(report, TaskProc):
        return report.state == kPaused and not is_held_up(report)
    return getattr(report, "state", None) == kRosPause


class Nav2Goal:
    """A running goal of a Nav2 action. Use it in the link thread.

    Attributes:
        request: the goal as the client gave it.
        navigates: True if the goal is a navigation of the chassis.
        is_paused_by_stop: as in `Nav2Action`.
        result: the result, to be filled by the action.
        ended: future that is done when the goal has ended.
        started: loop time at which the goal was accepted.
        is_cancelled: True once `stop` was called, even if there was no chassis's goal to cancel.
        prevention: reason why the goal sends no further command, because the robot obeyed nobody
            meanwhile; None without one.
    """

    def __init__(self, goal: Goal, nav2_action: Nav2Action) -> None:
        loop = asyncio.get_running_loop()
        self.request = goal.request
        self.navigates = nav2_action.navigates
        self.is_paused_by_stop = nav2_action.is_paused_by_stop
        self.result = nav2_action.action_type.Result()
        self.ended: asyncio.Future[None] = loop.create_future()
        self.started = loop.time()
        self.is_cancelled = False
        self.prevention: GoalEnd | None = None
        self._name = nav2_action.name
        self._goal = goal
        self._feedback_class = nav2_action.action_type.Feedback
        self._context = nav2_action.context
        self._map = self._context.map_in_use
        """The map for which the client has given the places in the goal."""
        self._published = goal.published
        """Loop time at which the client sent the goal, or later, at which the last command ended.
        If the agent stood still until then, nobody may want the next command any more."""
        self._reason: asyncio.Future[GoalEnd] = loop.create_future()
        """Why the goal ends; done when something other than the chassis ends it."""
        self.chassis_goal: AgentGoal | None = None
        """The goal that the chassis executes for this one now, as far as is known; None if none."""
        self._older: Nav2Goal | None = None
        """The navigation that this goal replaces when the chassis accepts this goal; None without
        one, and once the chassis has decided."""
        self._timer: asyncio.TimerHandle | None = None
        """Timer of the last `set_timeout`; None before the first."""

    @property
    def elapsed(self) -> float:
        """Time since the goal was accepted, in seconds."""
        return asyncio.get_running_loop().time() - self.started

    @property
    def is_ending(self) -> bool:
        """True once something other than the chassis ends the goal."""
        return self._reason.done()

    def feedback(self, **fields: Any) -> None:
        """Publish feedback with these fields."""
        self._goal.feedback(self._feedback_class(**fields))

    def send_no_more(self, reason: GoalEnd) -> None:
        """End the goal for a reason, unless it is already ending, but cancel nothing.

        If the chassis executes a command for the goal, the goal ends when the command has ended. No
        further command is sent.
        """
        if not self.is_ending:
            self._reason.set_result(reason)

    def stop(self, reason: GoalEnd) -> None:
        """End the goal for a reason, unless it is already ending; cancel the chassis's goal.

        A navigation that this goal was to replace is cancelled, too, unless the chassis has already
        accepted this goal.
        """
        self.send_no_more(reason)
        self.is_cancelled = True
        if self.chassis_goal is not None:
            self.chassis_goal.cancel()
        self._stop_older()

    def set_timeout(self, seconds: float, reason: GoalEnd) -> None:
        """End the goal for a reason after a time; 0 or less is no limit."""
        self.clear_timeout()
        if seconds > 0.0:
            loop = asyncio.get_running_loop()
            self._timer = loop.call_later(seconds, self.stop, reason)

    def clear_timeout(self) -> None:
        """Remove the timeout, if there is one."""
        if self._timer is not None:
            self._timer.cancel()

    def replace(self, older: Nav2Goal) -> None:
        """Replace a navigation without a stop, once the chassis has accepted this goal."""
        self._older = older
        older.send_no_more(GoalEnd(_REPLACED))

    def raise_if_ending(self) -> None:
        """Raise the reason that ends the goal, if there is one.

        Raises:
            GoalEnd: the goal is ending.
        """
        if self.is_ending:
            raise self._reason.result()

    async def run_command(
        self,
        command: Message,
        *,
        tick: Callable[[], None] = lambda: None,
        on_report: Callable[[Message], None] = lambda _report: None,
        is_done: Callable[[], bool] = lambda: False,
    ) -> Cause | None:
        """Let the chassis execute a command, and wait for its end.

        Args:
            command: the command of one of the chassis's actions, or a task.
            tick: called ten times a second, to publish feedback.
            on_report: called with each report of the chassis.
            is_done: returns True if the goal is reached although the chassis has not ended the
                command. The command then goes on.

        Returns:
            Who decided that the command has succeeded; None if `is_done` did.

        Raises:
            GoalEnd: the goal has ended before the command did.
            FailedCommand: the command has failed.
        """
        self.raise_if_ending()
        if self.prevention is not None:
            raise self.prevention
        self._check_map()
        sent = asyncio.get_running_loop().time()
        is_paused = False

        def report(message: Message) -> None:
            nonlocal is_paused
            was_paused, is_paused = is_paused, _is_paused(message)
            is_over = self.is_ending or self.ended.done()
            if is_paused and not (was_paused or is_over):
                self._log_pause(command, message)
            on_report(message)

        chassis_goal = self._context.actions.start(command, report, self._published)
        self.chassis_goal = chassis_goal
        chassis_goal.accepted.add_done_callback(self._decided)
        try:
            await self._repeat(tick, chassis_goal.ended, is_done)
        except Exception:  # a defect of `tick` or `is_done` must not leave the robot driving
            chassis_goal.cancel()
            raise
        finally:
            self.chassis_goal, self._published = None, asyncio.get_running_loop().time()
        if not chassis_goal.ended.done():
            return None
        end = chassis_goal.ended.result()
        if end.outcome is Outcome.SUCCEEDED:
            return end.cause
        if not self.is_ending:
            raise await self._failure(end, command, sent)
        reason = self._reason.result()
        if end.outcome is Outcome.CANCELED:
            await self._context.pose.wait_until_standing()
            raise reason
        if str(reason) == _REPLACED and not self.is_cancelled:  # a newer navigation replaces it
            raise reason
        # the cancel had no effect: the text of the failure says that the robot may go on
        raise await self._failure(end, command, sent)

    def _check_map(self) -> None:
        """Check that the robot uses the map for which the places in the goal were given.

        Raises:
            GoalEnd: it uses another one, in which the places are elsewhere.
        """
        (scene, name), used = self._map, self._context.map_in_use
        if used != (scene, name):
            raise GoalEnd(
                f"the goal is for the map {name} of the scene {scene}, and the robot now uses the "
                f"map {used[1]} of the scene {used[0]}: send a goal for this map"
            )

    def _log_pause(self, command: Message, report: Message) -> None:
        """Log that the robot waits, and what to do: nothing else would tell it."""
        cause = "it does not say why; perhaps a call of robot/Twist with a zero velocity"
        text = getattr(report, "msg", "") or cause
        is_task = isinstance(command, ExecTask)
        order = "robot/ActionOrder" if is_task else f"ros/{command.DESCRIPTOR.name}"
        _LOG.warning(
            "%s: the robot has paused (%s): resume it by %s with %s, or cancel the goal",
            self._name,
            text,
            order,
            f"order {action.kContinue}" if is_task else f"action {kResume}",
        )

    def _decided(self, accepted: asyncio.Future[bool]) -> None:
        """Handle that the chassis has accepted a command of this goal, or never will.

        An accepted command has replaced the older navigation. Otherwise, the older navigation must
        be stopped.
        """
        if not accepted.result():
            self._stop_older()
        self._older = None

    def _stop_older(self) -> None:
        """Stop the navigation that this goal was to replace, if it may still be driving."""
        if self._older is not None:
            self._older.stop(GoalEnd(_REPLACED))

    async def _failure(self, end: End, command: Message, sent: float) -> FailedCommand:
        """Return the failure of a command; `sent` is the loop time at which it was sent."""
        if getattr(end.result, "state", None) not in _CANCELLED:
            return FailedCommand(end, "")
        return FailedCommand(end, await self._context.cancels.source(command, sent))

    async def wait_for(
        self, future: asyncio.Future[Any], tick: Callable[[], None] = lambda: None
    ) -> None:
        """Wait until a future is done.

        Args:
            tick: called ten times a second, to publish feedback.

        Raises:
            GoalEnd: the goal has ended before.
        """
        await self._repeat(tick, self._reason, future.done, future)
        if not future.done():
            self.raise_if_ending()

    async def run(self, work: Coroutine[Any, Any, T], name: str) -> T:
        """Run a coroutine, which is cancelled if the goal ends before, and return its result.

        Args:
            work: the coroutine, e.g. one that waits for an answer of the chassis.
            name: its name, for debugging.

        Raises:
            GoalEnd: the goal has ended before.
        """
        task = start_task(work, name=f"nav2: {name}")
        try:
            await self.wait_for(task)
            return task.result()
        finally:
            task.cancel()

    async def wait_until(self, condition: Callable[[], bool]) -> None:
        """Wait until a condition holds; it is checked ten times a second.

        Raises:
            GoalEnd: the goal has ended before.
        """
        await self._repeat(lambda: None, self._reason, condition)
        if not condition():
            self.raise_if_ending()

    async def _repeat(
        self,
        tick: Callable[[], None],
        end: asyncio.Future[Any],
        is_done: Callable[[], bool],
        *wakes: asyncio.Future[Any],
    ) -> None:
        """Call `tick` ten times a second until `end` is done or `is_done` returns True.

        `is_done` is called with the same period, and when one of `wakes` is done.
        """
        clock = asyncio.get_running_loop().time
        due = clock()
        while not (end.done() or is_done()):
            tick()
            due = max(due + _PERIOD, clock())
            waited = {end, *wakes}
            await asyncio.wait(waited, timeout=due - clock(), return_when=asyncio.FIRST_COMPLETED)

    def finish(self, reason: GoalEnd | None) -> None:
        """End the goal: with success if the reason is None."""
        self.clear_timeout()
        self._stop_older()  # it is still driving if this goal has sent no command
        result = self.result
        if hasattr(result, "total_elapsed_time"):
            result.total_elapsed_time = to_duration(self.elapsed)
        if reason is not None and hasattr(result, "success"):
            result.success = False
        if reason is not None and reason.outcome is Outcome.ABORTED:
            constants = type(result)
            if hasattr(result, "error_code"):
                unknown = getattr(constants, "UNKNOWN", 0)
                result.error_code = getattr(constants, reason.code, unknown)
            if hasattr(result, "error_msg"):
                result.error_msg = str(reason)
        self._goal.finish(Outcome.SUCCEEDED if reason is None else reason.outcome, result)
        if not self.ended.done():
            self.ended.set_result(None)


class Slot:
    """Lets one goal run at a time: a new goal ends the goals before it."""

    def __init__(self) -> None:
        self._goals: list[Nav2Goal] = []
        """The last goal, and the goals that had not ended when it came; oldest first."""

    @property
    def running(self) -> list[Nav2Goal]:
        """The goals that have not ended, oldest first."""
        return [each for each in self._goals if not each.ended.done()]

    async def take(self, goal: Nav2Goal) -> None:
        """Let a goal run, and end the goals before it.

        A navigation replaces another one without a stop in between, because the chassis can do so.
        In all other cases, the goals before are cancelled, and have ended when this returns.

        Raises:
            GoalEnd: the goal itself has ended meanwhile.
        """
        older = self.running
        self._goals = [*older, goal]
        if older and all(each.navigates for each in self._goals):
            # the newest of them has already replaced or stopped those before it
            goal.replace(older[-1])
            return
        for each in older:
            each.stop(GoalEnd(_REPLACED))
        for each in older:
            await goal.wait_for(each.ended)


class DrivingSlot(Slot):
    """Lets one goal at a time move the robot.

    A goal for which the chassis executes nothing now, e.g. one that waits for the end of another
    goal, could move the robot later by itself. It ends when the link is lost, and when the robot
    reports a pressed emergency stop or a control mode in which it obeys nobody.

    Args:
        chassis: the link.
        gate: tells when the service `stop` is called.
    """

    def __init__(self, chassis: ChassisClient, gate: MotionGate) -> None:
        super().__init__()
        self._chassis = chassis
        self._reported = RobotInfo()
        """What the robot has reported last of its emergency stop and its control mode."""
        gate.on_stop(self._stop_called)
        chassis.on_state(self._link_changed)
        chassis.on_snapshot(self._prevent)
        # from each report: at the next look at the state, a button may be released already
        chassis.subscribe(DeviceState, lambda each: self._prevent(RobotInfo(device_state=each)))
        chassis.subscribe(Mode, lambda each: self._prevent(RobotInfo(mode=each)))

    async def take(self, goal: Nav2Goal) -> None:
        if self._chassis.state is not LinkState.READY:
            raise GoalEnd(_NO_LINK)
        if self.running and (reason := prevention(self._reported)):  # it may have to wait
            raise GoalEnd(reason)
        await super().take(goal)

    def stop(self, reason: GoalEnd) -> bool:
        """End the goal that the chassis executes; return False if it executes none."""
        executing = [each for each in self.running if each.chassis_goal is not None]
        for each in executing:
            each.stop(reason)
        return bool(executing)

    def _stop_called(self) -> None:
        """End all goals, because the service `stop` cancels what the chassis executes."""
        for each in self.running:
            each.send_no_more(GoalEnd("cancelled by the service stop"))

    def _link_changed(self, state: LinkState) -> None:
        if state is not LinkState.READY:
            for each in self.running:
                if each.chassis_goal is None:
                    each.stop(GoalEnd(_NO_LINK))

    def _prevent(self, info: RobotInfo) -> None:
        """End goals if a report of the robot says that it obeys no velocity.

        A goal whose command the chassis executes ends with this command.
        """
        for part in ("device_state", "mode"):
            if info.HasField(part):
                getattr(self._reported, part).CopyFrom(getattr(info, part))
        if reason := prevention(info):
            for each in self.running:
                each.prevention = GoalEnd(reason)
                is_affected = each.is_paused_by_stop or each.chassis_goal is None
                # a further cancel could end another task
                if is_affected and not each.is_cancelled:
                    each.stop(each.prevention)


def prevention(info: RobotInfo) -> str:
    """Return why a robot obeys no velocity: emergency stop, control mode; empty if it does."""
    preventing = (EMERGENCY_STOP, *CONTROL_MODES)
    return "; ".join(str(each) for each in objections(info) if each in preventing)


@dataclass(frozen=True)
class Nav2Context(PartContext):
    """The objects that Nav2's actions share."""

    actions: Actions
    """Runs the goals of the chassis."""
    frames: Frames
    """Transforms poses into the frame of the map."""
    pose: RobotPose
    """The robot's pose."""
    driving: DrivingSlot
    """Lets one goal at a time move the robot."""
    cancels: CancelLog
    """Tells what has cancelled a goal, besides its client."""
    result_timeout: float
    """Time for which the results of goals are kept, in seconds."""

    @property
    def map_in_use(self) -> tuple[str, str]:
        """Names of the scene and of the map that the robot uses; blank before its first report."""
        scene = self.last_known.value(Scene) or Scene()
        return scene.scene_name, scene.map_name

    @property
    def objections_except_busy(self) -> list[Objection]:
        """The reasons for which the robot rejects tasks now, except for its present task."""
        info = self.last_known.value(RobotInfo)
        return [] if info is None else objections_except_busy(info)


class Nav2Action(ABC):
    """One of Nav2's actions. Its goals run in the link thread."""

    name: str
    """Name of the action."""
    navigates = False
    """True if its goals are navigations of the chassis, which replace each other without a stop."""
    drives = True
    """False if its goals do not move the robot."""
    is_paused_by_stop = False
    """True if the emergency stop only pauses what the chassis executes for its goals, so that it
    could stay paused for ever, or drive on later."""

    def __init__(self, context: Nav2Context) -> None:
        self.context = context
        self.action_type = class_of(BY_NAME[self.name].type, "action")
        self._slot = context.driving if self.drives else Slot()
        self._tasks: dict[asyncio.Task[None], Nav2Goal] = {}
        """The goals that have not ended, by the asyncio task that runs the goal."""
        self._logged_fields: set[str] = set()
        """Fields of which `log_unused` has logged that they have no effect."""
        self.server = GoalServer(
            context.node,
            context.thread,
            self.action_type,
            self.name,
            self._start,
            context.result_timeout,
            self.check,
            # a result with `error_msg` can tell the client why, which a rejection cannot
            rejects=not hasattr(self.action_type.Result, "error_msg"),
            services=RARE_QOS,
            feedback=RARE_QOS,
        )

    async def check(self, request: Any) -> None:  # noqa: B027 - most actions need no check
        """Check a goal before it is accepted, and transform its poses into the frame of the map.

        Raises:
            RejectedError: the goal cannot be executed. It is aborted if its result has a text, and
                otherwise rejected. The running goal goes on.
        """

    def validate(self, request: Any) -> None:  # noqa: B027 - most actions need no check
        """Check an accepted goal before it ends the running one.

        Raises:
            GoalEnd: the goal cannot be executed. The running goal goes on.
        """

    @abstractmethod
    async def execute(self, goal: Nav2Goal) -> None:
        """Execute a goal, and fill its result.

        Raises:
            GoalEnd: the goal is not reached.
            LinkError: the goal is not reached, because the chassis does not answer.
        """

    async def stop(self) -> None:
        """Abort the goals that have not ended."""
        tasks = dict(self._tasks)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        for goal in tasks.values():  # a task that had not started has ended no goal
            goal.finish(GoalEnd(STOPPING))

    def log_unused(self, request: Any, field: str, default: Any = "") -> None:
        """Log once that a field has no effect, if a request sets it to other than its default."""
        if getattr(request, field, default) != default and field not in self._logged_fields:
            self._logged_fields.add(field)
            _LOG.info("%s: %s has no effect: the robot plans by itself", self.name, field)

    def _start(self, accepted: Goal) -> None:
        goal = Nav2Goal(accepted, self)
        accepted.on_cancel(lambda: goal.stop(GoalEnd(outcome=Outcome.CANCELED)))
        task = start_task(self._run(goal, accepted.objection), name=f"nav2: {self.name}")
        if not task.done():  # it may have run to its end already
            self._tasks[task] = goal
            task.add_done_callback(self._tasks.pop)

    async def _run(self, goal: Nav2Goal, objection: str) -> None:
        reason: GoalEnd | None = GoalEnd(STOPPING)  # if the task is cancelled
        try:
            if objection:  # `check` objects only to poses that it cannot transform
                raise GoalEnd(objection, "TF_ERROR")
            goal.raise_if_ending()  # cancelled before it was accepted: the running goal goes on
            self.validate(goal.request)
            await self._slot.take(goal)
            await self.execute(goal)
            reason = None
        except (GoalEnd, LinkError) as end:
            reason = end if isinstance(end, GoalEnd) else GoalEnd(str(end))
            if reason.outcome is Outcome.ABORTED:
                level = logging.INFO if str(end) == _REPLACED else logging.WARNING
                _LOG.log(level, "%s: the goal is aborted: %s", self.name, end)
        except Exception as error:
            _LOG.exception("%s failed", self.name)
            reason = GoalEnd(f"the agent failed: {error!r}; please report this")
        finally:
            goal.finish(reason)


def to_duration(seconds: float) -> Duration:
    """Return a time in seconds as a Duration, limited to what that can hold."""
    nanoseconds = round(min(max(seconds, 0.0), _LONGEST) * 1e9)
    return Duration(sec=nanoseconds // 1_000_000_000, nanosec=nanoseconds % 1_000_000_000)


def to_seconds(message: Duration) -> float:
    """Return a Duration in seconds."""
    return float(message.sec + message.nanosec / 1e9)
