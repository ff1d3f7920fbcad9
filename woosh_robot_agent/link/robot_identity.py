"""The identity of a robot, as it reports it."""

from __future__ import annotations

from dataclasses import dataclass

from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo


@dataclass(frozen=True)
class RobotIdentity:
    """The identity of a robot.

    Attributes:
        robot_id: its number; 0 if it reports none.
        serial_number: its serial number; 0 if it reports none.
    """

    robot_id: int
    serial_number: int

    @classmethod
    def of(cls, info: RobotInfo) -> RobotIdentity:
        """Return the identity of the robot that sent `info`."""
        return cls(info.robot_id, info.genral.serial_number)

    def __str__(self) -> str:
        return f"robot {self.robot_id} (serial number {self.serial_number})"

    def differs_from(self, other: RobotIdentity) -> bool:
        """Return True if a number that both robots report differs."""
        pairs = (
            (self.robot_id, other.robot_id),
            (self.serial_number, other.serial_number),
        )
        return any(mine and others and mine != others for mine, others in pairs)
