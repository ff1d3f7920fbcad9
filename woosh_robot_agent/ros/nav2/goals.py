"""Goals of Nav2's actions. The chassis executes each of them by one or several commands.

A Nav2 goal is a coroutine in the link thread, which calls `Nav2Goal.run_command` for each command.
A command is a goal of the agent's own actions (`ros/actions/`).

If something other than the chassis ends the Nav2 goal, e.g. a cancel of its client, a newer goal or
a timeout, the reason is a `GoalEnd`. The command is cancelled first, here or by the service `stop`.
When it has ended, the `GoalEnd` is raised in the coroutine, or a `FailedCommand` if the cancel had
no effect.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from typing import Any, TypeVar

from builtin_interfaces.msg import Duration
from google.protobuf.message import Message

from woosh_robot_agent.link.tasks import start_task
from woosh_robot_agent.motion.wheel_owner import is_held_up
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ExecTask
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo, Scene, TaskProc
from woosh_robot_agent.pb.ros.action_pb2 import kResume
from woosh_robot_agent.pb.ros.ros_pack_pb2 import kRosCancel, kRosPause
from woosh_robot_agent.pb.util import action_pb2 as action
from woosh_robot_agent.pb.util.task_pb2 import kCanceled, kPaused
from woosh_robot_agent.robot.readiness import Objection, objections_except_busy
from woosh_robot_agent.robot.status_codes import explained
from woosh_robot_agent.ros.actions.actions import Actions, AgentGoal
from woosh_robot_agent.ros.actions.goal import Cause, End, Outcome
from woosh_robot_agent.ros.actions.server import Goal
from woosh_robot_agent.ros.nav2.cancels import CancelLog
from woosh_robot_agent.ros.nav2.frames import Frames
from woosh_robot_agent.ros.nav2.pose import RobotPose
from woosh_robot_agent.ros.standard.part import PartContext

T = TypeVar("T")

_LOG = logging.getLogger(__name__)
_PERIOD = 0.1
"""Period of feedback, in seconds."""
_LONGEST = 2.0**31 - 1.0
"""Longest time in a Duration, in seconds."""
_CANCELLED = (kRosCancel, kCanceled)
"""States in reports on an action or a task that was cancelled."""


class GoalEnd(Exception):
    """The reason why a goal ends before it is reached.

    Args:
        text: the reason; empty if the client of the goal ends it.
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


class Replaced(GoalEnd):
    """A newer goal takes the place of this one."""

    def __init__(self) -> None:
        super().__init__("replaced by a newer goal")


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


def _says_paused(report: Message) -> bool:
    """Return True if an action or a task is paused, and does not go on by itself."""
    if isinstance(report, TaskProc):
        return report.state == kPaused and not is_held_up(report)
    return getattr(report, "state", None) == kRosPause


@dataclass(frozen=True)
class Nav2Context(PartContext):
    """The objects that Nav2's actions share."""

    actions: Actions
    """Runs the commands of Nav2's goals."""
    frames: Frames
    """Transforms poses into the frame of the map."""
    pose: RobotPose
    """The robot's pose."""
    cancels: CancelLog
    """Tells what has cancelled a command, other than the client of its goal."""
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


class Nav2Goal:
    """A running goal of a Nav2 action. Use it in the link thread.

    Args:
        goal: the goal as the action server keeps it.
        name: name of the action.
        action_type: ROS class of the action.
        navigates: True if the goal is a navigation of the chassis.
        is_paused_by_emergency_stop: as in `Nav2Action`.

    Attributes:
        request: the goal as the client gave it.
        result: the result, to be filled by the action.
        ended: future that is done when the goal has ended.
        command: the command that was sent to the chassis and has not ended; None without one.
        is_stopped: True once `stop` was called, even if there was no command to cancel.
        interruption: reason why the goal sends no further command, because the robot obeyed no
            velocity meanwhile; None without one.
    """

    def __init__(
        self,
        goal: Goal,
        context: Nav2Context,
        name: str,
        action_type: Any,
        *,
        navigates: bool,
        is_paused_by_emergency_stop: bool,
    ) -> None:
        loop = asyncio.get_running_loop()
        self.request = goal.request
        self.navigates = navigates
        self.is_paused_by_emergency_stop = is_paused_by_emergency_stop
        self.result = action_type.Result()
        self.ended: asyncio.Future[None] = loop.create_future()
        self.command: AgentGoal | None = None
        self.is_stopped = False
        self.interruption: GoalEnd | None = None
        self._name = name
        self._goal = goal
        self._feedback_class = action_type.Feedback
        self._context = context
        self._map = context.map_in_use
        """The map for which the client has given the places in the goal."""
        self._started = loop.time()
        """Loop time at which the goal was accepted."""
        self._published = goal.published
        """Loop time at which the client sent the goal, or later, at which the last command ended.
        If the agent stood still until then, nobody may want the next command any more."""
        self._is_paused = False
        """True if the last report on the command says that it waits until a client resumes it."""
        self._reason: asyncio.Future[GoalEnd] = loop.create_future()
        """Why the goal ends; done when something other than the chassis ends it."""
        self._older: Nav2Goal | None = None
        """The navigation that this goal replaces when the chassis accepts this goal; None without
        one, and once the chassis has decided."""
        self._timer: asyncio.TimerHandle | None = None
        """Timer of the last `set_timeout`; None before the first."""

    @property
    def elapsed(self) -> float:
        """Time since the goal was accepted, in seconds."""
        return asyncio.get_running_loop().time() - self._started

    @property
    def is_ending(self) -> bool:
        """True once something other than the chassis ends the goal."""
        return self._reason.done()

    def feedback(self, **fields: Any) -> None:
        """Publish feedback with these fields."""
        self._goal.feedback(self._feedback_class(**fields))

    def send_no_more(self, reason: GoalEnd) -> None:
        """End the goal for a reason, unless it is already ending, but cancel nothing.

        No further command is sent. If the chassis executes a command for the goal, the goal ends
        when the command has ended.
        """
        if not self.is_ending:
            self._reason.set_result(reason)

    def stop(self, reason: GoalEnd) -> None:
        """End the goal for a reason, unless it is already ending, and cancel its command.

        A navigation that this goal was to replace is cancelled, too, unless the chassis has already
        accepted this goal.
        """
        self.send_no_more(reason)
        self.is_stopped = True
        if self.command is not None:
            self.command.cancel()
        self._stop_older()

    def set_timeout(self, seconds: float, reason: GoalEnd) -> None:
        """End the goal for a reason after a time in seconds; 0 or less is no limit."""
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
        older.send_no_more(Replaced())

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
            GoalEnd: the goal is ending, and the command has not succeeded.
            FailedCommand: the chassis has refused the command, or failed to execute it.
        """
        self.raise_if_ending()
        if self.interruption is not None:
            raise self.interruption
        self._check_map()
        sent = asyncio.get_running_loop().time()
        self._is_paused = False

        def report(message: Message) -> None:
            self._note_pause(command, message)
            on_report(message)

        running = self._context.actions.start(command, report, self._published)
        self.command = running
        running.accepted.add_done_callback(self._command_decided)
        try:
            await self._repeat(tick, lambda: running.ended.done() or is_done(), running.ended)
        except Exception:  # a defect of `tick` or `is_done` must not leave the robot driving
            running.cancel()
            raise
        finally:
            self.command, self._published = None, asyncio.get_running_loop().time()
        if not running.ended.done():
            return None
        end = running.ended.result()
        if end.outcome is not Outcome.SUCCEEDED:
            raise await self._failure(end, command, sent)
        return end.cause

    def _check_map(self) -> None:
        """Check that the robot uses the map for which the places in the goal were given.

        Raises:
            GoalEnd: it uses another one, in which the places are elsewhere.
        """
        (scene, name), (scene_now, name_now) = self._map, self._context.map_in_use
        if (scene_now, name_now) != (scene, name):
            raise GoalEnd(
                f"the goal is for the map {name} of the scene {scene}, and the robot now uses the "
                f"map {name_now} of the scene {scene_now}: send a goal for this map"
            )

    def _note_pause(self, command: Message, report: Message) -> None:
        """Log a pause of the command: nothing else would tell that the robot waits."""
        was_paused, self._is_paused = self._is_paused, _says_paused(report)
        is_over = self.is_ending or self.ended.done()
        if was_paused or is_over or not self._is_paused:
            return
        cause = "it does not say why; perhaps a call of robot/Twist with a zero velocity"
        is_task = isinstance(command, ExecTask)
        _LOG.warning(
            "%s: the robot has paused (%s): resume it by %s with %s, or cancel the goal",
            self._name,
            getattr(report, "msg", "") or cause,
            "robot/ActionOrder" if is_task else f"ros/{command.DESCRIPTOR.name}",
            f"order {action.kContinue}" if is_task else f"action {kResume}",
        )

    def _command_decided(self, accepted: asyncio.Future[bool]) -> None:
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
            self._older.stop(Replaced())

    async def _failure(self, end: End, command: Message, sent: float) -> GoalEnd:
        """Return why a command has not succeeded.

        Args:
            sent: loop time at which the command was sent.
        """
        if self.is_ending:
            reason = self._reason.result()
            if end.outcome is Outcome.CANCELED:
                await self._context.pose.wait_until_standing()
                return reason
            if isinstance(reason, Replaced) and not self.is_stopped:
                return reason  # the newer navigation has ended the command
            # the cancel had no effect: the text of the failure says that the robot may go on
        canceller = ""
        if getattr(end.result, "state", None) in _CANCELLED:
            canceller = await self._context.cancels.source(command, sent)
        return FailedCommand(end, canceller)

    async def wait_until(
        self,
        condition: Callable[[], bool],
        *wakes: asyncio.Future[Any],
        tick: Callable[[], None] = lambda: None,
    ) -> None:
        """Wait until a condition holds.

        Args:
            condition: checked ten times a second, and when one of `wakes` is done.
            tick: called ten times a second, to publish feedback.

        Raises:
            GoalEnd: the goal has ended before.
        """
        await self._repeat(tick, lambda: self.is_ending or condition(), self._reason, *wakes)
        if not condition():
            self.raise_if_ending()

    async def run(
        self, work: Coroutine[Any, Any, T], name: str, tick: Callable[[], None] = lambda: None
    ) -> T:
        """Run a coroutine, which is cancelled if the goal ends before, and return its result.

        Args:
            work: the coroutine, e.g. one that waits for an answer of the chassis.
            name: its name, for debugging.
            tick: called ten times a second, to publish feedback.

        Raises:
            GoalEnd: the goal has ended before.
        """
        task = start_task(work, name=f"nav2: {name}")
        try:
            await self.wait_until(task.done, task, tick=tick)
            return task.result()
        finally:
            task.cancel()

    async def _repeat(
        self,
        tick: Callable[[], None],
        is_over: Callable[[], bool],
        *wakes: asyncio.Future[Any],
    ) -> None:
        """Call `tick` ten times a second until `is_over` returns True.

        `is_over` is called as often, and when one of `wakes` is done.
        """
        clock = asyncio.get_running_loop().time
        due = clock()
        while not is_over():
            tick()
            due = max(due + _PERIOD, clock())
            await asyncio.wait(wakes, timeout=due - clock(), return_when=asyncio.FIRST_COMPLETED)

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


def to_duration(seconds: float) -> Duration:
    """Return a time in seconds as a Duration, limited to what that can hold."""
    nanoseconds = round(min(max(seconds, 0.0), _LONGEST) * 1e9)
    return Duration(sec=nanoseconds // 1_000_000_000, nanosec=nanoseconds % 1_000_000_000)


def to_seconds(message: Duration) -> float:
    """Return a Duration in seconds."""
    return float(message.sec + message.nanosec / 1e9)
