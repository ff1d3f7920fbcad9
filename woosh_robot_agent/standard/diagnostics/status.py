"""One status of /diagnostics, merged from several messages."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

OK, WARN, ERROR, STALE = (
    DiagnosticStatus.OK,
    DiagnosticStatus.WARN,
    DiagnosticStatus.ERROR,
    DiagnosticStatus.STALE,
)


@dataclass
class Status:
    """One status, merged from several messages as in `diagnostic_updater`: the worst level counts.

    Attributes:
        name: subject of the status.
        level: level of DiagnosticStatus.
        texts: messages, in the order in which they were added.
        values: key-value pairs shown with the status.
        fine: message of a status without texts.
    """

    name: str
    level: bytes = OK
    texts: list[str] = field(default_factory=list)
    values: dict[str, object] = field(default_factory=dict)
    fine: str = "OK"

    def tell(self, level: bytes, text: str) -> None:
        """Add a message, and raise the level to its level."""
        if level > self.level:
            self.level = level
        self.texts.append(text)

    def message(self, prefix: str, hardware_id: str) -> DiagnosticStatus:
        """Return the status as a ROS message.

        Args:
            prefix: prefix of the name, which tells robots apart.
            hardware_id: serial number or id of the robot.
        """
        return DiagnosticStatus(
            level=self.level,
            name=f"{prefix}: {self.name}",
            message="; ".join(self.texts) or self.fine,
            hardware_id=hardware_id,
            values=[KeyValue(key=key, value=str(value)) for key, value in self.values.items()],
        )


def name_of(enum: Any, value: int) -> str:
    """Return the name of an enum value without its `k`; the number if the value has no name."""
    names = {number: name for name, number in enum.items()}
    return names[value].removeprefix("k") if value in names else str(value)
