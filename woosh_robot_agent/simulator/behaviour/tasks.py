"""Tasks: one at a time, with a report for every change of its state."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from woosh_robot_agent.pb.robot import robot_pb2
from woosh_robot_agent.pb.util import action_pb2 as util_action_pb2
from woosh_robot_agent.pb.util import task_pb2 as util_task_pb2
from woosh_robot_agent.simulator import refusals
from woosh_robot_agent.simulator.behaviour.jobs import Job, Wait
from woosh_robot_agent.simulator.behaviour.robot import Robot
from woosh_robot_agent.simulator.body.devices import Device
from woosh_robot_agent.simulator.refusals import Refusal, RefusedError
from woosh_robot_agent.simulator.status_codes import failure

_MAX_HISTORY = 50
"""Number of ended tasks that are kept."""

_ENDED = (util_task_pb2.kCompleted, util_task_pb2.kCanceled, util_task_pb2.kFailed)
_STARTING = (util_task_pb2.kInit, util_task_pb2.kReady)


@dataclass
class TaskOrder:
    """An order to perform a task.

    Attributes:
        id: The `robot_task_id` in reports.
        type: Type of the task.
        dest: Number of the target mark, empty if the target is not a mark.
        jobs: Jobs of the task, in order.
        automatic: The robot has started the task by itself.
    """

    id: int
    type: util_task_pb2.Type
    dest: str
    jobs: list[Job]
    automatic: bool = False


class Tasks:
    """The current task, the rest of its set, and the ended tasks.

    `Ownership` decides when a task may start or resume.

    Attributes:
        proc: State of the current or last task.
        history: The last 50 ended tasks, oldest first.
        impeded: An obstacle blocks the task at the moment.
    """

    def __init__(self, robot: Robot) -> None:
        self.proc = robot_pb2.TaskProc()
        self.history: deque[robot_pb2.TaskProc] = deque(maxlen=_MAX_HISTORY)
        self.impeded = False
        self._robot = robot
        self._jobs: deque[Job] = deque()
        self._rest_of_set: deque[TaskOrder] = deque()
        self._automatic = False
        self._unannounced = False
        self._last_id = 0

    @property
    def active(self) -> bool:
        """True if a task runs, waits or is paused."""
        return self.proc.state != util_task_pb2.kStateUndefined and self.proc.state not in _ENDED

    @property
    def paused(self) -> bool:
        """True if the task is paused."""
        return self.proc.state == util_task_pb2.kPaused

    @property
    def recoverable(self) -> bool:
        """True if the last task failed and can be retried."""
        return self.proc.state == util_task_pb2.kFailed and bool(self._jobs)

    @property
    def automatic(self) -> bool:
        """True if the current task is an automatic one."""
        return self.active and self._automatic

    @property
    def job(self) -> Job | None:
        """Current job of the task, also while the task is paused."""
        return self._jobs[0] if self.active else None

    @property
    def device(self) -> Device:
        """Device that the current job needs, or the one that failed."""
        return self._jobs[0].device

    def owns(self, device: Device) -> bool:
        """Return True if the task owns `device`. A paused task owns nothing."""
        job = self.job
        return job is not None and not self.paused and job.device is device

    def new_id(self) -> int:
        """Return a unique id for a task that came without one, based on the simulated time."""
        self._last_id = max(int(self._robot.time), self._last_id + 1)
        return self._last_id

    def start(self, orders: Sequence[TaskOrder]) -> None:
        """Start one task or those of a set, and cancel the current one."""
        if self.active:
            self._end(util_task_pb2.kCanceled, f"replaced by task {orders[0].id}")
        self._rest_of_set = deque(orders)
        self._start_next()

    def pause(self, reason: str, state: util_action_pb2.State = util_action_pb2.kSuspend) -> None:
        """Pause the task.

        Raises:
            RefusedError: There is no task.
        """
        self.require_active(refusals.NO_TASK_TO_PAUSE)
        if self.paused:
            return
        self._jobs[0].suspend(self._robot)
        self.impeded = False
        self._change(util_task_pb2.kPaused, state, reason)

    def resume(self) -> None:
        """Resume a paused task, or end the wait of a waiting one."""
        if self.paused:
            self.retry()
        elif isinstance(self.job, Wait):
            self.job.end()

    def retry(self) -> None:
        """Start the current or failed job again."""
        self._jobs[0].suspend(self._robot)
        self._change(self._running_state(), util_action_pb2.kRosExecuting)

    def end_wait(self) -> None:
        """End the current wait of the task.

        Raises:
            RefusedError: The task is not waiting.
        """
        if self.paused or not isinstance(self.job, Wait):
            raise RefusedError(refusals.NOT_WAITING)
        self.job.end()

    def cancel(self, reason: str) -> None:
        """Cancel the task and the rest of its set.

        Raises:
            RefusedError: There is no task.
        """
        self.require_active()
        self._end(util_task_pb2.kCanceled, reason)
        self._rest_of_set.clear()

    def cancel_automatic(self, reason: str) -> None:
        """Cancel the task if it is an automatic one."""
        if self.automatic:
            self.cancel(reason)

    def forget_failed(self) -> None:
        """Make a failed task and the rest of its set unrecoverable."""
        if not self.active:
            self._jobs.clear()
            self._rest_of_set.clear()

    def require_active(self, refusal: Refusal = refusals.NO_TASK) -> None:
        """Check that there is a task.

        Args:
            refusal: The situation if there is none.

        Raises:
            RefusedError: There is none.
        """
        if not self.active:
            raise RefusedError(refusal)

    def tick(self, dt: float, *, device_free: bool) -> None:
        """Work on the task for `dt` seconds.

        Args:
            dt: Duration, in seconds.
            device_free: No action owns the device of the current job. Otherwise the job waits.
        """
        if self._unannounced:
            self._announce()
        elif self.proc.state in _STARTING:
            if self.proc.state == util_task_pb2.kInit:
                self._change(util_task_pb2.kReady)
            else:
                self._change(self._running_state(), util_action_pb2.kRosExecuting)
        elif self.active and not self.paused and device_free:
            self._work(dt)

    def _work(self, dt: float) -> None:
        progress = self._jobs[0].tick(self._robot, dt)
        if progress.failure:
            kind = self._jobs[0].kind
            self._robot.codes.report(failure(kind), kind, progress.failure)
            # The rest of the set is kept: the task may be recovered.
            self._end(util_task_pb2.kFailed, progress.failure)
        elif progress.done and len(self._jobs) > 1:
            self.impeded = False
            self._change(self.proc.state, util_action_pb2.kRosSuccess)
            self._jobs.popleft()
            self._change(self._running_state(), util_action_pb2.kRosExecuting)
        elif progress.done:
            self._end(util_task_pb2.kCompleted, progress.text)
            self._start_next()
        elif progress.impeded != self.impeded:
            self.impeded = progress.impeded
            if self.impeded:
                self._change(self.proc.state, util_action_pb2.kRosWarning, progress.text)
            else:
                self._change(self.proc.state, util_action_pb2.kRosExecuting)

    def _start_next(self) -> None:
        if not self._rest_of_set:
            return
        order = self._rest_of_set.popleft()
        self._automatic = order.automatic
        self._jobs = deque(order.jobs)
        self.proc = robot_pb2.TaskProc(
            robot_id=self._robot.robot_id,
            robot_task_id=order.id,
            type=order.type,
            state=util_task_pb2.kInit,
            dest=order.dest,
            time=int(self._robot.time),
        )
        # Reported in the next tick so that it follows the answer to the request.
        self._unannounced = True

    def _running_state(self) -> util_task_pb2.State:
        waiting = isinstance(self._jobs[0], Wait)
        return util_task_pb2.kActionWait if waiting else util_task_pb2.kExecuting

    def _end(self, state: util_task_pb2.State, reason: str) -> None:
        action_state = {
            util_task_pb2.kCompleted: util_action_pb2.kRosSuccess,
            util_task_pb2.kCanceled: util_action_pb2.kRosCancel,
            util_task_pb2.kFailed: util_action_pb2.kRosFailure,
        }
        self._jobs[0].suspend(self._robot)
        self.impeded = False
        self._change(state, action_state[state], reason)
        self.history.append(self.proc)

    def _change(
        self,
        state: util_task_pb2.State,
        action: util_action_pb2.State = util_action_pb2.kStateUndefined,
        msg: str = "",
    ) -> None:
        if self._unannounced:
            self._announce()
        # A copy: reports that were sent must not change.
        proc = robot_pb2.TaskProc()
        proc.CopyFrom(self.proc)
        proc.state = state
        proc.msg = msg
        proc.time = int(self._robot.time)
        if action:
            waiting = state == util_task_pb2.kActionWait
            proc.action.type = self._jobs[0].kind
            proc.action.state = action
            proc.action.wait_id = int(proc.robot_task_id % 100) if waiting else 0
        self.proc = proc
        self._announce()

    def _announce(self) -> None:
        self._unannounced = False
        self._robot.emit(self.proc)
