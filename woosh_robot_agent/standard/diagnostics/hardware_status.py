"""Status of the hardware."""

from __future__ import annotations

from collections.abc import Iterator

from woosh_robot_agent.pb.robot.robot_pb2 import HardwareState
from woosh_robot_agent.standard.diagnostics.status import ERROR, WARN, Status, name_of


def hardware_status(hardware: HardwareState) -> Status:
    """Return the status of the hardware, with each device that is not normal."""
    status = Status("hardware")
    for name, state in devices(hardware):
        if state == HardwareState.kNormal:
            continue
        word = name_of(HardwareState.State, state)
        status.values[name] = word
        if state != HardwareState.kInfo:
            status.tell(ERROR if state == HardwareState.kFatal else WARN, f"{name}: {word}")
    return status


def devices(hardware: HardwareState) -> Iterator[tuple[str, int]]:
    """Yield each device and its `HardwareState.State`; devices of one kind are numbered from 1."""
    for descriptor in HardwareState.DESCRIPTOR.fields:
        if descriptor.enum_type is None:
            continue
        value = getattr(hardware, descriptor.name)
        if isinstance(value, int):
            yield descriptor.name, value
        else:
            yield from ((f"{descriptor.name} {i}", each) for i, each in enumerate(value, start=1))
