"""Handling of the signals that end a program."""

from __future__ import annotations

# Import nothing slow here: programs import this module before they can handle signals.
import os
import signal


class StopSignals:
    """Handler of SIGINT and SIGTERM that sets a flag instead of ending the program.

    Attributes:
        received: True once a signal has arrived.
        fd: File descriptor that becomes readable with each signal, also while the main thread is
            in a call that does not return to Python.
    """

    def __init__(self) -> None:
        self.received = False
        self.fd, self._write_end = os.pipe()
        os.set_blocking(self.fd, False)
        os.set_blocking(self._write_end, False)
        self._former_fd = signal.set_wakeup_fd(self._write_end, warn_on_full_buffer=False)
        self._former = {
            number: signal.signal(number, self._handle)
            for number in (signal.SIGINT, signal.SIGTERM)
        }

    def ignore(self) -> None:
        """Ignore further signals, which would change the exit status of an ending program."""
        for number in self._former:
            signal.signal(number, signal.SIG_IGN)

    def restore(self) -> None:
        """Restore the former handlers, and close `fd`."""
        for number, handler in self._former.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(self._former_fd)
        os.close(self._write_end)
        os.close(self.fd)

    def _handle(self, number: int, frame: object) -> None:
        self.received = True
