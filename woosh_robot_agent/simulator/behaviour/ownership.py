"""Decides which job owns which device: the wheels, the lifts, the charger.

All requests that start or resume a job go through `Ownership`. It raises `RefusedError` for those
that its rules refuse, and while the robot is not ready. The rules:

- At most one job owns a device. A paused job owns nothing.
- A new task replaces everything that drives or charges. With `while_busy` in the profile, it is
  refused instead while a task runs, except if that is an automatic task of another type.
- A running task owns a device only while its current job needs the device. The task waits for an
  action that still owns the device.
- A new action replaces an action that runs or is paused on the same device. It is refused while a
  task owns the device.
- A task or action that is resumed takes its device back, unless another job owns it by then.
- An action or remote control that needs the wheels or the device of an automatic task cancels this
  task.
- Remote control and following are refused while a task or action drives, and end each other. Each
  task or action that drives ends both.
- A velocity of zero stops everything that drives: it cancels an automatic task, and pauses other
  tasks and actions.
"""

from __future__ import annotations

from collections.abc import Sequence

from woosh_robot_agent.simulator import refusals
from woosh_robot_agent.simulator.behaviour.actions import Actions, short_name
from woosh_robot_agent.simulator.behaviour.jobs import Job
from woosh_robot_agent.simulator.behaviour.manual_driving import Follower, Teleop
from woosh_robot_agent.simulator.behaviour.navigation import Navigate
from woosh_robot_agent.simulator.behaviour.tasks import TaskOrder, Tasks
from woosh_robot_agent.simulator.body.base import Velocity
from woosh_robot_agent.simulator.body.devices import Device
from woosh_robot_agent.simulator.refusals import Refusal, RefusedError
from woosh_robot_agent.simulator.robot import Robot

_STEP_CONTROL = "StepControl"
"""Short name of the action that makes steps."""


class Ownership:
    """Starts, resumes and ends jobs so that at most one job owns each device."""

    def __init__(
        self, robot: Robot, tasks: Tasks, actions: Actions, follower: Follower, teleop: Teleop
    ) -> None:
        self._robot = robot
        self._tasks = tasks
        self._actions = actions
        self._follower = follower
        self._teleop = teleop

    @property
    def driver(self) -> str:
        """Name of the task or action that owns the wheels; empty if none owns them.

        Remote control and following have no name here.
        """
        if self._tasks.owns(Device.WHEELS):
            return f"task {self._tasks.proc.robot_task_id}"
        return self._actions.owner(Device.WHEELS)

    @property
    def navigation(self) -> Navigate | None:
        """The navigation that drives or, if no job drives, a paused one; None if there is none."""
        job = self._tasks.job
        # An action may drive while a task is paused or waits for the action.
        if isinstance(job, Navigate) and not self._actions.owner(Device.WHEELS):
            return job
        return self._actions.navigation

    @property
    def busy(self) -> bool:
        """True if there is a task or an action, paused ones included, or the robot follows."""
        return self._tasks.active or self._actions.any_active or self._follower.active

    def tick(self, dt: float) -> None:
        """Let tasks and actions work for `dt` seconds."""
        job = self._tasks.job
        self._tasks.tick(dt, device_free=job is None or not self._actions.owner(job.device))
        self._actions.tick(dt)
        if self.driver:
            # A task that waited, or was between two tasks of its set, may now drive.
            self._end_manual_driving()

    def start_tasks(self, orders: Sequence[TaskOrder]) -> None:
        """Start one task or the tasks of a set, in place of everything that drives or charges.

        Args:
            orders: at least one task, in order.
        """
        self._robot.readiness.require_ready()
        if self._has_precedence(orders[0]):
            task = self._tasks.proc.robot_task_id
            raise RefusedError(refusals.TASK_RUNNING, task=task)
        self.end_driving(f"replaced by task {orders[0].id}")
        self._tasks.start(orders)

    def resume_task(self) -> None:
        """Resume a paused task, or end the wait of a waiting task."""
        self._tasks.require_active(refusals.NO_TASK_TO_RESUME)
        if self._tasks.paused:
            self._take_device_for_task()
        self._tasks.resume()

    def recover_task(self) -> None:
        """Resume a paused task, or retry a failed one from the job that failed."""
        if self._tasks.recoverable:
            self._take_device_for_task()
            self._tasks.retry()
        else:
            self.resume_task()

    def start_action(self, name: str, job: Job, *, ends: Device = Device.NONE) -> None:
        """Run `job` as the action `name`, in place of an action on the same device.

        Args:
            name: full protobuf name of the action.
            ends: another device whose action ends too, e.g. the charger that the robot leaves;
                `NONE` for no other device.
        """
        is_steps = short_name(name) == _STEP_CONTROL
        owner = self._actions.owner(Device.WHEELS)
        if is_steps and owner == _STEP_CONTROL and self._robot.profile.refusals.while_busy:
            raise RefusedError(refusals.STEPS_RUNNING, action=owner)
        devices = [each for each in (job.device, ends) if each is not Device.NONE]
        for device in devices:
            self._take_device_for_action(device, name)
        for device in devices:
            self._actions.cancel_on(device, f"replaced by {short_name(name)}")
        self._actions.start(name, job)

    def resume_action(self, name: str) -> None:
        """Resume a paused action; one that runs just goes on."""
        job = self._actions.paused_job(name)
        if job is None:
            return
        self._require_no_action(job.device)
        self._take_device_for_action(job.device, name)
        self._actions.resume(name)

    def drive(self, velocity: Velocity) -> None:
        """Drive by remote control; raise RefusedError if an action or a task of a client drives."""
        self._take_wheels("remote control", refusals.TWIST_WHILE_DRIVING)
        self._teleop.command(velocity)

    def follow(self) -> None:
        """Follow a leader; raise RefusedError if an action or a task of a client drives."""
        self._take_wheels("following", refusals.FOLLOW_WHILE_DRIVING)
        self._teleop.release()
        self._follower.active = True

    def stop_wheels(self, reason: str) -> None:
        """Stop the base: cancel an automatic task, pause what else drives, end manual driving."""
        self._tasks.cancel_automatic(reason)
        if self._tasks.owns(Device.WHEELS):
            self._tasks.pause(reason)
        self._actions.pause_on(Device.WHEELS, reason)
        self._end_manual_driving()
        self._robot.base.brake()

    def end_driving(self, reason: str) -> None:
        """End remote control, following, and every action that drives or charges."""
        self._end_manual_driving()
        self._actions.cancel_on(Device.WHEELS, reason)
        self._actions.cancel_on(Device.CHARGER, reason)

    def stop_jobs(self, reason: str) -> None:
        """End actions, following and an automatic task; pause the task of a client.

        Remote control goes on.
        """
        self._follower.active = False
        self._actions.fail_all(reason)
        self._tasks.cancel_automatic(reason)
        if self._tasks.active:
            self._tasks.pause(reason)

    def _take_wheels(self, new_driver: str, refusal: Refusal) -> None:
        """End an automatic task and following, so that remote control or following can drive.

        Raise `refusal` if an action or a task of a client drives.
        """
        self._tasks.cancel_automatic(f"replaced by {new_driver}")
        if self.driver:
            raise RefusedError(refusal, driver=self.driver)
        self._follower.active = False

    def _has_precedence(self, order: TaskOrder) -> bool:
        """Return True if the current task has precedence over a new one, which is then refused."""
        if not self._robot.profile.refusals.while_busy:
            return False
        if not self._tasks.active:
            return self._tasks.between_tasks
        # Only a task of another type replaces an automatic task.
        return not self._tasks.automatic or self._tasks.proc.type == order.type

    def _take_device_for_task(self) -> None:
        """Take the device of the task's job.

        Raise RefusedError if the robot is not ready, or an action owns the device.
        """
        self._robot.readiness.require_ready()
        device = self._tasks.device
        self._require_no_action(device)
        if device is Device.WHEELS:
            self._end_manual_driving()

    def _take_device_for_action(self, device: Device, name: str) -> None:
        """Take a device for the action `name`; raise RefusedError if a client's task owns it."""
        if device is Device.WHEELS or self._tasks.owns(device):
            self._tasks.cancel_automatic(f"replaced by {short_name(name)}")
        if self._tasks.owns(device):
            task = self._tasks.proc.robot_task_id
            is_steps = short_name(name) == _STEP_CONTROL
            refusal = refusals.STEPS_DURING_TASK if is_steps else refusals.ACTION_DURING_TASK
            raise RefusedError(refusal, task=task)
        if device is Device.WHEELS:
            self._end_manual_driving()

    def _require_no_action(self, device: Device) -> None:
        owner = self._actions.owner(device)
        if owner:
            raise RefusedError(refusals.ACTION_RUNNING, action=owner)

    def _end_manual_driving(self) -> None:
        self._follower.active = False
        self._teleop.release()
