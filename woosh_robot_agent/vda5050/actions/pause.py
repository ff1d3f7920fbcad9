"""The pause of a vehicle, in which everything that moves the robot takes part."""

from __future__ import annotations

from collections.abc import Callable


class Pause:
    """The pause of a vehicle.

    Attributes:
        wanted: True if the vehicle is, or must be, paused.
    """

    def __init__(self) -> None:
        self.wanted = False
        self._participants: list[tuple[Callable[[bool], None], Callable[[], bool]]] = []

    def join(self, apply: Callable[[bool], None], is_paused: Callable[[], bool]) -> None:
        """Add something that moves the robot.

        Args:
            apply: called with True to pause it, with False to resume it.
            is_paused: returns True if it does not move, or cannot be paused.
        """
        self._participants.append((apply, is_paused))

    def set(self, wanted: bool) -> None:
        """Pause or resume everything; idempotent."""
        if wanted != self.wanted:
            self.wanted = wanted
            for apply, _ in self._participants:
                apply(wanted)

    @property
    def in_effect(self) -> bool:
        """True once everything is paused."""
        return self.wanted and all(is_paused() for _, is_paused in self._participants)
