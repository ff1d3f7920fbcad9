"""The actions of `woosh.ros.CallAction`: each is one job, which is reported by Feedbacks."""

from __future__ import annotations

from dataclasses import dataclass

from woosh_robot_agent.pb.ros import ros_pack_pb2
from woosh_robot_agent.simulator.behaviour.jobs import Job
from woosh_robot_agent.simulator.behaviour.navigation import Navigate
from woosh_robot_agent.simulator.body.devices import Device
from woosh_robot_agent.simulator.refusals import RefusedError
from woosh_robot_agent.simulator.robot import Robot
from woosh_robot_agent.simulator.timeline import ROUNDING

REPORT_PERIOD = 1.0
"""Time between two progress reports of an action, in seconds."""


@dataclass
class _Run:
    """An action that is executed or paused.

    Attributes:
        started: True if the start of the action has been reported.
        impeded: True if an obstacle blocks the action now. A paused action is not impeded.
        reported_at: simulated time of the last report, in seconds; 0 before the first.
    """

    name: str
    job: Job
    paused: bool = False
    started: bool = False
    impeded: bool = False
    reported_at: float = 0.0


class Actions:
    """The current actions, each executed or paused. `Ownership` decides which of them may run.

    An action is known by its full protobuf name, e.g. `woosh.ros.action.MoveBase`.

    Attributes:
        last: the last feedback about each action, ended ones included, by name.
    """

    def __init__(self, robot: Robot) -> None:
        self.last: dict[str, ros_pack_pb2.Feedback] = {}
        self._robot = robot
        self._runs: dict[str, _Run] = {}
        """Current actions, by name."""

    @property
    def impeded(self) -> bool:
        """True if an obstacle blocks an action now."""
        return any(run.impeded for run in self._runs.values())

    @property
    def navigation(self) -> Navigate | None:
        """The navigation that an action executes or has paused; None if there is none."""
        jobs = (run.job for run in self._runs.values())
        return next((job for job in jobs if isinstance(job, Navigate)), None)

    @property
    def any_active(self) -> bool:
        """True if an action is executed or paused."""
        return bool(self._runs)

    def owner(self, device: Device) -> str:
        """Return the short name of the action that runs on `device`; empty if there is none."""
        if device is Device.NONE:  # several actions without a device can run together
            return ""
        for run in self._runs.values():
            if run.job.device is device and not run.paused:
                return short_name(run.name)
        return ""

    def paused_job(self, name: str) -> Job | None:
        """Return the job of an action if it is paused, None if it runs; else raise RefusedError."""
        run = self._find(name)
        return run.job if run.paused else None

    def start(self, name: str, job: Job) -> None:
        """Run `job` as the action `name`, which is cancelled first if it runs or is paused."""
        if name in self._runs:
            replaced = f"replaced by {short_name(name)}"
            self._end(self._runs[name], ros_pack_pb2.kRosCancel, replaced)
        self._runs[name] = _Run(name, job)

    def cancel(self, name: str) -> None:
        """Cancel an action; raise RefusedError if it neither runs nor is paused."""
        self._end(self._find(name), ros_pack_pb2.kRosCancel, "cancelled")

    def pause(self, name: str) -> None:
        """Pause an action; raise RefusedError if it neither runs nor is paused."""
        self._pause(self._find(name), "paused")

    def pause_on(self, device: Device, reason: str) -> None:
        """Pause the action that runs on `device`, if there is one."""
        for run in self._runs.values():
            if run.job.device is device:
                self._pause(run, reason)

    def resume(self, name: str) -> None:
        """Resume a paused action; raise RefusedError if there is no such action."""
        run = self._find(name)
        run.paused = False
        run.job.suspend(self._robot)  # drop a path planned during the pause: it may be outdated
        self._report(run, ros_pack_pb2.kRosExecuting, "resumed")

    def cancel_on(self, device: Device, reason: str) -> None:
        """Cancel the actions that run or are paused on `device`."""
        for run in [run for run in self._runs.values() if run.job.device is device]:
            self._end(run, ros_pack_pb2.kRosCancel, reason)

    def fail_all(self, reason: str) -> None:
        """End every action with a failure."""
        for run in list(self._runs.values()):
            self._end(run, ros_pack_pb2.kRosExecuteFailed, reason)

    def tick(self, dt: float) -> None:
        """Work on the actions that are not paused for `dt` seconds, and report their progress."""
        for run in list(self._runs.values()):
            if run.paused:
                continue
            if not run.started:
                # Reported only now, so that the report follows the answer to the request.
                run.started = True
                self._report(run, ros_pack_pb2.kRosExecuting, "started")
                continue
            progress = run.job.tick(self._robot, dt)
            if progress.failure:
                self._end(run, ros_pack_pb2.kRosFailure, progress.failure, progress.code)
            elif progress.done:
                self._end(run, ros_pack_pb2.kRosSuccess, progress.text)
            elif progress.impeded and not run.impeded:
                self._report(run, ros_pack_pb2.kRosErrMsg, progress.text)
            elif self._robot.elapsed - run.reported_at >= REPORT_PERIOD - ROUNDING:
                self._report(run, ros_pack_pb2.kRosExecuting, progress.text)
            run.impeded = progress.impeded

    def _find(self, name: str) -> _Run:
        """Return the current action called `name`; raise RefusedError if there is none."""
        run = self._runs.get(name)
        if run is None:
            raise RefusedError(f"{short_name(name)} is not running: execute it first")
        return run

    def _pause(self, run: _Run, reason: str) -> None:
        """Pause an action and report it, unless it is paused already."""
        if not run.paused:
            run.paused = True
            run.impeded = False
            run.job.suspend(self._robot)
            self._report(run, ros_pack_pb2.kRosPause, reason)

    def _end(self, run: _Run, state: ros_pack_pb2.State, msg: str, code: int = 0) -> None:
        del self._runs[run.name]
        run.job.suspend(self._robot)
        self._report(run, state, msg, code)

    def _report(self, run: _Run, state: ros_pack_pb2.State, msg: str, code: int = 0) -> None:
        """Emit a feedback about an action, and keep it as the last one."""
        run.reported_at = self._robot.elapsed
        feedback = ros_pack_pb2.Feedback(action=run.name, state=state, code=code, msg=msg)
        self.last[run.name] = feedback
        self._robot.emit(ros_pack_pb2.Feedbacks(fbs=[feedback]))


def short_name(name: str) -> str:
    """Return the last part of an action's name."""
    return name.rpartition(".")[2]
