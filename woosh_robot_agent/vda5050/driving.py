"""The drive along a leg: the task of the robot, its pause, resumption, cancellation and end."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import time
from collections.abc import Callable
from itertools import pairwise

from woosh_robot_agent.convert.converter import RequestMaker
from woosh_robot_agent.link import (
    Answer,
    ChassisClient,
    ConnectionLostError,
    LinkError,
    LinkState,
    NotConnectedError,
    RequestTimeoutError,
)
from woosh_robot_agent.link.config import TooManyRequestsError
from woosh_robot_agent.link.reports import LogOnce
from woosh_robot_agent.link.tasks import run_with_timeout
from woosh_robot_agent.motion import MotionGate
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ActionOrder, ExecTask
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo, TaskHistory, TaskProc
from woosh_robot_agent.pb.util import action_pb2 as action
from woosh_robot_agent.pb.util import task_pb2 as task
from woosh_robot_agent.pb.util.common_pb2 import Pose2D
from woosh_robot_agent.pb.util.navigation_pb2 import PlanPath
from woosh_robot_agent.vda5050.background import BackgroundTasks
from woosh_robot_agent.vda5050.messages.order import Node, Trajectory
from woosh_robot_agent.vda5050.messages.state import Position
from woosh_robot_agent.vda5050.orders.legs import Leg, curve_points

_LOG = logging.getLogger(__name__)
_REPEAT_AFTER = 3.0
"""Time after which a command that stops the robot is repeated if it had no effect, in seconds."""
_EFFECT_WITHIN = 1.5
"""Maximum time from a command to the report of its effect, in seconds."""


class TaskOrders:
    """Pauses, resumes and cancels one task at a time. Used in the event loop of the link.

    A pause or a cancellation is repeated until the robot reports its effect, because it only stops
    the robot. A pause is sent again if the robot drives on. A resumption is sent once, when there
    is a link.

    Args:
        chassis: the link.
        gate: sends the commands.
        requests: addresses the requests.
        is_current: returns True unless the robot executes another task, which would get commands.
        inquire: asks the robot about the task.

    Attributes:
        paused: True if the robot has reported that the task is paused.
        stands: True if it is paused and was not resumed since.
    """

    def __init__(
        self,
        chassis: ChassisClient,
        gate: MotionGate,
        requests: RequestMaker,
        is_current: Callable[[], bool],
        inquire: Callable[[], None],
    ) -> None:
        self._chassis = chassis
        self._gate = gate
        self._requests = requests
        self._is_current = is_current
        self._inquire = inquire
        self.paused = False
        self.stands = False
        self._task_id = 0
        self._wanted: action.Order | None = None
        """Command that the robot must obey; None without one."""
        self._sent_at = dict.fromkeys((action.kPause, action.kContinue), -math.inf)
        """Loop times of a pause and a resumption whose effects were not reported yet; else minus
        infinity."""
        self._wake = asyncio.Event()
        self._log = LogOnce(_LOG)
        self._insisting: asyncio.Task[None] | None = None
        """Sends `_wanted` until the robot has obeyed."""
        self._tasks = BackgroundTasks("vda5050 task orders")
        chassis.on_state(lambda state: self._wake.set())

    def begin(self, task_id: int) -> None:
        """Control another task, which runs; 0 for none."""
        self._task_id = task_id
        self._wanted = None
        self.paused = self.stands = False
        self._sent_at = dict.fromkeys(self._sent_at, -math.inf)
        self._log.clear()
        self._wake.set()

    def pause(self) -> None:
        """Keep the task paused."""
        self._want(action.kPause)

    def resume(self) -> None:
        """Let the task go on."""
        self._want(action.kContinue)

    def cancel(self) -> None:
        """Cancel the task."""
        self._want(action.kCancel)

    def reported(self, paused: bool) -> bool:
        """Take a report on the task.

        Args:
            paused: the task is paused.

        Returns:
            True if `paused` or `stands` has changed.
        """
        before = (self.paused, self.stands)
        self.paused = paused
        self._sent_at[action.kPause if paused else action.kContinue] = -math.inf
        self.stands = paused and not self._may_take_effect(action.kContinue)
        changed = (self.paused, self.stands) != before
        if changed:
            self._wake.set()
        self._control()
        return changed

    async def close(self) -> None:
        """Send nothing more."""
        await self._tasks.close()

    def _want(self, order: action.Order) -> None:
        if self._task_id and self._wanted != action.kCancel:
            self._wanted = order
            self._wake.set()
            self._control()

    def _control(self) -> None:
        """Start to send the wanted command, unless the robot has obeyed it."""
        if self._due() is not None and (self._insisting is None or self._insisting.done()):
            self._insisting = self._tasks.start(self._insist())

    async def _insist(self) -> None:
        """Send the wanted command until the robot has obeyed it."""
        while (order := self._due()) is not None:
            self._wake.clear()
            if self._chassis.state is LinkState.READY and self._is_current():
                self._sent_at[order] = asyncio.get_running_loop().time()
                if order == action.kContinue:
                    self._wanted, self.stands = None, False
                self._tasks.start(self._send(order, self._task_id))
            with contextlib.suppress(TimeoutError):
                await run_with_timeout(_REPEAT_AFTER, self._wake.wait())

    def _due(self) -> action.Order | None:
        """Return the command that the robot has not obeyed; None without one."""
        if self._wanted == action.kPause and self.stands:
            return None
        runs = not self.paused and not self._may_take_effect(action.kPause)
        if self._wanted == action.kContinue and runs:
            self._wanted = None
        return self._wanted

    def _may_take_effect(self, order: action.Order) -> bool:
        """Return True if a command was sent that may still take effect."""
        return asyncio.get_running_loop().time() < self._sent_at[order] + _EFFECT_WITHIN

    async def _send(self, order: action.Order, task_id: int) -> None:
        name = action.Order.Name(order)
        try:
            answer = await self._gate.request(self._requests.address(ActionOrder(order=order)))
        except LinkError as error:
            self._log.warn(f"{name} {task_id}", f"{name} of task {task_id} failed: {error}")
            is_unsent = isinstance(error, NotConnectedError | TooManyRequestsError)
            if is_unsent and order == action.kContinue and self._wanted is None:
                self._wanted = order
        else:
            if not answer.ok and task_id == self._task_id:
                self._log.warn(
                    f"{name} {task_id}", f"the robot refused {name} of task {task_id}: {answer.msg}"
                )
        if task_id == self._task_id:
            self._inquire()


def leg_task(leg: Leg, position: Position | None) -> ExecTask:
    """Return the task that drives a leg, without its id.

    Args:
        leg: the leg.
        position: position of the robot; None if unknown.
    """
    request = ExecTask(type=task.kPick)
    if leg.goal.mark:
        request.mark_no = leg.goal.mark
    elif leg.edges[0].trajectory is not None:
        for edge, node in zip(leg.edges, leg.nodes, strict=True):
            if edge.trajectory is not None:
                _add_segment(request, _along(edge.trajectory, node), PlanPath.kStrict)
    else:
        poses = _through(leg.nodes, position)
        if len(poses) == 1:
            request.pose.CopyFrom(poses[0])
        else:
            _add_segment(request, poses, PlanPath.kOptimal)
    return request


def _add_segment(request: ExecTask, poses: list[Pose2D], optimal: PlanPath.Optimal) -> None:
    segment = request.plan_path.plan_path.add(target=poses[-1], optimal=optimal)
    segment.path.poses.extend(poses)


def _through(nodes: tuple[Node, ...], position: Position | None) -> list[Pose2D]:
    """Return a pose for each node. Without `theta`, its heading is that of the way to the node."""
    poses: list[Pose2D] = []
    here = None if position is None else (position.x, position.y)
    heading = 0.0 if position is None else position.theta
    for node in nodes:
        place = node.position
        if place is None:
            continue
        if here is not None and here != (place.x, place.y):
            heading = math.atan2(place.y - here[1], place.x - here[0])
        here = (place.x, place.y)
        heading = heading if place.theta is None else place.theta
        poses.append(Pose2D(x=place.x, y=place.y, theta=heading))
    return poses


def _along(trajectory: Trajectory, end: Node) -> list[Pose2D]:
    """Return the poses along a trajectory, without its start, where the robot stands."""
    points = curve_points(trajectory)
    poses = [
        Pose2D(x=there[0], y=there[1], theta=math.atan2(there[1] - here[1], there[0] - here[0]))
        for here, there in pairwise(points)
        if here != there
    ]
    if end.position is not None and end.position.theta is not None:
        poses[-1].theta = end.position.theta
    return poses


_REPORT_AFTER = 3.0
"""Time after which the robot must have reported a task that it executes, in seconds."""
_ASK_EVERY = 1.0
"""Pause between two queries about a task, in seconds."""
_ENDED = {
    task.kCompleted: "",
    task.kCanceled: "the task was cancelled at the robot",
    task.kFailed: "the task failed",
}
"""Reasons why a leg was not driven to its end, by the state of its task; empty if it was."""
UNKNOWN_TASK = "the robot does not know the task"
"""Reason if the robot does not tell how a task ended, e.g. because it was restarted."""


class Driver:
    """Drives one leg at a time by a task of the robot. Used in the event loop of the link.

    A start is never repeated. If the outcome of a task is unknown, the robot is asked.

    Args:
        chassis: the link.
        gate: sends the commands.
        requests: addresses the requests.
        on_end: called when the task has ended, with the reason why it failed; empty if it did not.
        on_unsent: called when a start was not sent, because there is no link.
        on_changed: called when the robot pauses or resumes the task, or when a task of another
            client begins or ends.

    Attributes:
        task_id: id of the current task; 0 without one.
        other_task: id of the task of another client that the robot executes; 0 without one.
        confirmed: True once the robot has reported on the current task over the current link.
    """

    def __init__(
        self,
        chassis: ChassisClient,
        gate: MotionGate,
        requests: RequestMaker,
        on_end: Callable[[str], None],
        on_unsent: Callable[[], None],
        on_changed: Callable[[], None],
    ) -> None:
        self._chassis = chassis
        self._gate = gate
        self._requests = requests
        self._on_end = on_end
        self._on_unsent = on_unsent
        self._on_changed = on_changed
        self.task_id = 0
        self._last_id = 0
        self.confirmed = False
        self.other_task = 0
        self._orders = TaskOrders(
            chassis, gate, requests, lambda: not self.other_task, self._inquire
        )
        self._inquiry: asyncio.Task[None] | None = None
        """Asks the robot about the current task."""
        self._tasks = BackgroundTasks("vda5050 driving")
        chassis.subscribe(TaskProc, self._reported)
        chassis.on_snapshot(self._snapshot)
        chassis.on_state(self._link_changed)

    @property
    def paused(self) -> bool:
        """True while the robot pauses the task, by its last report."""
        return self._orders.paused

    @property
    def stands(self) -> bool:
        """True while the robot pauses the task and was not told to go on."""
        return self._orders.stands

    def start(self, leg: Leg, position: Position | None) -> None:
        """Drive a leg.

        Args:
            leg: the leg.
            position: position of the robot; the heading at a node without one follows from it.
        """
        self.execute(leg_task(leg, position))

    def execute(self, request: ExecTask) -> None:
        """Execute a task; it gets a new id."""
        request.task_id = max(self._last_id + 1, int(time.time() * 1000))
        self._set_task(request.task_id)
        self._tasks.start(self._start(request.task_id, request))

    def restore(self, task_id: int, info: RobotInfo) -> None:
        """Follow a task that was started before a restart of the program.

        Args:
            task_id: id of the task; 0 if the start of a leg was not sent.
            info: the first report of the robot.
        """
        self._set_task(task_id)
        if task_id:
            self._snapshot(info)
        else:
            self._on_end("the connector was restarted before it sent the task")

    def cancel(self) -> None:
        """Cancel the task of the leg."""
        self._orders.cancel()

    def pause(self) -> None:
        """Keep the task of the leg paused."""
        self._orders.pause()

    def resume(self) -> None:
        """Resume the task of the leg."""
        self._orders.resume()

    async def close(self) -> None:
        """Stop waiting for answers; the robot goes on with its task."""
        await self._orders.close()
        await self._tasks.close()

    # Commands

    def _set_task(self, task_id: int) -> None:
        self.task_id = task_id
        self._last_id = max(self._last_id, task_id)
        self.confirmed = False
        self._orders.begin(task_id)

    async def _start(self, task_id: int, request: ExecTask) -> None:
        try:
            answer = await self._gate.request(self._requests.address(request))
        except (ConnectionLostError, RequestTimeoutError) as error:
            _LOG.warning("the start of task %d was not answered: %s", task_id, error)
            self._inquire()
        except NotConnectedError:
            if task_id == self.task_id:
                self._set_task(0)
                self._on_unsent()
        except LinkError as error:
            self._end_task(task_id, str(error))
        else:
            if not answer.ok:
                self._end_task(task_id, f"the robot refused the task: {answer.msg}")

    # Reports

    def _reported(self, report: TaskProc) -> None:
        self._note_other(report)
        if not self.task_id:
            return
        if report.robot_task_id == self.task_id:
            self._judge(report)
        elif self.confirmed:  # the last report on our task was lost
            self._inquire()

    def _note_other(self, report: TaskProc) -> None:
        """Take note of a task of another client."""
        is_running = report.robot_task_id and report.state not in _ENDED
        other = report.robot_task_id if is_running else 0
        if other == self.task_id:
            other = 0
        if other != self.other_task:
            self.other_task = other
            self._on_changed()

    def _judge(self, report: TaskProc) -> None:
        """Take a report on the current task."""
        self.confirmed = True
        if report.state in _ENDED:
            reason = _ENDED[report.state]
            self._end(f"{reason}: {report.msg}" if reason and report.msg else reason)
            return
        paused = report.state == task.kPaused and report.action.state == action.kSuspend
        if self._orders.reported(paused):
            self._on_changed()

    def _snapshot(self, info: RobotInfo) -> None:
        """Find out the state of the task after a reconnect."""
        self._note_other(info.task_proc)
        if not self.task_id:
            return
        if info.task_proc.robot_task_id == self.task_id:
            self._judge(info.task_proc)
        else:
            self._inquire()

    def _inquire(self) -> None:
        """Ask the robot about the current task until its state is known."""
        if self.task_id and (self._inquiry is None or self._inquiry.done()):
            self._inquiry = self._tasks.start(self._ask(self.task_id))

    async def _ask(self, task_id: int) -> None:
        clock = asyncio.get_running_loop().time
        deadline = math.inf
        while task_id == self.task_id:
            try:
                await self._chassis.wait_ready(_ASK_EVERY)
                if await self._ask_current(task_id) or await self._ask_history(task_id):
                    return
            except LinkError as error:
                _LOG.debug("no answer about task %d: %s", task_id, error)
                deadline = math.inf
            else:
                if clock() > deadline:
                    self._end_task(task_id, UNKNOWN_TASK)
                    return
                deadline = min(deadline, clock() + _REPORT_AFTER)
            await asyncio.sleep(_ASK_EVERY)

    async def _ask_current(self, task_id: int) -> bool:
        """Return True if the robot executes the task."""

        def found(answer: Answer) -> None:
            if isinstance(answer.body, TaskProc):
                self._note_other(answer.body)
                if answer.body.robot_task_id == task_id == self.task_id:
                    self._judge(answer.body)

        answer = await self._chassis.request(self._requests.empty(TaskProc), tap=found)
        return isinstance(answer.body, TaskProc) and answer.body.robot_task_id == task_id

    async def _ask_history(self, task_id: int) -> bool:
        """Return True if the history of the robot has the end of the task."""

        def end_of(answer: Answer) -> TaskProc | None:
            reports = answer.body.tes if isinstance(answer.body, TaskHistory) else ()
            ended = (each for each in reports if each.state in _ENDED)
            return next((each for each in ended if each.robot_task_id == task_id), None)

        def found(answer: Answer) -> None:
            report = end_of(answer)
            if report is not None and task_id == self.task_id:
                self._judge(report)

        answer = await self._chassis.request(self._requests.empty(TaskHistory), tap=found)
        return end_of(answer) is not None

    def _link_changed(self, state: LinkState) -> None:
        if state is not LinkState.READY:
            self.confirmed = False

    def _end_task(self, task_id: int, reason: str) -> None:
        if task_id == self.task_id:
            self._end(reason)

    def _end(self, reason: str) -> None:
        if self.task_id:
            self._set_task(0)
            self._on_end(reason)
