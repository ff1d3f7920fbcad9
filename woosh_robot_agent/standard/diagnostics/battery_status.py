"""Status of the battery."""

from __future__ import annotations

from woosh_robot_agent.pb.robot.robot_pb2 import Battery, RobotInfo
from woosh_robot_agent.standard.diagnostics.status import ERROR, WARN, Status, name_of


def battery_status(info: RobotInfo) -> Status:
    """Return the status of the battery, judged by the thresholds in the robot's settings."""
    status, battery, power = Status("battery"), info.battery, info.setting.power
    charging = battery.charge_state in (Battery.kManual, Battery.kAuto)
    if not charging and battery.power <= power.alarm:
        status.tell(ERROR, f"{battery.power} % is at or below the alarm of {power.alarm} %")
    elif not charging and battery.power <= power.low:
        status.tell(WARN, f"{battery.power} % is low, at or below {power.low} %")
    status.values = {
        "percent": battery.power,
        "charging": name_of(Battery.ChargeState, battery.charge_state),
    }
    return status
