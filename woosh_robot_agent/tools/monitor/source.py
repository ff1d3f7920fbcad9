"""Interface between the monitor and the sources of its data."""

from __future__ import annotations

from typing import Protocol

from woosh_robot_agent.tools.link_report import LinkReport
from woosh_robot_agent.tools.robot_view import RobotView


class Source(Protocol):
    """Source of a view of one robot. Used in one asyncio event loop.

    Attributes:
        name: Name of the source, shown as title.
        view: State of the robot as received so far.
    """

    name: str
    view: RobotView

    def link(self) -> LinkReport:
        """Return the current state of the link."""

    def is_complete(self) -> bool:
        """Return True once all first values have arrived, or the wait for them has timed out."""

    async def start(self) -> None:
        """Start receiving."""

    async def close(self) -> None:
        """Stop receiving."""
