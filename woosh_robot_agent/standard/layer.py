"""The standard layer, put together."""

from __future__ import annotations

from collections.abc import Callable

from woosh_robot_agent.standard.host import Host, Part

#: Makes the part that `enable_<name>` switches.
PARTS: dict[str, Callable[[Host], Part]] = {}


class StandardLayer:
    """The parts that the parameters switch on.

    Args:
        host: what they share.
    """

    def __init__(self, host: Host) -> None:
        self._host = host
        settings = host.settings()
        self._parts = [
            make(host) for name, make in PARTS.items() if getattr(settings, f"enable_{name}")
        ]

    def start(self) -> None:
        """Let all parts run; from any thread."""
        for part in self._parts:
            self._host.thread.spawn(part.run)
