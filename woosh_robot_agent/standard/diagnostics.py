"""/diagnostics: what is well and what is not, made of what the agent knows anyway."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from woosh_robot_agent.link import ChassisClient, LinkState
from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode
from woosh_robot_agent.pb.robot.robot_pb2 import Battery, HardwareState, RobotInfo
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.protos import full_name
from woosh_robot_agent.readiness import is_located, is_taskable, objections
from woosh_robot_agent.standard.audience import Audience
from woosh_robot_agent.standard.part_context import Part, PartContext

_RATE_HZ = 1.0
_INFO = full_name(RobotInfo)

OK, WARN, ERROR, STALE = (
    DiagnosticStatus.OK,
    DiagnosticStatus.WARN,
    DiagnosticStatus.ERROR,
    DiagnosticStatus.STALE,
)


@dataclass
class Status:
    """One status, as `diagnostic_updater` makes them: the worst of what it was told counts.

    Attributes:
        name: what it is about.
        level: of DiagnosticStatus.
        texts: what is to be said, the worst of it in the message.
        values: shown below it.
    """

    name: str
    level: bytes = OK
    texts: list[str] = field(default_factory=list)
    values: dict[str, object] = field(default_factory=dict)

    def tell(self, level: bytes, text: str) -> None:
        """Add something to say."""
        if level > self.level:
            self.level = level
        self.texts.append(text)

    def message(self, prefix: str, hardware_id: str, fine: str = "OK") -> DiagnosticStatus:
        """As a message; `prefix` tells robots apart."""
        return DiagnosticStatus(
            level=self.level,
            name=f"{prefix}: {self.name}",
            message="; ".join(self.texts) or fine,
            hardware_id=hardware_id,
            values=[KeyValue(key=key, value=str(value)) for key, value in self.values.items()],
        )


def link_status(chassis: ChassisClient, superseded: int) -> Status:
    """The link: state, since when, how it does, and what was lost.

    Args:
        chassis: the link.
        superseded: number of velocities that were not sent because they were out of date.
    """
    stats, status = chassis.stats, Status("link")
    if chassis.state is not LinkState.READY:
        why = f": {chassis.last_error}" if chassis.last_error else ""
        status.tell(ERROR, f"{chassis.state.value}{why}")
    round_trip = "unknown" if stats.round_trip is None else f"{stats.round_trip * 1000:.1f} ms"
    status.values = {
        "state": chassis.state.value,
        "address": chassis.config.address,
        "since": time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(chassis.since)),
        "reconnects": max(stats.connects - 1, 0),
        "round trip": round_trip,
        "rx": stats.rx,
        "tx": stats.tx,
        "parse errors": sum(stats.bad_frames.values()),
        "drops": sum(stats.dropped_pushes.values()),
        "refused requests": sum(stats.refused_requests.values()),
        "superseded velocities": superseded,
        "timeouts": sum(stats.timeouts.values()),
        "late answers": stats.late_answers,
    }
    for what, counter in (
        ("parse errors", stats.bad_frames),
        ("drops", stats.dropped_pushes),
        ("refused requests", stats.refused_requests),
        ("timeouts", stats.timeouts),
    ):
        status.values.update({f"{what}: {kind}": count for kind, count in counter.items()})
    return status


def chassis_status(info: RobotInfo) -> Status:
    """The robot: its state and modes, and each reason for which it would refuse a task."""
    status = Status("chassis")
    found = objections(info)
    for objection in found:
        status.tell(WARN, str(objection))
    if info.state == robot.kFault:
        status.tell(ERROR, "the robot reports a fault")
    status.values = {
        "state": _name(robot.State, info.state),
        "control mode": _name(robot.ControlMode, info.mode.ctrl),
        "work mode": _name(robot.WorkMode, info.mode.work),
        "taskable": _yes(is_taskable(info)),
        "localised": _yes(is_located(info)),
        "scene": info.scene.scene_name,
        "map": info.scene.map_name,
    }
    return status


def battery_status(info: RobotInfo) -> Status:
    """The battery, judged by the robot's own settings."""
    status, battery, power = Status("battery"), info.battery, info.setting.power
    charging = battery.charge_state in (Battery.kManual, Battery.kAuto)
    if not charging and battery.power <= power.alarm:
        status.tell(ERROR, f"{battery.power} % is at or below the alarm of {power.alarm} %")
    elif not charging and battery.power <= power.low:
        status.tell(WARN, f"{battery.power} % is low, at or below {power.low} %")
    status.values = {
        "percent": battery.power,
        "charging": _name(Battery.ChargeState, battery.charge_state),
    }
    return status


def hardware_status(hardware: HardwareState) -> Status:
    """Each device that is not normal."""
    status = Status("hardware")
    for name, state in devices(hardware):
        if state == HardwareState.kNormal:
            continue
        word = _name(HardwareState.State, state)
        status.values[name] = word
        if state != HardwareState.kInfo:
            status.tell(ERROR if state == HardwareState.kFatal else WARN, f"{name}: {word}")
    return status


def devices(hardware: HardwareState) -> Iterator[tuple[str, int]]:
    """Every device with its `HardwareState.State`; several of a kind are numbered from 1."""
    for descriptor in HardwareState.DESCRIPTOR.fields:
        if descriptor.enum_type is None:
            continue
        value = getattr(hardware, descriptor.name)
        if isinstance(value, int):
            yield descriptor.name, value
        else:
            yield from ((f"{descriptor.name} {i}", each) for i, each in enumerate(value, start=1))


def codes_status(info: RobotInfo) -> Status:
    """The abnormal codes: what is wrong now, in the chassis's words."""
    status = Status("abnormal codes")
    for code in info.abnormal_codes.scs:
        level = ERROR if code.level == StatusCode.kFault else WARN
        status.tell(level, f"{code.code}: {code.msg}")
    return status


class Diagnostics(Part):
    """Publishes the statuses at 1 Hz. They cost the chassis nothing: nothing is asked for them."""

    def __init__(self, host: PartContext) -> None:
        self._host = host
        self._audience = Audience(host)
        self._publisher = self._audience.publisher("/diagnostics")

    async def run(self) -> None:
        """See `Part.run`."""
        async for _ in self._audience.times(lambda: _RATE_HZ):
            self._publisher.publish(self._message())

    def _message(self) -> DiagnosticArray:
        chassis = self._host.chassis
        info = self._host.known.get(_INFO)
        statuses = [link_status(chassis, self._host.gate.superseded)]
        serial = ""
        if isinstance(info, RobotInfo):
            serial = str(info.robot_id or info.genral.serial_number)
            statuses += [
                chassis_status(info),
                battery_status(info),
                hardware_status(info.hardware_state),
                codes_status(info),
            ]
            if chassis.state is not LinkState.READY:
                for status in statuses[1:]:
                    status.level = STALE
                    status.texts.insert(0, "there is no link; what was known last")
        prefix = self._host.node.get_fully_qualified_name().lstrip("/")
        message = DiagnosticArray(status=[each.message(prefix, serial) for each in statuses])
        message.header.stamp = self._host.now()
        return message


def _name(enum: Any, value: int) -> str:
    """The name of an enum's value without its `k`, or the number that firmware made of it."""
    names = {number: name for name, number in enum.items()}
    return names[value].removeprefix("k") if value in names else str(value)


def _yes(value: bool | None) -> str:
    return "unknown" if value is None else "yes" if value else "no"
