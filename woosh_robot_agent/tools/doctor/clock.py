"""Comparison of the robot's clock with this computer's."""

from __future__ import annotations

from woosh_robot_agent.tools.doctor.result import Result, Status
from woosh_robot_agent.tools.doctor.robot_info import RobotInfoAnswer

_UNITS = (("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0))


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
    direction = "ahead of" if answer.skew > 0 else "behind"
    return Result(
        Status.WARN,
        f"the robot's clock is {_duration(abs(answer.skew))} {direction} this computer's",
        "synchronise both with the same time server (NTP); until then the times in status codes "
        "and tasks are wrong by this difference",
    )


def _duration(seconds: float) -> str:
    for name, size in _UNITS:
        if seconds >= 2 * size:
            return f"{seconds / size:.1f} {name}"
    return f"{seconds:.1f} s"
