"""Errors of the vehicle from the status codes of the robot."""

from __future__ import annotations

from woosh_robot_agent.pb.robot.robot_count_pb2 import AbnormalCodes, StatusCode
from woosh_robot_agent.status_codes import explained
from woosh_robot_agent.vda5050.model.errors import ErrorLevel, Reference, VehicleError

_TYPE = "robotStatusCode"
"""Type of the errors."""
_LEVELS = {StatusCode.kWarn: ErrorLevel.WARNING, StatusCode.kFault: ErrorLevel.FATAL}
_HINT = "resolve the cause at the robot; the error ends when the robot does not report it any more"
_SAFETY_SCANNERS = 110203
"""First digits of the status codes of safety scanners."""
_FUNCTION = 10**6
"""Divisor that leaves the first digits of a status code."""


def code_errors(codes: AbnormalCodes) -> tuple[VehicleError, ...]:
    """Return the errors for the status codes that are not resolved; each code counts once."""
    latest = {code.code: code for code in codes.scs if code.level in _LEVELS}
    return tuple(
        VehicleError(
            type=_TYPE,
            level=_LEVELS[code.level],
            description=explained(code.code, code.msg),
            hint=_HINT,
            references=(Reference("statusCode", str(code.code)),),
        )
        for code in latest.values()
    )


def field_violated(codes: AbnormalCodes) -> bool:
    """Return True if a safety scanner has tripped."""
    return any(
        code.code // _FUNCTION == _SAFETY_SCANNERS and code.level in _LEVELS for code in codes.scs
    )
