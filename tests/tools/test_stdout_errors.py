"""Programs whose stdout cannot be written."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.quick_chassis import quick_config
from woosh_robot_agent.simulator import SimulatorThread

TIMEOUT = 120.0
ADDRESS = "--ip 127.0.0.1 --port {port}"
PROGRAMS = [
    f"tools.doctor {ADDRESS}",
    f"tools.doctor {ADDRESS} --json",
    "tools.doctor --help",
    f"tools.monitor {ADDRESS}",
    f"tools.monitor {ADDRESS} --once",
    f"tools.record {ADDRESS} --output {{new}}",
    "tools.replay {recording} --port 0",
    "simulator --port 0 --tcp-port 0",
    "simulator --list-faults",
]
"""Programs that print, with their arguments."""


def run(command: str, stdout: int, unbuffered: str = "") -> tuple[int, str]:
    """Run a program of the package; return its exit status and what it wrote to stderr."""
    module, *arguments = command.split()
    done = subprocess.run(
        [sys.executable, "-m", f"woosh_robot_agent.{module}", *arguments],
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
        timeout=TIMEOUT,
        env={**os.environ, "PYTHONUNBUFFERED": unbuffered},
    )
    return done.returncode, done.stderr


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, object]]:
    """A chassis and a recording for the arguments of `PROGRAMS`."""
    recording = tmp_path_factory.mktemp("recording") / "a.mcap"
    with SimulatorThread(quick_config(port=0, tcp_port=0)) as chassis:
        places = {"port": chassis.port, "recording": recording}
        command = f"tools.record {ADDRESS} --output {{recording}} --duration 0.2"
        status, err = run(command.format(**places), subprocess.DEVNULL)
        assert status == 0, err
        yield places


@pytest.mark.parametrize("program", PROGRAMS)
@pytest.mark.parametrize("unbuffered", ["", "1"])
class TestStdout:
    def test_broken_pipe_ends_a_program_quietly(
        self, places: dict[str, object], tmp_path: Path, program: str, unbuffered: str
    ) -> None:
        reader, writer = os.pipe()
        os.close(reader)
        command = program.format(**places, new=tmp_path / "new.mcap")
        status, err = run(command, writer, unbuffered)
        os.close(writer)
        assert (status, err) == (1, "")

    @pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
    def test_full_disk_ends_a_program_with_one_error(
        self, places: dict[str, object], tmp_path: Path, program: str, unbuffered: str
    ) -> None:
        command = program.format(**places, new=tmp_path / "new.mcap")
        with open("/dev/full", "wb") as full:
            status, err = run(command, full.fileno(), unbuffered)
        assert (status, err) == (1, "error: cannot write to stdout: No space left on device\n")


def test_a_program_without_stdout_runs(places: dict[str, object]) -> None:
    code = "import os, sys; os.close(1); os.execv(sys.executable, [sys.executable, *sys.argv[1:]])"
    command = f"-m woosh_robot_agent.tools.doctor {ADDRESS}".format(**places).split()
    done = subprocess.run([sys.executable, "-c", code, *command], capture_output=True, text=True)
    assert done.stderr == ""
