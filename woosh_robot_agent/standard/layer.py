"""The standard layer, put together."""

from __future__ import annotations

from collections.abc import Callable

from woosh_robot_agent.standard.host import Host, Part
from woosh_robot_agent.standard.odom import Odom

#: What makes each part, with the parameters of which any switches it on.
PARTS: tuple[tuple[Callable[[Host], Part], tuple[str, ...]], ...] = (
    (Odom, ("enable_odom", "publish_tf")),
)


class StandardLayer:
    """The parts that the parameters switch on.

    Args:
        host: what they share.
    """

    def __init__(self, host: Host) -> None:
        self._host = host
        settings = host.settings()
        self._parts = [
            make(host)
            for make, switches in PARTS
            if any(getattr(settings, switch) for switch in switches)
        ]

    def start(self) -> None:
        """Let all parts run; from any thread."""
        for part in self._parts:
            self._host.thread.spawn(part.run)
