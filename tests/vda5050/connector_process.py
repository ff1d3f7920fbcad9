"""The connector as a program of its own, which can be killed."""

from __future__ import annotations

import subprocess
import sys
import threading
from pathlib import Path

from woosh_robot_agent.simulator import SimulatorThread


class ConnectorProcess:
    """A running connector. It is killed at the end of the `with` block, if it still runs."""

    def __init__(self, chassis: SimulatorThread, broker: str, folder: Path, *options: str) -> None:
        self.lines: list[str] = []
        self._command = [
            *(sys.executable, "-m", "woosh_robot_agent.vda5050"),
            *("--ip", f"127.0.0.1:{chassis.port}"),
            *("--broker", broker, "--state-folder", str(folder), *options),
        ]

    def __enter__(self) -> ConnectorProcess:
        self._process = subprocess.Popen(
            self._command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.kill()

    def kill(self) -> None:
        """End the program as `kill -9` does."""
        self._process.kill()
        self._end()

    def stop(self) -> int:
        """End the program as Ctrl-C does, and return its exit status."""
        self._process.terminate()
        return self._end()

    def _end(self) -> int:
        status = self._process.wait(60.0)
        self._reader.join()
        if self._process.stderr is not None:
            self._process.stderr.close()
        return status

    def _read(self) -> None:
        assert self._process.stderr is not None
        self.lines += self._process.stderr
