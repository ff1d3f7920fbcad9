"""Jobs: the units of work of which actions and tasks consist."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

from woosh_robot_agent.pb.util import action_pb2 as util_action_pb2
from woosh_robot_agent.simulator.behaviour.robot import Robot
from woosh_robot_agent.simulator.body.devices import Device


@dataclass(frozen=True, slots=True)
class Progress:
    """The progress of a job.

    Attributes:
        done: The job has ended, successfully or not.
        failure: Reason of the failure; empty if the job did not fail.
        text: Description of the progress, for reports.
        impeded: An obstacle blocks the job at the moment; `text` describes it.
    """

    done: bool = False
    failure: str = ""
    text: str = ""
    impeded: bool = False


class Job(Protocol):
    """Something that the robot does over time.

    Attributes:
        device: Device that the job owns while it runs.
        kind: The `woosh.action.Type` in reports about the job.
    """

    device: Device
    kind: util_action_pb2.Type

    def tick(self, robot: Robot, dt: float) -> Progress:
        """Work for `dt` seconds of simulated time."""

    def suspend(self, robot: Robot) -> None:
        """Prepare for a pause: the next tick may come later and at another place, or never."""


def failed(reason: str) -> Progress:
    """Return the progress of a job that failed."""
    return Progress(done=True, failure=reason)


class Wait:
    """Waits for a time in seconds, which may be infinite, or until `end` is called."""

    device = Device.NONE
    kind = util_action_pb2.kWait

    def __init__(self, seconds: float) -> None:
        self._left = seconds
        """Remaining time, in seconds."""

    def tick(self, robot: Robot, dt: float) -> Progress:
        self._left -= dt
        if self._left == math.inf:
            return Progress(text="waiting for the order to continue")
        return Progress(done=self._left <= 0.0, text=f"{max(0.0, self._left):.0f} s left to wait")

    def suspend(self, robot: Robot) -> None:
        """Do nothing: the remaining time is kept."""

    def end(self) -> None:
        """End the wait at the next tick."""
        self._left = 0.0
