"""The actions of `woosh.ros.CallAction`: single jobs that report by Feedbacks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from woosh_robot_agent.pb.ros import ros_pack_pb2
from woosh_robot_agent.simulator.behaviour.jobs import Device, Job
from woosh_robot_agent.simulator.behaviour.navigation import Navigate
from woosh_robot_agent.simulator.errors import Refused

if TYPE_CHECKING:
    from woosh_robot_agent.simulator.chassis import Chassis

#: Seconds between two reports of how far an action is.
REPORT_PERIOD_S = 1.0


@dataclass
class _Run:
    name: str
    job: Job
    paused: bool = False
    started: bool = False
    impeded: bool = False
    reported: float = 0.0


class Actions:
    """The running actions by name, and the last feedback of each one that ever ran."""

    def __init__(self, chassis: Chassis) -> None:
        self.last: dict[str, ros_pack_pb2.Feedback] = {}
        self._chassis = chassis
        self._runs: dict[str, _Run] = {}

    @property
    def impeded(self) -> bool:
        """Whether an obstacle holds an action up just now."""
        return any(run.impeded for run in self._runs.values())

    @property
    def navigation(self) -> Navigate | None:
        """The navigation that an action runs, also while it is paused."""
        jobs = (run.job for run in self._runs.values())
        return next((job for job in jobs if isinstance(job, Navigate)), None)

    @property
    def running(self) -> bool:
        """Whether there is any action, paused ones included."""
        return bool(self._runs)

    def user(self, device: Device) -> str:
        """The short name of the action that occupies `device`, empty if none does."""
        for run in self._runs.values():
            if run.job.device is device and not run.paused:
                return _short(run.name)
        return ""

    def start(self, name: str, job: Job) -> None:
        """Run `job` as the action `name`; what ran on the same device is cancelled.

        Raises:
            Refused: A task occupies the device.
        """
        self._require_no_task(job.device, name)
        self.clear(job.device, f"replaced by {_short(name)}")
        self._runs[name] = _Run(name, job)

    def cancel(self, name: str) -> None:
        """End an action.

        Raises:
            Refused: It does not run.
        """
        self._end(self._running(name), ros_pack_pb2.kRosCancel, "cancelled")

    def pause(self, name: str) -> None:
        """Stop an action for a while.

        Raises:
            Refused: It does not run.
        """
        self._pause(self._running(name), "paused")

    def pause_on(self, device: Device, reason: str) -> None:
        """Stop what runs on `device` for a while."""
        for run in self._runs.values():
            if run.job.device is device:
                self._pause(run, reason)

    def resume(self, name: str) -> None:
        """Go on with a paused action.

        Raises:
            Refused: It does not run, or something else uses its device now.
        """
        run = self._running(name)
        if not run.paused:
            return
        user = self.user(run.job.device)
        if user:
            raise Refused(f"{user} is running: wait for it or cancel it first")
        self._require_no_task(run.job.device, name)
        run.paused = False
        run.job.hold(self._chassis)
        self._report(run, ros_pack_pb2.kRosExecuting, "resumed")

    def clear(self, device: Device, reason: str) -> None:
        """Cancel what runs or is paused on `device`."""
        for run in [run for run in self._runs.values() if run.job.device is device]:
            self._end(run, ros_pack_pb2.kRosCancel, reason)

    def abort(self, reason: str) -> None:
        """End every action as one that could not be carried out."""
        for run in list(self._runs.values()):
            self._end(run, ros_pack_pb2.kRosExecuteFailed, reason)

    def tick(self, dt: float) -> None:
        """Work on every action for `dt` seconds."""
        for run in list(self._runs.values()):
            if run.paused:
                continue
            if not run.started:
                # After the answer to the request that started it.
                run.started = True
                self._report(run, ros_pack_pb2.kRosExecuting, "started")
                continue
            progress = run.job.tick(self._chassis, dt)
            if progress.failure:
                self._end(run, ros_pack_pb2.kRosFailure, progress.failure)
            elif progress.done:
                self._end(run, ros_pack_pb2.kRosSuccess, progress.text)
            elif progress.impeded and not run.impeded:
                run.impeded = True
                self._report(run, ros_pack_pb2.kRosErrMsg, progress.text)
            elif self._chassis.elapsed - run.reported >= REPORT_PERIOD_S - 1e-9:
                self._report(run, ros_pack_pb2.kRosExecuting, progress.text)
            run.impeded = progress.impeded

    def _require_no_task(self, device: Device, name: str) -> None:
        tasks = self._chassis.tasks
        if device is Device.WHEELS or tasks.uses(device):
            tasks.give_way(f"replaced by {_short(name)}")
        if tasks.uses(device):
            task = tasks.proc.robot_task_id
            raise Refused(f"task {task} is running: pause or cancel it first")

    def _running(self, name: str) -> _Run:
        run = self._runs.get(name)
        if run is None:
            raise Refused(f"{_short(name)} is not running: execute it first")
        return run

    def _pause(self, run: _Run, reason: str) -> None:
        if not run.paused:
            run.paused = True
            run.impeded = False
            run.job.hold(self._chassis)
            self._report(run, ros_pack_pb2.kRosPause, reason)

    def _end(self, run: _Run, state: ros_pack_pb2.State, msg: str) -> None:
        del self._runs[run.name]
        run.job.hold(self._chassis)
        self._report(run, state, msg)

    def _report(self, run: _Run, state: ros_pack_pb2.State, msg: str) -> None:
        run.reported = self._chassis.elapsed
        feedback = ros_pack_pb2.Feedback(action=run.name, state=state, msg=msg)
        self.last[run.name] = feedback
        self._chassis.emit(ros_pack_pb2.Feedbacks(fbs=[feedback]))


def _short(name: str) -> str:
    return name.rpartition(".")[2]
