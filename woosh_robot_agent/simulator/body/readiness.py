"""The modes and conditions that decide whether the robot may move by itself."""

from __future__ import annotations

from dataclasses import dataclass

from woosh_robot_agent.pb.util import robot_pb2 as util_robot_pb2
from woosh_robot_agent.simulator import refusals
from woosh_robot_agent.simulator.refusals import Refusal, RefusedError


@dataclass
class Readiness:
    """The modes and conditions that decide whether the robot may move by itself.

    Attributes:
        ctrl: Control mode that clients requested.
        key_manual: The key switch is at manual, which overrides `ctrl` and switches the motors off.
        key_accepts: Requests are accepted although the key switch is at manual.
        work: Work mode.
        initialised: A client has told the robot its pose since it was switched on.
        located: The robot knows its pose.
        emergency_stop: The emergency stop button is pressed.
        battery_empty: The battery is empty.
    """

    ctrl: util_robot_pb2.ControlMode = util_robot_pb2.kAuto
    key_manual: bool = False
    key_accepts: bool = False
    work: util_robot_pb2.WorkMode = util_robot_pb2.kTaskMode
    initialised: bool = True
    located: bool = True
    emergency_stop: bool = False
    battery_empty: bool = False

    @property
    def control(self) -> util_robot_pb2.ControlMode:
        """The effective control mode."""
        return util_robot_pb2.kManual if self.key_manual else self.ctrl

    @property
    def motors_on(self) -> bool:
        """True unless the key switch has switched the motors off."""
        return not self.key_manual

    @property
    def ready(self) -> bool:
        """True if the robot may move by itself."""
        return not self.objections()

    @property
    def obstruction(self) -> Refusal | None:
        """The first reason to refuse tasks and actions, and to stop running ones; None if none."""
        for objection in self.objections():
            if not (objection is refusals.KEY_AT_MANUAL and self.key_accepts):
                return objection
        return None

    def require_ready(self) -> None:
        """Check that the robot accepts tasks and actions.

        Raises:
            RefusedError: It does not.
        """
        if self.obstruction:
            raise RefusedError(self.obstruction)

    def require_located(self) -> None:
        """Check that the robot knows its pose.

        Raises:
            RefusedError: It does not.
        """
        if not self.initialised:
            raise RefusedError(refusals.NOT_INITIALISED)
        if not self.located:
            raise RefusedError(refusals.LOCALISATION_LOST)

    def objections(self) -> list[Refusal]:
        """Return every reason why the robot may not move by itself."""
        manual, maintenance = util_robot_pb2.kManual, util_robot_pb2.kMaintain
        deployment, schedule = util_robot_pb2.kDeployMode, util_robot_pb2.kScheduleMode
        reasons = (
            (self.emergency_stop, refusals.EMERGENCY_STOP),
            (self.key_manual, refusals.KEY_AT_MANUAL),
            (self.ctrl == manual, refusals.MANUAL_MODE),
            (self.ctrl == maintenance, refusals.MAINTENANCE_MODE),
            (self.work == deployment, refusals.DEPLOYMENT_MODE),
            (self.work == schedule, refusals.SCHEDULE_MODE),
            (not self.initialised, refusals.NOT_INITIALISED),
            (self.initialised and not self.located, refusals.LOCALISATION_LOST),
            (self.battery_empty, refusals.BATTERY_EMPTY),
        )
        return [refusal for applies, refusal in reasons if applies]
