"""/diagnostics: the state of link, robot and agent, from data that the agent already has."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from woosh_robot_agent.link import LinkState
from woosh_robot_agent.link.protos import enum_name
from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Twist
from woosh_robot_agent.pb.robot.robot_pb2 import Battery, HardwareState, RobotInfo
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.robot import who_drives
from woosh_robot_agent.robot.clock import TOLERANCE, describe_offset
from woosh_robot_agent.robot.readiness import (
    accepts_task,
    devices,
    is_charging,
    is_located,
    objections,
    pose_problem,
)
from woosh_robot_agent.robot.status_codes import explained
from woosh_robot_agent.robot.watch import Watch
from woosh_robot_agent.ros.second_agent import SecondAgentDetector
from woosh_robot_agent.ros.standard.part import NO_TIME, Part, PartContext

OK, WARN = DiagnosticStatus.OK, DiagnosticStatus.WARN
ERROR, STALE = DiagnosticStatus.ERROR, DiagnosticStatus.STALE


@dataclass
class Status:
    """One status, merged from several messages as in `diagnostic_updater`: the worst level counts.

    Attributes:
        name: subject of the status.
        level: level of DiagnosticStatus.
        texts: messages, in the order in which they were added.
        values: key-value pairs shown with the status.
        default: message of a status without texts.
    """

    name: str
    level: bytes = OK
    texts: list[str] = field(default_factory=list)
    values: dict[str, object] = field(default_factory=dict)
    default: str = "OK"

    def add(self, level: bytes, text: str) -> None:
        """Add a message; the status keeps its own level if `level` is lower."""
        if level > self.level:
            self.level = level
        self.texts.append(text)

    def message(self, prefix: str, hardware_id: str) -> DiagnosticStatus:
        """Return the status as a ROS message.

        Args:
            prefix: prefix of the name, which tells robots apart.
            hardware_id: id of the robot, or its serial number without an id; empty if unknown.
        """
        return DiagnosticStatus(
            level=self.level,
            name=f"{prefix}: {self.name}",
            message="; ".join(self.texts) or self.default,
            hardware_id=hardware_id,
            values=[KeyValue(key=key, value=str(value)) for key, value in self.values.items()],
        )


def agents_status(detector: SecondAgentDetector) -> Status:
    """Return the status that warns of a second agent in the namespace."""
    status = Status("agents")
    if detector.warning:
        status.add(WARN, detector.warning)
    return status


def battery_status(info: RobotInfo) -> Status:
    """Return the status of the battery, by the thresholds in the robot's settings."""
    if not info.HasField("battery"):
        return Status("battery", STALE, ["the robot has not reported its battery"])
    status, battery, power = Status("battery"), info.battery, info.setting.power
    charging = is_charging(battery)
    if not charging and battery.power <= power.alarm:
        status.add(ERROR, f"{battery.power} % is at or below the alarm of {power.alarm} %")
    elif not charging and battery.power <= power.low:
        status.add(WARN, f"{battery.power} % is low, at or below {power.low} %")
    status.values = {
        "percent": battery.power,
        "charging": enum_name(Battery.ChargeState, battery.charge_state),
    }
    return status


def chassis_status(info: RobotInfo) -> Status:
    """Return the status of the robot: state, modes, and each reason why it would refuse a task."""
    status = Status("chassis")
    for objection in objections(info):
        status.add(WARN, str(objection))
    if (problem := pose_problem(info)) is not None:
        status.add(WARN, str(problem))
    if info.state == robot.kFault:
        status.add(ERROR, "the robot reports a fault")
    status.values = {
        "state": enum_name(robot.State, info.state),
        "control mode": enum_name(robot.ControlMode, info.mode.ctrl),
        "work mode": enum_name(robot.WorkMode, info.mode.work),
        "taskable": _yes_or_no(accepts_task(info)),
        "localised": _yes_or_no(is_located(info)),
        "scene": info.scene.scene_name,
        "map": info.scene.map_name,
        "map id": info.pose_speed.map_id if info.HasField("pose_speed") else "unknown",
    }
    return status


def _yes_or_no(value: bool | None) -> str:
    return "unknown" if value is None else "yes" if value else "no"


def clock_status(context: PartContext) -> Status:
    """Return the status of the robot's clock, and of the clock of this node."""
    status, offset = Status("clock"), context.chassis.stats.clock_offset
    if not context.now_ns():
        status.add(WARN, NO_TIME)
    if offset is None:
        status.values = {"offset": "unknown, because the robot sends no times"}
        return status
    status.values = {"offset": f"{offset:.3f} s"}
    if abs(offset) > TOLERANCE:
        status.add(
            WARN,
            f"the robot's clock is {describe_offset(offset)}: synchronise both with the same time "
            "server (NTP); stamps of ROS messages are not affected, but the times in status codes "
            "and tasks are wrong by this difference",
        )
    return status


def codes_status(info: RobotInfo) -> Status:
    """Return the status of the abnormal codes that the chassis reports now."""
    status = Status("abnormal codes")
    for code in info.abnormal_codes.scs:
        level = ERROR if code.level == StatusCode.kFault else WARN
        status.add(level, explained(code.code, code.msg))
    return status


def hardware_status(hardware: HardwareState) -> Status:
    """Return the status of the hardware, with each device that is not normal."""
    status = Status("hardware")
    for name, state in devices(hardware):
        if state == HardwareState.kNormal:
            continue
        word = enum_name(HardwareState.State, state)
        status.values[name] = word
        if state != HardwareState.kInfo:
            status.add(ERROR if state == HardwareState.kFatal else WARN, f"{name}: {word}")
    return status


def link_status(context: PartContext) -> Status:
    """Return the status of the link: its state, and counters of traffic and losses."""
    chassis, status = context.chassis, Status("link")
    stats = chassis.stats
    if chassis.state is not LinkState.READY:
        why = f": {chassis.last_error}" if chassis.last_error else ""
        status.add(ERROR, f"{chassis.state.value}{why}")
    observes_only = bool(chassis.refusal(Twist()))  # any command would do
    if observes_only:
        status.add(OK, "observes only: commands are refused")
    round_trip = "unknown" if stats.round_trip is None else f"{stats.round_trip * 1000:.1f} ms"
    turns = context.thread.loop_thread.longest_turns  # commands wait for the end of a turn
    lately, ever = (f"{seconds * 1000:.1f} ms" for seconds in turns)
    status.values = {
        "state": chassis.state.value,
        "address": chassis.config.address,
        "observe only": "yes" if observes_only else "no",
        "since": time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(chassis.since)),
        "reconnects": max(stats.connects - 1, 0),
        "round trip": round_trip,
        "rx": stats.rx,
        "tx": stats.tx,
        "parse errors": sum(stats.bad_frames.values()),
        "drops": sum(stats.dropped_pushes.values()),
        "refused requests": sum(stats.refused_requests.values()),
        "superseded velocities": context.gate.superseded,
        "link thread held": f"{lately}, {ever} since the start",
        "timeouts": sum(stats.timeouts.values()),
        "late answers": stats.late_answers,
    }
    for subject, counter in (
        ("parse errors", stats.bad_frames),
        ("drops", stats.dropped_pushes),
        ("refused requests", stats.refused_requests),
        ("timeouts", stats.timeouts),
    ):
        status.values.update({f"{subject}: {kind}": count for kind, count in counter.items()})
    return status


def motion_status(watch: Watch) -> Status:
    """Return the status of the motion: what drives the robot, and commands without effect."""
    status = Status("motion")
    driver = watch.who_drives.now()
    status.default = f"{driver.name}: {driver.detail}" if driver.detail else driver.name
    status.values = {"driver": driver.name, "detail": driver.detail}
    if sources := watch.velocities.simultaneous:
        status.add(WARN, who_drives.simultaneous_warning(sources))
    if warning := watch.standstill.warning:
        status.add(WARN, warning)
    return status


_RATE = 1.0
"""Rate of /diagnostics, in Hz."""


class Diagnostics(Part):
    """Publishes /diagnostics at 1 Hz while there are subscribers. Sends no requests."""

    def __init__(self, context: PartContext) -> None:
        self._context = context
        self._subscribers = context.subscribers()
        self._publisher = context.publisher("/diagnostics", self._subscribers)

    async def run(self) -> None:
        await self._subscribers.repeat(lambda: _RATE, self._publish)

    async def _publish(self, _now: float) -> None:
        context = self._context
        info = context.last_known.value(RobotInfo)
        statuses = [link_status(context)]
        hardware_id = ""
        if info is not None:
            hardware_id = str(info.robot_id or info.genral.serial_number)
            of_robot = [
                chassis_status(info),
                battery_status(info),
                hardware_status(info.hardware_state),
                codes_status(info),
                motion_status(context.watch),
                clock_status(context),
            ]
            if context.chassis.state is not LinkState.READY:
                for status in of_robot:
                    status.level = STALE
                    status.texts.insert(0, "no link; last known values")
            statuses += of_robot
        statuses.append(agents_status(context.second_agent_detector))
        prefix = context.node.get_fully_qualified_name().lstrip("/")
        message = DiagnosticArray(status=[each.message(prefix, hardware_id) for each in statuses])
        message.header.stamp = context.now()
        self._publisher.publish(message)
