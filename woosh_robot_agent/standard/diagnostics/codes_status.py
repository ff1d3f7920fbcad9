"""Status of the status codes that are not resolved."""

from __future__ import annotations

from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo
from woosh_robot_agent.standard.diagnostics.status import ERROR, WARN, Status
from woosh_robot_agent.status_codes import explained


def codes_status(info: RobotInfo) -> Status:
    """Return the status of the abnormal codes that the chassis reports now."""
    status = Status("abnormal codes")
    for code in info.abnormal_codes.scs:
        level = ERROR if code.level == StatusCode.kFault else WARN
        status.tell(level, explained(code.code, code.msg))
    return status
