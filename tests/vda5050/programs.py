"""The connector, and other programs, as processes of their own."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

from woosh_robot_agent.simulator import SimulatorThread

ROOT = Path(__file__).resolve().parents[2]


@contextmanager
def running(*command: object, log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run a Python program, and end it like `kill -9` at the end of the block.

    Args:
        log: file for its output.
    """
    with log.open("wb") as output:
        process = subprocess.Popen(
            [sys.executable, *map(str, command)], cwd=ROOT, stdout=output, stderr=output
        )
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def running_connector(
    chassis: SimulatorThread, broker: str, folder: Path, *options: str
) -> AbstractContextManager[subprocess.Popen[bytes]]:
    """Run the connector of a chassis, as `running` does; the folder gets its state and its log."""
    return running(
        *("-m", "woosh_robot_agent.vda5050", "--ip", f"127.0.0.1:{chassis.port}"),
        *("--broker", broker, "--state-folder", folder, *options),
        log=folder / "connector.log",
    )
