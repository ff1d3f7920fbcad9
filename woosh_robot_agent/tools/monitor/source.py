"""Interface between the monitor and where its data comes from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from woosh_robot_agent.tools.monitor.robot_view import RobotView


@dataclass(frozen=True)
class LinkReport:
    """State of the way from the robot to the monitor.

    Attributes:
        good: True if the view is up to date.
        text: State of the link in words.
        detail: Counters, times or what to do; may be empty.
    """

    good: bool
    text: str
    detail: str = ""


class Source(Protocol):
    """Where a view of a robot comes from. Used in one asyncio event loop.

    Attributes:
        name: Name of the source, shown as title.
        view: State of the robot as received so far.
    """

    name: str
    view: RobotView

    def link(self) -> LinkReport:
        """Return the present state of the link."""

    def is_complete(self) -> bool:
        """Return True once all first values have arrived, or have been awaited long enough."""

    async def start(self) -> None:
        """Start to receive."""

    async def close(self) -> None:
        """Stop to receive."""
