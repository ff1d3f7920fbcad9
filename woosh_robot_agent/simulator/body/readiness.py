"""The modes and conditions that decide whether the robot may move by itself."""

from __future__ import annotations

from dataclasses import dataclass

from woosh_robot_agent.pb.util import robot_pb2 as util_robot_pb2
from woosh_robot_agent.simulator.errors import RefusedError


@dataclass
class Readiness:
    """The modes and conditions that decide whether the robot may move by itself.

    Attributes:
        ctrl: Control mode that clients requested.
        key_manual: The key switch is at manual, which overrides `ctrl`.
        work: Work mode.
        initialised: A client has told the robot its pose since it was switched on.
        located: The robot knows its pose.
        emergency_stop: The emergency stop button is pressed.
        battery_empty: The battery is empty.
    """

    ctrl: util_robot_pb2.ControlMode = util_robot_pb2.kAuto
    key_manual: bool = False
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
    def ready(self) -> bool:
        """True if the robot may move by itself."""
        return not self.objections()

    def require_ready(self) -> None:
        """Check that the robot may move by itself.

        Raises:
            RefusedError: It may not. The text gives the first reason.
        """
        objections = self.objections()
        if objections:
            raise RefusedError(objections[0])

    def objections(self) -> list[str]:
        """Return every reason why the robot may not move by itself, each with its remedy."""
        reasons = (
            (self.emergency_stop, "emergency stop is pressed: release it first"),
            (self.key_manual, "key switch is at manual: turn it to automatic first"),
            (
                self.ctrl == util_robot_pb2.kManual,
                "robot is in manual mode: switch to automatic first",
            ),
            (
                self.ctrl == util_robot_pb2.kMaintain,
                "robot is in maintenance mode: switch to automatic first",
            ),
            (
                self.work == util_robot_pb2.kDeployMode,
                "robot is in deployment mode: switch to task mode first",
            ),
            (
                self.work == util_robot_pb2.kScheduleMode,
                "robot is in schedule mode: a dispatch system drives it; switch to task mode first",
            ),
            (not self.initialised, "robot is not initialised: send InitRobot first"),
            (
                self.initialised and not self.located,
                "robot has lost its localisation: send InitRobot or SetRobotPose first",
            ),
            (self.battery_empty, "battery is empty: charge first"),
        )
        return [text for applies, text in reasons if applies]
