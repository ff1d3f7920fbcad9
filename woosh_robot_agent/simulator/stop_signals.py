"""Handles the signals that end a program."""

from __future__ import annotations

# Import nothing slow here: the program imports this module before it can handle signals.
import signal

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable


class StopSignals:
    """Handles SIGINT and SIGTERM from its creation on.

    Attributes:
        received: A signal has arrived.
        callback: Called on each signal, in the main thread.
    """

    def __init__(self) -> None:
        self.received = False
        self.callback: Callable[[], object] | None = None
        self._former = {
            number: signal.signal(number, self._handle)
            for number in (signal.SIGINT, signal.SIGTERM)
        }

    def ignore(self) -> None:
        """Ignore further signals, which would change the exit status of an ending program."""
        for number in self._former:
            signal.signal(number, signal.SIG_IGN)

    def restore(self) -> None:
        """Restore the former handlers."""
        for number, handler in self._former.items():
            signal.signal(number, handler)

    def _handle(self, number: int, frame: object) -> None:
        self.received = True
        if self.callback:
            self.callback()
