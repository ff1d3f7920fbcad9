"""Execution of the robot's tasks: drives along the legs of an order, and tasks of actions."""

from __future__ import annotations

import asyncio
import logging
import math
import time
from collections.abc import Callable
from itertools import pairwise

from woosh_robot_agent.link import (
    Answer,
    ConnectionLostError,
    LinkError,
    LinkState,
    NotConnectedError,
    RequestTimeoutError,
)
from woosh_robot_agent.motion.wheel_owner import WITH_TASK
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ActionOrder, ExecTask
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo, TaskHistory, TaskProc
from woosh_robot_agent.pb.util import action_pb2 as action
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.pb.util import task_pb2 as task
from woosh_robot_agent.pb.util.common_pb2 import Pose2D
from woosh_robot_agent.pb.util.navigation_pb2 import PlanPath
from woosh_robot_agent.sentences import Sentence, said_by
from woosh_robot_agent.vda5050.messages.geometry import curve_points
from woosh_robot_agent.vda5050.messages.order import Node, Trajectory
from woosh_robot_agent.vda5050.messages.state import (
    ROBOT_REFUSED,
    WITH_TEXT,
    ActionFailedError,
    ActionStatus,
    ErrorType,
    Position,
)
from woosh_robot_agent.vda5050.orders.legs import Control, Leg
from woosh_robot_agent.vda5050.robot.control import Controller
from woosh_robot_agent.vda5050.robot.link import RobotLink


def leg_task(leg: Leg, position: Position | None) -> ExecTask:
    """Return the task that drives a leg (part of an order without a stop), without its id.

    Args:
        position: position of the robot, from which the heading at a node without `theta` follows;
            None if unknown.
    """
    request = ExecTask(type=task.kPick)  # drives to its target, and does nothing there
    if leg.goal.mark:
        request.mark_no = leg.goal.mark
    elif leg.edges[0].trajectory is not None:
        for edge, node in zip(leg.edges, leg.nodes, strict=True):
            if edge.trajectory is not None:
                _add_segment(request, _trajectory_poses(edge.trajectory, node), PlanPath.kStrict)
    else:
        poses = _node_poses(leg.nodes, position)
        if len(poses) == 1:
            request.pose.CopyFrom(poses[0])
        else:
            _add_segment(request, poses, PlanPath.kOptimal)
    return request


def _add_segment(request: ExecTask, poses: list[Pose2D], optimal: PlanPath.Optimal) -> None:
    segment = request.plan_path.plan_path.add(target=poses[-1], optimal=optimal)
    segment.path.poses.extend(poses)


def _node_poses(nodes: tuple[Node, ...], position: Position | None) -> list[Pose2D]:
    """Return a pose for each node that has a position.

    At a node without `theta`, the heading is the direction in which the robot arrives.
    """
    poses: list[Pose2D] = []
    here = None if position is None else position.point
    heading = 0.0 if position is None else position.theta
    for node in nodes:
        place = node.position
        if place is None:
            continue
        if here is not None and here != place.point:
            heading = math.atan2(place.y - here[1], place.x - here[0])
        here = place.point
        heading = heading if place.theta is None else place.theta
        poses.append(Pose2D(x=place.x, y=place.y, theta=heading))
    return poses


def _trajectory_poses(trajectory: Trajectory, end: Node) -> list[Pose2D]:
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


_LOG = logging.getLogger(__name__)
_LEAVES_WITHIN = 3.0
"""Maximum time from the end of a task to the report that the robot has left it, in seconds."""
_THE_TASK = Sentence("the task")
_OTHER_ACTION = Sentence("the robot executes the task of another action")
_END_REASONS = {
    task.kCompleted: "",
    task.kCanceled: Sentence("the task was cancelled at the robot")(),
    task.kFailed: Sentence("the task failed")(),
}
"""Reasons why a task was not completed, by its final state; empty for a completed task."""
_UNKNOWN_TASK = Sentence("the robot does not know the task")()
"""Reason if the robot does not tell how a task ended, e.g. because it was restarted."""
UNSENT = Sentence("there is no link to the robot")()
"""Reason if a task or an action was not started."""
_ORDERS = {
    Control.PAUSE: action.kPause,
    Control.RESUME: action.kContinue,
    Control.CANCEL: action.kCancel,
}


class TaskRunner:
    """Executes one task of the robot at a time. Used in the event loop of the link.

    A start is never repeated. If the outcome of a task is unknown, the robot is asked. It is also
    asked from time to time, because it may drop a task without a report.

    Args:
        on_end: called when the task has ended, with the reason of a failure; empty after a success.
        on_pause_changed: called when the robot has paused or resumed the task.

    Attributes:
        id: id of the current task; 0 without a task.
        foreign_id: id of the task that the robot executes, if it is not the current task of this
            runner; otherwise 0.
        confirmed: True once the robot has reported on the current task over the current link.
        controller: pauses, resumes and cancels the current task; each task has its own.
        was_canceled: True if the last task was cancelled, by its last report.
        leaves_until: loop time until which the robot may still be in its last task.
    """

    def __init__(
        self, link: RobotLink, on_end: Callable[[str], None], on_pause_changed: Callable[[], None]
    ) -> None:
        self._link = link
        self._on_end = on_end
        self._on_pause_changed = on_pause_changed
        self.id = 0
        self._last_id = 0
        """Highest id so far, so that no id is used twice."""
        self._given_up = 0
        """Id of the last task that the robot did not know any more; 0 without one."""
        self.foreign_id = 0
        self.confirmed = False
        self.was_canceled = False
        self.leaves_until = -math.inf
        self.controller = self._new_controller()
        link.chassis.subscribe(TaskProc, self._reported)
        link.chassis.on_snapshot(self._snapshot)
        link.chassis.on_state(self._link_changed)
        link.gate.wheel_owner.on_task(self._task_told)

    @property
    def is_late(self) -> bool:
        """True while a task that began after it was given up is being cancelled."""
        return self.id == self._given_up != 0

    def start(self, request: ExecTask) -> None:
        """Execute a task; it gets a new id."""
        # by the clock, so that it is not the id of a task of an earlier run of the program
        request.task_id = max(self._last_id + 1, int(time.time() * 1000))
        self._set_current(request.task_id)
        self.was_canceled = False
        self._link.background.start(self._start(request.task_id, request))

    def restore(self, task_id: int, info: RobotInfo) -> None:
        """Take over a task that was started before a restart of the program.

        Args:
            task_id: id of the task.
            info: the first report of the robot.
        """
        self._set_current(task_id)
        self._snapshot(info)
        self._link.background.start(self._check(task_id))

    def want(self, control: Control) -> None:
        """Pause, resume or cancel the task as soon as possible; do nothing without a task.

        A cancelled task stays cancelled.
        """
        if self.id:
            self.controller.want(control)

    # Commands

    def _set_current(self, task_id: int) -> None:
        """Make a task the current one, with a controller of its own; 0 for no task."""
        self.id = task_id
        self._last_id = max(self._last_id, task_id)
        self.confirmed = False
        self.controller.end()
        self.controller = self._new_controller()

    def _new_controller(self) -> Controller:
        """Return a controller for the current task."""
        task_id = self.id

        async def send(control: Control) -> Answer:
            return await self._link.command(ActionOrder(order=_ORDERS[control]))

        def answered(_control: Control) -> None:
            if task_id == self.id:
                self._ask_until_known()  # so that the effect is known even if no report tells it

        def may_send() -> bool:
            return not self.foreign_id  # an ActionOrder names no task: it would hit the foreign one

        return Controller(self._link, f"task {task_id}", send, answered, may_send)

    async def _start(self, task_id: int, request: ExecTask) -> None:
        """Send the start of a task, then ask about the task from time to time until its end.

        A task whose start was not sent or was refused ends at once. If the answer is lost, the
        robot is asked about the task at once.
        """
        try:
            answer = await self._link.command(request)
        except (ConnectionLostError, RequestTimeoutError) as error:
            _LOG.warning("the start of task %d was not answered: %s", task_id, error)
            self._ask_until_known()
        except NotConnectedError:
            self._end(task_id, UNSENT)
        except LinkError as error:
            self._end(task_id, said_by(error))
        else:
            if not answer.ok:
                self._end(task_id, ROBOT_REFUSED(what=_THE_TASK(), reason=answer.reason))
        await self._check(task_id)

    # Reports

    def _reported(self, report: TaskProc) -> None:
        """Handle a pushed report on the task that the robot executes."""
        self._update_foreign_id(report)
        if not self.id:
            return
        if report.robot_task_id == self.id:
            self._handle_report(report)
        elif self.confirmed:  # the report on the end of the current task was lost
            self._ask_until_known()

    def _update_foreign_id(self, report: TaskProc) -> None:
        """Update `foreign_id` from a report on the task that the robot executes.

        If the robot begins the task that was given up, take it over again, and cancel it.
        """
        is_foreign = report.state not in _END_REASONS and report.robot_task_id != self.id
        is_given_up = not self.id and report.robot_task_id == self._given_up
        if is_foreign and is_given_up:
            _LOG.warning("the robot begins task %d too late; it is cancelled", self._given_up)
            self._set_current(self._given_up)
            self.want(Control.CANCEL)
            is_foreign = False
        foreign_id = report.robot_task_id if is_foreign else 0
        if foreign_id != self.foreign_id:
            self.foreign_id = foreign_id
            if not foreign_id:
                self._note_end()
            self._link.changed()

    def _task_told(self, report: TaskProc) -> None:
        """Clear `foreign_id` after an end that is known only from an answer."""
        if self.foreign_id and not report.robot_task_id:
            ended = TaskProc(robot_task_id=self.foreign_id, state=task.kCompleted)
            self._update_foreign_id(ended)

    def _handle_report(self, report: TaskProc) -> None:
        """Update the current task from a report."""
        if not self.confirmed:
            self.confirmed = True
            self.controller.send_now()  # the robot may have refused a command before it began
        if report.state in _END_REASONS:
            reason = _END_REASONS[report.state]
            text = report.msg if reason else ""
            self.was_canceled = report.state == task.kCanceled
            self._link.gate.wheel_owner.task_ended(self.id)
            self._end(self.id, WITH_TEXT(reason=reason, text=text) if text else reason)
            return
        # before an obstacle, the state of the task is kPaused, too
        paused = report.state == task.kPaused and report.action.state == action.kSuspend
        if self.controller.update(paused):
            self._on_pause_changed()

    def _snapshot(self, info: RobotInfo) -> None:
        """Find out the state of the current task after a reconnect, or a restart of the program."""
        self._update_foreign_id(info.task_proc)
        if not self.id:
            return
        if info.task_proc.robot_task_id == self.id:
            self._handle_report(info.task_proc)
        else:
            self._ask_until_known()

    def _ask_until_known(self) -> None:
        """Ask the robot about the current task until its state is known."""
        if task_id := self.id:
            self._link.background.start_once(lambda: self._ask(task_id), (self, task_id))

    async def _check(self, task_id: int) -> None:
        """Ask the robot about a task from time to time until the task has ended."""
        while task_id == self.id:
            await asyncio.sleep(self._link.timing.check_every)
            if task_id == self.id:
                self._ask_until_known()

    async def _ask(self, task_id: int) -> None:
        """Ask about a task until its state is known.

        Give the task up if the robot answers for `Timing.give_up_after`, but knows nothing of it.
        While the robot tells that it executes a task, but not which one, give the task up only
        after a cancellation that the robot has accepted.
        """
        clock = asyncio.get_running_loop().time
        deadline = math.inf
        while task_id == self.id:
            try:
                await self._link.wait_ready()
                is_current = await self._ask_current(task_id)
                if is_current or await self._ask_history(task_id):
                    return
                is_cancelled = self.controller.cancel_accepted
                if is_current is None and self.confirmed and not is_cancelled:
                    return  # the robot refuses queries, but reports on the task
                if clock() > deadline:
                    try:
                        goes_on = await self._ask_robot_state(task_id)
                    except RequestTimeoutError:
                        goes_on = False
                        self._link.background.start(self._learn_end(task_id))
                    if not goes_on or is_cancelled:
                        self._end(task_id, _UNKNOWN_TASK)
                    return
            except LinkError as error:
                _LOG.debug("no answer about task %d: %s", task_id, error)
                deadline = math.inf  # the robot has the full time again once it answers
            else:
                # a task that has just begun may be in neither answer yet
                deadline = min(deadline, clock() + self._link.timing.give_up_after)
            await asyncio.sleep(self._link.timing.ask_every)

    async def _ask_current(self, task_id: int) -> bool | None:
        """Ask for the current task of the robot, and take the report on it.

        Returns:
            True if `task_id` is the current task of the robot; None if the robot refused to tell.
        """

        def take_answer(answer: Answer) -> None:
            if answer.ok and isinstance(answer.body, TaskProc):
                self._update_foreign_id(answer.body)
                if answer.body.robot_task_id == task_id == self.id:
                    self._handle_report(answer.body)

        answer = await self._link.ask(TaskProc(), tap=take_answer)
        if not answer.ok:
            return None
        return isinstance(answer.body, TaskProc) and answer.body.robot_task_id == task_id

    async def _ask_history(self, task_id: int) -> bool:
        """Ask for the last tasks of the robot, and end this task if it is among them.

        Returns:
            True if the task has ended.
        """

        def end_of(answer: Answer) -> TaskProc | None:
            reports = answer.body.tes if isinstance(answer.body, TaskHistory) else ()
            ended = (each for each in reports if each.state in _END_REASONS)
            return next((each for each in ended if each.robot_task_id == task_id), None)

        def take_answer(answer: Answer) -> None:
            report = end_of(answer)
            if report is not None and task_id == self.id:
                self._handle_report(report)

        # `take_answer` is called in order with the pushed reports; this task goes on later
        answer = await self._link.ask(TaskHistory(), tap=take_answer)
        return end_of(answer) is not None

    async def _ask_robot_state(self, task_id: int) -> bool:
        """Ask for the state of the robot, and note the end of a task if the robot is idle.

        Returns:
            True if the robot tells that it executes a task, but not which one.

        Raises:
            LinkError: the robot did not answer.
        """

        def take_answer(answer: Answer) -> None:
            # other states, e.g. a fault, may hide that a task goes on
            if isinstance(answer.body, RobotInfo) and answer.body.state == robot.kIdle:
                self._link.gate.wheel_owner.task_ended(task_id)

        answer = await self._link.ask(RobotInfo(), tap=take_answer)
        state = answer.body.state if isinstance(answer.body, RobotInfo) else None
        return state in WITH_TASK and not self.foreign_id

    async def _learn_end(self, task_id: int) -> None:
        """Ask for the state of the robot until it answers: an order may wait for the task's end.

        Without a link, do nothing more: after a reconnect, the robot tells its task.
        """
        while self._link.ready:
            try:
                await self._ask_robot_state(task_id)
            except LinkError as error:
                _LOG.debug("no answer about the state after task %d: %s", task_id, error)
                await asyncio.sleep(self._link.timing.ask_every)
            else:
                self._link.changed()
                return

    def _link_changed(self, state: LinkState) -> None:
        self.controller.send_now()
        if state is not LinkState.READY:
            self.confirmed = False

    def _end(self, task_id: int, reason: str) -> None:
        """End a task, unless it is not the current one any more."""
        if task_id and task_id == self.id:
            if reason == _UNKNOWN_TASK:
                self._given_up = task_id
            self._set_current(0)
            self._note_end()
            self._on_end(reason)

    def _note_end(self) -> None:
        """Take note that the robot may take some time to leave the task that has ended."""
        loop = asyncio.get_running_loop()
        self.leaves_until = loop.time() + _LEAVES_WITHIN
        loop.call_at(self.leaves_until, self._link.changed)


class ActionTasks:
    """Executes the tasks of the vehicle's actions, one at a time.

    Attributes:
        runner: executes the task; it goes on after an action that need not wait for its end.
        ended_by_action: True if another action ends the task that an action waits for.
    """

    def __init__(self, link: RobotLink) -> None:
        self._link = link
        self.runner = TaskRunner(link, self._ended, self._pause_changed)
        self._end: asyncio.Future[str] | None = None
        """Done when the task has ended, with the reason of a failure; empty after a success.

        None if no action waits for the task, e.g. for one that goes on charging.
        """
        self._report: Callable[[ActionStatus], None] = lambda status: None
        """Called with the status of the action that waits for the task, or has waited last."""
        self.ended_by_action = False
        self.has_leftover = False
        """True while the robot executes a task that an action started before a restart."""

    @property
    def awaited_id(self) -> int:
        """Id of the task that an action waits for; 0 without one."""
        return self.runner.id if self._end is not None else 0

    @property
    def is_busy(self) -> bool:
        """True while an action waits for a task, or a task that began late is being cancelled."""
        return self._end is not None or self.runner.is_late

    @property
    def paused(self) -> bool:
        """True while the task that an action waits for is paused, by its last report."""
        return self._end is not None and self.runner.controller.paused

    @property
    def all_paused(self) -> bool:
        """True if no action waits for a task, or this task stays paused."""
        return self._end is None or self.runner.controller.stays_paused

    def want(self, control: Control) -> None:
        """Pause or resume the task that an action waits for."""
        if self._end is not None:
            self.runner.want(control)

    def restore(self, task_id: int, info: RobotInfo, is_done: Callable[[], bool]) -> None:
        """Take over the task that the robot may still execute after a restart of the program.

        Args:
            task_id: `awaited_id` before the restart.
            info: the first report of the robot.
            is_done: returns True once what the action waited for has happened, e.g. the battery is
                being charged. Then the end of the task is not waited for.
        """
        if task_id:
            self.has_leftover = True
            self._end = asyncio.get_running_loop().create_future()
            self._link.background.start(self._wait_for_leftover(self._end, is_done))
            self.runner.restore(task_id, info)

    async def _wait_for_leftover(
        self, end: asyncio.Future[str], is_done: Callable[[], bool]
    ) -> None:
        """Wait until the leftover task ends, or what its action waited for happens; forget it."""
        await self._link.conditions.wait(lambda: end.done() or is_done())
        self._end, self.has_leftover = None, False
        self._link.changed()

    def cancel_leftover(self) -> None:
        """Cancel the task that was started before a restart."""
        if self.has_leftover:
            self.runner.want(Control.CANCEL)

    async def perform(
        self,
        request: ExecTask,
        report: Callable[[ActionStatus], None],
        is_done: Callable[[], bool] = lambda: False,
    ) -> None:
        """Execute a task. When cancelled, cancel the task at the robot, and wait for its end.

        Args:
            request: the task; it gets a new id.
            report: called when the task begins, and when the robot pauses or resumes it.
            is_done: returns True if the action need not wait for the end of the task.

        Raises:
            ActionFailedError: the task failed; of kind INTERRUPTED if its outcome is unknown, or if
                it was cancelled at the robot.
        """
        if self.is_busy:
            raise ActionFailedError(_OTHER_ACTION())
        end: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self._end, self._report, self.ended_by_action = end, report, False
        self._link.changed()  # so that `awaited_id` is saved before the task is sent
        self.runner.start(request)
        report(ActionStatus.RUNNING)
        try:
            await self._link.conditions.wait(lambda: end.done() or is_done())
        except asyncio.CancelledError:
            if not self._link.is_closing:  # when the connector ends, the robot goes on
                self.runner.want(Control.CANCEL)
                await asyncio.wait({end})
            raise
        finally:
            self._end = None
        if end.done() and end.result():
            by_others = self.runner.was_canceled and not self.ended_by_action
            interrupts = by_others or end.result() == _UNKNOWN_TASK
            raise ActionFailedError(
                end.result(), ErrorType.INTERRUPTED if interrupts else ErrorType.ACTION
            )

    def _ended(self, reason: str) -> None:
        if self._end is not None and not self._end.done():
            self._end.set_result(reason)
        self._link.changed()

    def _pause_changed(self) -> None:
        if self._end is not None:
            self._report(
                ActionStatus.PAUSED if self.runner.controller.paused else ActionStatus.RUNNING
            )
        self._link.changed()
