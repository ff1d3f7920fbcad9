"""Comparison of the robot's clock with this computer's."""

from __future__ import annotations

from woosh_robot_agent.robot_clock import difference
from woosh_robot_agent.tools.doctor.result import Result, Status
from woosh_robot_agent.tools.doctor.robot_info import RobotInfoAnswer


def check_clock(answer: RobotInfoAnswer, max_skew: float) -> Result:
    """Check that the clocks differ by no more than `max_skew` seconds."""
    if answer.skew is None:
        return Result(
            Status.WARN,
            "the answer carries no time",
            "protobuf frames and old firmware have none: compare the clocks by other means",
        )
    # The robot may have created the answer at any moment of the round trip.
    if abs(answer.skew) <= max_skew + answer.round_trip / 2:
        return Result(Status.OK, f"differs by {abs(answer.skew):.2f} s")
    return Result(
        Status.WARN,
        f"the robot's clock is {difference(answer.skew)}",
        "synchronise both with the same time server (NTP); until then the times in status codes "
        "and tasks are wrong by this difference; stamps of ROS messages are not affected, because "
        "the agent takes them from this computer's clock",
    )
