"""Tasks: one runs at a time, and every step of its life is reported."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from woosh_robot_agent.pb.robot import robot_count_pb2, robot_pb2
from woosh_robot_agent.pb.util import action_pb2 as util_action_pb2
from woosh_robot_agent.pb.util import task_pb2 as util_task_pb2
from woosh_robot_agent.simulator.behaviour.jobs import Device, Job, Wait
from woosh_robot_agent.simulator.body.codes import TASK_FAILED
from woosh_robot_agent.simulator.errors import Refused

if TYPE_CHECKING:
    from woosh_robot_agent.simulator.chassis import Chassis

KEPT = 50

_ENDED = (util_task_pb2.kCompleted, util_task_pb2.kCanceled, util_task_pb2.kFailed)
_STARTING = (util_task_pb2.kInit, util_task_pb2.kReady)


@dataclass
class TaskOrder:
    """A task as it was asked for.

    Attributes:
        id: The `robot_task_id` of its reports.
        type: Its type.
        dest: The number of the mark it goes to, empty if it goes elsewhere.
        jobs: What to do, in this order.
        errand: The chassis gave the task to itself.
    """

    id: int
    type: util_task_pb2.Type
    dest: str
    jobs: list[Job]
    errand: bool = False


class Tasks:
    """The current task, those of its set that follow, and the finished ones.

    Attributes:
        proc: The state of the current or the last task.
        history: The last 50 finished tasks, oldest first.
        impeded: An obstacle holds the task up just now.
    """

    def __init__(self, chassis: Chassis) -> None:
        self.proc = robot_pb2.TaskProc()
        self.history: deque[robot_pb2.TaskProc] = deque(maxlen=KEPT)
        self._chassis = chassis
        self._jobs: deque[Job] = deque()
        self._following: deque[TaskOrder] = deque()
        self.impeded = False
        self._errand = False
        self._unannounced = False

    @property
    def active(self) -> bool:
        """Whether a task runs, waits or is paused."""
        return self.proc.state != util_task_pb2.kStateUndefined and self.proc.state not in _ENDED

    @property
    def paused(self) -> bool:
        """Whether the task is paused."""
        return self.proc.state == util_task_pb2.kPaused

    @property
    def errand(self) -> bool:
        """Whether there is a task that the chassis gave to itself."""
        return self.active and self._errand

    @property
    def job(self) -> Job | None:
        """What the task is at, also while it is paused."""
        return self._jobs[0] if self.active else None

    def uses(self, device: Device) -> bool:
        """Whether the task occupies `device` now; a paused one occupies nothing."""
        job = self.job
        return job is not None and not self.paused and job.device is device

    def start(self, orders: Sequence[TaskOrder]) -> None:
        """Take one task, or those of a set; what ran before is cancelled."""
        if self.active:
            self._end(util_task_pb2.kCanceled, f"replaced by task {orders[0].id}")
        self._following = deque(orders)
        self._next()

    def pause(self, reason: str, state: util_action_pb2.State = util_action_pb2.kSuspend) -> None:
        """Stop for a while.

        Raises:
            Refused: There is no task.
        """
        self._require_task()
        if self.paused:
            return
        self._jobs[0].hold(self._chassis)
        self.impeded = False
        self._change(util_task_pb2.kPaused, state, reason)

    def resume(self) -> None:
        """Go on with a paused task, or break off the wait of a waiting one.

        Raises:
            Refused: There is no task, or it may not move now.
        """
        self._require_task()
        if self.paused:
            self._require_free()
            self._jobs[0].hold(self._chassis)
            self._change(self._running_state(), util_action_pb2.kRosExecuting)
        elif isinstance(self.job, Wait):
            self.job.break_off()

    def break_wait(self) -> None:
        """End the wait that the task is at.

        Raises:
            Refused: It is not waiting.
        """
        if self.paused or not isinstance(self.job, Wait):
            raise Refused("no task is waiting: there is no wait to break off")
        self.job.break_off()

    def cancel(self, reason: str) -> None:
        """End the task, and those of its set that follow.

        Raises:
            Refused: There is no task.
        """
        self._require_task()
        self._end(util_task_pb2.kCanceled, reason)
        self._following.clear()

    def give_way(self, reason: str) -> None:
        """End the task if it is one that the chassis gave to itself."""
        if self.errand:
            self.cancel(reason)

    def recover(self) -> None:
        """Go on with a paused task, or try a failed one again from where it failed.

        Raises:
            Refused: There is nothing to recover, or it may not move now.
        """
        if self.proc.state != util_task_pb2.kFailed or not self._jobs:
            self.resume()
            return
        self._require_free()
        self._jobs[0].hold(self._chassis)
        self._change(self._running_state(), util_action_pb2.kRosExecuting)

    def forget_failed(self) -> None:
        """Make sure that a failed task, and those of its set that follow, are not recovered."""
        if not self.active:
            self._jobs.clear()
            self._following.clear()

    def tick(self, dt: float) -> None:
        """Work on the task for `dt` seconds."""
        if self._unannounced:
            self._announce()
        elif self.proc.state in _STARTING:
            if self.proc.state == util_task_pb2.kInit:
                self._change(util_task_pb2.kReady)
            else:
                self._change(self._running_state(), util_action_pb2.kRosExecuting)
        elif self.active and not self.paused:
            self._work(dt)

    def _work(self, dt: float) -> None:
        if self._chassis.actions.user(self._jobs[0].device):
            return  # until that action is over
        progress = self._jobs[0].tick(self._chassis, dt)
        if progress.failure:
            self._chassis.codes.report(
                TASK_FAILED,
                robot_count_pb2.StatusCode.kFault,
                self._jobs[0].kind,
                progress.failure,
            )
            # The rest of its set waits for it to be recovered.
            self._end(util_task_pb2.kFailed, progress.failure)
        elif progress.done and len(self._jobs) > 1:
            self.impeded = False
            self._change(self.proc.state, util_action_pb2.kRosSuccess)
            self._jobs.popleft()
            self._change(self._running_state(), util_action_pb2.kRosExecuting)
        elif progress.done:
            self._end(util_task_pb2.kCompleted, progress.text)
            self._next()
        elif progress.impeded != self.impeded:
            self.impeded = progress.impeded
            if self.impeded:
                self._change(self.proc.state, util_action_pb2.kRosWarning, progress.text)
            else:
                self._change(self.proc.state, util_action_pb2.kRosExecuting)

    def _next(self) -> None:
        if not self._following:
            return
        order = self._following.popleft()
        self._errand = order.errand
        self._jobs = deque(order.jobs)
        self.proc = robot_pb2.TaskProc(
            robot_id=self._chassis.robot_id,
            robot_task_id=order.id,
            type=order.type,
            state=util_task_pb2.kInit,
            dest=order.dest,
            time=int(self._chassis.time),
        )
        # Said in the next tick, after the answer to the request that brought the task.
        self._unannounced = True

    def _running_state(self) -> util_task_pb2.State:
        waiting = isinstance(self._jobs[0], Wait)
        return util_task_pb2.kActionWait if waiting else util_task_pb2.kExecuting

    def _end(self, state: util_task_pb2.State, reason: str) -> None:
        ending = {
            util_task_pb2.kCompleted: util_action_pb2.kRosSuccess,
            util_task_pb2.kCanceled: util_action_pb2.kRosCancel,
            util_task_pb2.kFailed: util_action_pb2.kRosFailure,
        }
        self._jobs[0].hold(self._chassis)
        self.impeded = False
        self._change(state, ending[state], reason)
        self.history.append(self.proc)

    def _change(
        self,
        state: util_task_pb2.State,
        action: util_action_pb2.State = util_action_pb2.kStateUndefined,
        msg: str = "",
    ) -> None:
        if self._unannounced:
            self._announce()
        proc = robot_pb2.TaskProc()
        proc.CopyFrom(self.proc)
        proc.state = state
        proc.msg = msg
        proc.time = int(self._chassis.time)
        if action:
            waiting = state == util_task_pb2.kActionWait
            proc.action.type = self._jobs[0].kind
            proc.action.state = action
            proc.action.wait_id = int(proc.robot_task_id % 100) if waiting else 0
        self.proc = proc
        self._announce()

    def _announce(self) -> None:
        self._unannounced = False
        self._chassis.emit(self.proc)

    def _require_task(self) -> None:
        if not self.active:
            raise Refused("no task is running: start one by ExecTask first")

    def _require_free(self) -> None:
        self._chassis.require_ready()
        device = self._jobs[0].device
        user = self._chassis.actions.user(device)
        if user:
            raise Refused(f"{user} is running: wait for it or cancel it first")
