"""The configuration of a vehicle, with the versions of the standard."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.vda5050.messages.protocol import Version
from woosh_robot_agent.vda5050.messages.v2_1 import Version21
from woosh_robot_agent.vda5050.messages.v3_0 import Version30
from woosh_robot_agent.vda5050.robot.status import Limits

VERSIONS: Mapping[str, Callable[[], Version]] = {"2.1": Version21, "3.0": Version30}
"""Versions, by the value of `--version`."""


_FORBIDDEN = frozenset("+#/\0")
"""Characters that a level of a topic cannot have."""


@dataclass(frozen=True)
class VehicleConfig:
    """Configuration of a vehicle.

    Attributes:
        link: address of the robot.
        manufacturer: manufacturer in the topics.
        serial_number: serial number in the topics; empty for that of the robot.
        interface: first level of the topics.
        version: version of the standard.
        limits: limits of the robot that it does not report, and options of the state.
        log_folder: folder for the files of logReport; None if the vehicle does not have the action.
        state_folder: folder of the state file; None to keep nothing over a restart.
    """

    link: LinkConfig
    manufacturer: str = "Woosh"
    serial_number: str = ""
    interface: str = "uagv"
    version: Version = field(default_factory=Version21)
    limits: Limits = field(default_factory=Limits)
    log_folder: Path | None = None
    state_folder: Path | None = None

    def __post_init__(self) -> None:
        """Check the levels of the topics.

        Raises:
            ValueError: one has a character that MQTT does not permit there.
        """
        levels = {"manufacturer": self.manufacturer, "serial number": self.serial_number}
        for name, value in {**levels, "interface": self.interface.replace("/", "")}.items():
            if bad := set(value) & _FORBIDDEN:
                characters = " ".join(sorted(bad))
                raise ValueError(
                    f"the {name} is a part of the topics and cannot have {characters}: {value!r}"
                )
