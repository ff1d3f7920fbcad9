"""Why a chassis would not take a task now."""

from __future__ import annotations

from dataclasses import dataclass

from woosh_robot_agent.pb.util import robot_pb2 as util_robot_pb2


@dataclass
class Readiness:
    """The modes and conditions that decide whether the chassis may move by itself.

    Attributes:
        ctrl: The control mode that clients asked for.
        key_manual: The key switch stands at manual, whatever clients ask for.
        work: The work mode.
        initialised: It was told where it is since it was switched on.
        located: It still knows where it is.
        emergency_stop: The button is pressed.
        battery_empty: There is nothing left to drive with.
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
        """The control mode that counts."""
        return util_robot_pb2.kManual if self.key_manual else self.ctrl

    def objections(self) -> list[str]:
        """Every reason against moving by itself, each with its remedy; none if it is ready."""
        reasons = (
            (self.emergency_stop, "emergency stop is pressed: release it first"),
            (self.key_manual, "key switch stands at manual: turn it to automatic first"),
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
            (not self.initialised, "robot is not initialised: InitRobot first"),
            (
                self.initialised and not self.located,
                "robot has lost its localisation: InitRobot or SetRobotPose first",
            ),
            (self.battery_empty, "battery is empty: charge first"),
        )
        return [text for applies, text in reasons if applies]
