"""Tasks: their life cycle, and the TaskProc reports that clients receive about tasks."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from woosh_robot_agent.pb.robot import robot_pb2
from woosh_robot_agent.pb.util import action_pb2 as util_action_pb2
from woosh_robot_agent.pb.util import robot_pb2 as util_robot_pb2
from woosh_robot_agent.pb.util import task_pb2 as util_task_pb2
from woosh_robot_agent.simulator import refusals
from woosh_robot_agent.simulator.behaviour.jobs import Job, Wait
from woosh_robot_agent.simulator.body.devices import Device
from woosh_robot_agent.simulator.refusals import Refusal, RefusedError
from woosh_robot_agent.simulator.robot import Robot
from woosh_robot_agent.simulator.status_codes import failure_code
from woosh_robot_agent.simulator.timeline import DelayedCalls, copy_of

_MAX_HISTORY = 50
"""Number of ended tasks whose last reports are kept."""

_STARTING_STATES = {"kInit": util_task_pb2.kInit, "kReady": util_task_pb2.kReady}
"""States of a task before it is executed, by the name in the profile."""

_END_ACTION_STATES = {
    util_task_pb2.kCompleted: util_action_pb2.kRosSuccess,
    util_task_pb2.kCanceled: util_action_pb2.kRosCancel,
    util_task_pb2.kFailed: util_action_pb2.kRosFailure,
}
"""State of the last action in the reports of an ended task, by the state of the task."""

_NO_STATE = util_robot_pb2.kStateUndefined
"""State of the robot without a task."""

_PUSH_GAP = 0.003
"""Time between a push and another push that it causes, in seconds."""


@dataclass
class TaskOrder:
    """An order to perform a task.

    Attributes:
        id: the `robot_task_id` in reports.
        dest: number of the target mark, empty if the target is not a mark.
        jobs: returns the jobs of the task, in order. Called when the task starts, because jobs may
            depend on where the robot then stands.
        automatic: True if the robot starts the task by itself.
        own_id: True if the robot has chosen the id.
    """

    id: int
    type: util_task_pb2.Type
    dest: str
    jobs: Callable[[], list[Job]]
    automatic: bool = False
    own_id: bool = False


class Tasks:
    """The current task, the rest of its set, and the ended tasks.

    `Ownership` decides when a task may start or resume. The profile decides when the reports show
    what has happened. Orders raise `RefusedError` if there is no task for them.

    Attributes:
        proc: the current or last task, empty before the first. Its state may be ahead of the
            reports.
        reported: the last report, which queries are answered with; at first the report that there
            is no task.
        state: state that the task gives the robot, `kStateUndefined` without a task.
        history: the last reports of the last 50 ended tasks, oldest first.
        impeded: True if an obstacle blocks the task now.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self.proc = robot_pb2.TaskProc()
        self.reported = self._empty_report()
        self.state: util_robot_pb2.State = _NO_STATE
        self.history: deque[robot_pb2.TaskProc] = deque(maxlen=_MAX_HISTORY)
        self.impeded = False
        self._profile = robot.profile.tasks
        self._scheduled = DelayedCalls(robot)
        """Scheduled calls of the task: reports, the start of the next job, effects of orders."""
        self._jobs: deque[Job] = deque()
        """Remaining jobs of the task, the current one first.

        An ended task keeps them until `forget_failed`: it can be retried if it failed.
        """
        self._waits_done = 0
        """Number of the waits that the task has already done."""
        self._automatic = False
        """True if the robot has started the task by itself."""
        self._starting: deque[Callable[[], None]] = deque()
        """Calls that report the start of the task and begin its first job; one call per tick."""
        self._working = False
        """True while the current job runs: not before its start, nor after it ended or stopped."""
        self._canceling = False
        """True from the order to cancel the task until its end."""
        self._rest_of_set: deque[TaskOrder] = deque()
        """Tasks of the set that follow the current task."""
        self._last_id = 0
        """Last id that the robot has chosen."""

    @property
    def active(self) -> bool:
        """True if there is a task that has not ended: it runs, waits or is paused."""
        state = self.proc.state
        return state != util_task_pb2.kStateUndefined and state not in _END_ACTION_STATES

    @property
    def paused(self) -> bool:
        """True if the task is paused."""
        return self.proc.state == util_task_pb2.kPaused

    @property
    def between_tasks(self) -> bool:
        """True if a task of a set has ended, and the next one has not started yet."""
        has_ended = self.proc.state in (util_task_pb2.kCompleted, util_task_pb2.kCanceled)
        return has_ended and bool(self._rest_of_set)

    @property
    def recoverable(self) -> bool:
        """True if the last task failed and can be retried."""
        return self.proc.state == util_task_pb2.kFailed and bool(self._jobs)

    @property
    def automatic(self) -> bool:
        """True if the current task is automatic: the robot started it by itself."""
        return self.active and self._automatic

    @property
    def job(self) -> Job | None:
        """Current job of the task, also while the task is paused; None without a task."""
        return self._jobs[0] if self.active else None

    @property
    def device(self) -> Device:
        """Device of the current job, or of the job that failed. There must be such a job."""
        return self._jobs[0].device

    def owns(self, device: Device) -> bool:
        """Return True if the task owns `device`. A paused task owns nothing."""
        job = self.job
        return job is not None and not self.paused and job.device is device

    def new_id(self) -> int:
        """Return a new id, from the simulated time, for a task that came without one."""
        profile = self._profile
        wanted = int(self._robot.time) * profile.own_id_factor + profile.own_id_offset
        self._last_id = max(wanted, self._last_id + 1)
        return self._last_id

    def start(self, orders: Sequence[TaskOrder]) -> None:
        """Cancel the current task, and start one task or the tasks of a set, in order."""
        self._rest_of_set.clear()
        if self.active:
            self._end(util_task_pb2.kCanceled, f"replaced by task {orders[0].id}")
        self._rest_of_set = deque(orders)
        self._start_next(at_once=orders[0].automatic)

    def pause(
        self,
        reason: str,
        state: util_action_pb2.State = util_action_pb2.kSuspend,
        *,
        ordered: bool = False,
    ) -> None:
        """Pause the task, unless it is paused or being cancelled.

        Args:
            reason: text of the report.
            state: state of the action in the report.
            ordered: True if a client has ordered the pause, which is then reported later.
        """
        self.require_active(refusals.NO_TASK_TO_PAUSE)
        if self.paused or self._canceling:
            return
        self._stop_working()
        self.proc.state = util_task_pb2.kPaused
        report = partial(self._report, util_task_pb2.kPaused, state, reason)
        self._scheduled.add(self._order_delay() if ordered else 0.0, report)

    def resume(self) -> None:
        """Resume a paused task, or end the wait of a waiting task; else do nothing."""
        if self.paused:
            self.retry()
        elif isinstance(self.job, Wait):
            self._scheduled.add(self._order_delay(), self.job.end)

    def retry(self) -> None:
        """Start the current or failed job again, unless the task is being cancelled."""
        if self._canceling:
            return
        self._stop_working()
        self.proc.state = self._running_state()
        self._scheduled.add(self._order_delay(), self._begin_job)

    def end_wait(self) -> None:
        """End the current wait of the task; raise RefusedError if the task is not waiting."""
        if self.paused or not isinstance(self.job, Wait):
            raise RefusedError(refusals.NOT_WAITING)
        self._scheduled.add(self._order_delay(), self.job.end)

    def cancel(self, reason: str, *, ordered: bool = False) -> None:
        """Cancel the task and the rest of its set. Between two tasks of a set, cancel the rest.

        With `next_after_cancel` in the profile, an ordered cancel ends only the task, unless it is
        paused; between two tasks, it is refused.

        Args:
            reason: text of the report.
            ordered: True if a client has ordered the cancel, which then takes effect later.
        """
        ends_set = self.paused or not (ordered and self._profile.next_after_cancel)
        if self.between_tasks and ends_set:
            self._rest_of_set.clear()
            return
        self.require_active()
        if ends_set:
            self._rest_of_set.clear()
        if ordered and self._canceling:
            return
        self._stop_working()
        self._canceling = True
        end = partial(self._end, util_task_pb2.kCanceled, reason)
        self._scheduled.add(self._order_delay() if ordered else 0.0, end)

    def cancel_automatic(self, reason: str) -> None:
        """Cancel the task if it is automatic."""
        if self.automatic:
            self.cancel(reason)

    def fail(self, reason: str) -> None:
        """Let the task fail. The rest of its set is kept: the task may be recovered."""
        kind = self._jobs[0].kind
        self._robot.codes.report(failure_code(kind), kind, reason)
        self._end(util_task_pb2.kFailed, reason)

    def forget_failed(self) -> None:
        """Forget the jobs of an ended task and the rest of its set, so that it cannot be retried.

        A task in progress goes on.
        """
        if not self.active:
            self._jobs.clear()
            self._rest_of_set.clear()

    def require_active(self, refusal: Refusal = refusals.NO_TASK) -> None:
        """Raise `refusal` if there is no task that has not ended."""
        if not self.active:
            raise RefusedError(refusal)

    def tick(self, dt: float, *, device_free: bool) -> None:
        """Work on the task for `dt` seconds.

        Args:
            device_free: False if an action owns the device of the current job, which then waits.
        """
        if self._starting:
            self._starting.popleft()()
        elif self._working and device_free:
            self._work(dt)

    def _start_next(self, *, at_once: bool) -> None:
        """Start the next task of the set, if there is one.

        Args:
            at_once: False if a request has started the task: the reports then follow its answer,
                which only the new state of the robot may precede (`Robot.state_first`). True if no
                request waits for an answer.
        """
        if not self._rest_of_set:
            return
        order = self._rest_of_set.popleft()
        self._scheduled.cancel_all()
        self._automatic = order.automatic
        self._jobs = deque(order.jobs())
        self._waits_done = 0
        self.proc = robot_pb2.TaskProc(
            robot_id=self._robot.robot_id,
            robot_task_id=order.id,
            type=order.type,
            state=util_task_pb2.kInit,
            dest=order.dest,
        )
        # Real robots push an empty report first if they have chosen the id.
        if order.own_id and self._profile.empty_report:
            self._push(self._empty_report())
        delay = 0.0 if at_once else self._robot.answer_delay
        self._show_state(0.0 if self._robot.state_first else delay)
        self._schedule_start(delay)

    def _schedule_start(self, delay: float) -> None:
        """Schedule the first reports of the task and the start of its first job.

        Args:
            delay: time until the answer to the request that starts the task, in seconds.
        """
        states = [_STARTING_STATES[name] for name in self._profile.starting_states]
        starting: deque[Callable[[], None]] = deque(partial(self._report, each) for each in states)
        starting.append(self._begin_job)
        delays_after_answer = self._profile.first_report
        if not delays_after_answer:
            # The pushes begin with the next tick, so that they follow the answer to the request.
            # Queries are answered with the new task at once.
            self._starting = starting
            self.reported = self._new_report(states[0] if states else util_task_pb2.kInit)
            return

        def announce() -> None:
            self._starting = starting
            starting.popleft()()  # the others follow in the next ticks

        self._scheduled.add(delay + self._robot.rng.choice(delays_after_answer), announce)

    def _show_state(self, delay: float) -> None:
        """Set `state` to the one that the task gives the robot, in `delay` seconds, or now if 0.

        If the task has ended by then, `state` stays.
        """
        task = self.proc.robot_task_id

        def show() -> None:
            if self.active and self.proc.robot_task_id == task:
                self.state = self._robot_state()

        if delay:
            delay += _PUSH_GAP  # the state is pushed after the answer
        self._robot.after(delay, show)

    def _robot_state(self) -> util_robot_pb2.State:
        """Return the state that the task gives the robot."""
        own_charge = self._automatic and self.proc.type == util_task_pb2.kCharge
        parking = self.proc.type == util_task_pb2.kParking or (
            own_charge and self._profile.charge_as_parking
        )
        return util_robot_pb2.kParking if parking else util_robot_pb2.kTask

    def _begin_job(self) -> None:
        """Start or resume the current job, and report it."""
        self.state = self._robot_state()
        self._working = True
        self.proc.state = self._running_state()
        self._report(self.proc.state, util_action_pb2.kRosExecuting)
        if isinstance(self._jobs[0], Wait):
            self._work(0.0)  # a wait of 0 s ends at once

    def _running_state(self) -> util_task_pb2.State:
        """Return the state of the task while its current job runs."""
        waiting = isinstance(self._jobs[0], Wait)
        return util_task_pb2.kActionWait if waiting else util_task_pb2.kExecuting

    def _work(self, dt: float) -> None:
        """Work on the current job for `dt` seconds, and report what changes."""
        progress = self._jobs[0].tick(self._robot, dt)
        if progress.failure:
            self.fail(progress.failure)
        elif progress.done:
            self._finish_job(progress.text)
        elif progress.impeded != self.impeded:
            self.impeded = progress.impeded
            if self.impeded:
                pauses = self._profile.pause_at_obstacle
                shown = util_task_pb2.kPaused if pauses else self.proc.state
                self._report(shown, util_action_pb2.kRosWarning, progress.text)
            else:
                self._report(self.proc.state, util_action_pb2.kRosExecuting)

    def _finish_job(self, text: str) -> None:
        """Report the end of the current job, and schedule the next job or the end of the task.

        Args:
            text: text of the report that the task is completed.
        """
        self.impeded = False
        self._working = False
        last = len(self._jobs) == 1
        if not last or self._profile.report_last_action:
            self._report(self.proc.state, util_action_pb2.kRosSuccess)
        if not last:
            done = self._jobs.popleft()
            if isinstance(done, Wait):
                self._waits_done += 1
            self._scheduled.add(self._profile.between_jobs, self._begin_job)
            return
        charging = self._jobs[0].kind == util_action_pb2.kCharge
        delay = self._robot.profile.charging.completed_after if charging else 0.0
        self._scheduled.add(delay, partial(self._end, util_task_pb2.kCompleted, text))

    def _stop_working(self) -> None:
        """Stop the current job, and cancel all scheduled calls of the task."""
        self._scheduled.cancel_all()
        self._starting.clear()
        self._working = False
        self.impeded = False
        self._jobs[0].suspend(self._robot)

    def _end(self, state: util_task_pb2.State, reason: str) -> None:
        """End the task and report it; unless it has failed, go on with the next of its set.

        Args:
            state: one of the states in `_END_ACTION_STATES`.
            reason: text of the report.
        """
        action_state = _END_ACTION_STATES[state]
        self._stop_working()
        self._canceling = False
        if state == util_task_pb2.kCanceled and self._profile.report_last_action:
            # The state before the end; a task without any report counts as executing.
            was_reported = self.reported.robot_task_id == self.proc.robot_task_id
            shown = self.reported.state if was_reported else util_task_pb2.kExecuting
            self._report(shown, action_state)
        self._report(state, action_state, reason)
        self.proc.state = state
        self.history.append(self.reported)
        empty_report = self._profile.empty_report
        if empty_report is None:  # the last report stays
            self.state = _NO_STATE
            if state != util_task_pb2.kFailed:
                self._start_next(at_once=True)
        elif state == util_task_pb2.kFailed or (
            self._robot.battery.charges and not self._rest_of_set
        ):
            # The last report stays: the task can be recovered, or the robot is still charging.
            self._scheduled.add(_PUSH_GAP, self._clear_state)
        else:
            self._scheduled.add(empty_report.sample(self._robot.rng), self._leave_task)

    def _clear_state(self) -> None:
        """Set `state` to that of a robot without a task."""
        self.state = _NO_STATE

    def _leave_task(self) -> None:
        """Report that the robot has no task; soon afterwards, start the next of the set, if any."""
        self._push(self._empty_report())
        self._clear_state()
        self._scheduled.add(_PUSH_GAP, partial(self._start_next, at_once=True))

    def _order_delay(self) -> float:
        """Return the time from an order to the report that shows its effect, in seconds."""
        return self._profile.order_effect.sample(self._robot.rng)

    def _report(
        self,
        state: util_task_pb2.State,
        action_state: util_action_pb2.State | None = None,
        msg: str = "",
    ) -> None:
        """Push a report about the task.

        Args:
            state: state of the task in the report.
            action_state: state of the current job in the report; None to leave out the job.
            msg: text of the report, if the profile has texts.
        """
        report = self._new_report(state)
        if self._profile.messages:
            report.msg = msg
        if action_state is not None:
            job = self._jobs[0]
            # a wait without a number is counted by its position
            wait_id = (job.number or self._waits_done + 1) if isinstance(job, Wait) else 0
            report.action.CopyFrom(
                robot_pb2.TaskProc.Action(type=job.kind, state=action_state, wait_id=wait_id)
            )
        self._push(report)

    def _push(self, report: robot_pb2.TaskProc) -> None:
        self.reported = report
        self._robot.emit(report)

    def _new_report(self, state: util_task_pb2.State) -> robot_pb2.TaskProc:
        """Return a new report about the task, without its current job."""
        report = copy_of(self.proc)
        report.state = state
        report.time = int(self._robot.time)
        return report

    def _empty_report(self) -> robot_pb2.TaskProc:
        """Return a new report that there is no task."""
        report = robot_pb2.TaskProc(robot_id=self._robot.robot_id, time=int(self._robot.time))
        report.action.SetInParent()  # an empty action, as real robots report it
        return report
