"""`scripts/run`: the page and the agent beside a simulated chassis, or a fleet."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.harness import TIMEOUT
from tests.vda5050.broker import mosquitto_path
from woosh_robot_agent.testing.agents import domain_variables

SCRIPTS = Path(__file__).parents[2] / "scripts"


def checkout(folder: Path, release: str = "") -> Path:
    """Return `scripts/run` in a folder where everything is set up, with the programs under test.

    Args:
        folder: an empty folder.
        release: suffix of the folders of a release that `WOOSH_ROS` selects.
    """
    programs = folder / f"install{release}/woosh_robot_agent/lib/woosh_robot_agent"
    programs.mkdir(parents=True)
    modules = {
        "agent": "agent import main",
        "simulator": "simulator.__main__ import main",
        "dashboard": "tools.__main__ import dashboard as main",
        "vda5050": "vda5050.__main__ import main",
    }
    for name, module in modules.items():
        (programs / name).write_text(
            f"import sys\nfrom woosh_robot_agent.{module}\nsys.exit(main())\n"
        )
    (folder / "scripts").mkdir()
    environment = f"WOOSH_ROBOT_AGENT_VENV={folder}/.venv{release}\n"
    for name, text in (("setup", ""), ("env", environment)):
        script = folder / "scripts" / name
        script.write_text(f"#!/usr/bin/env bash\n{text}")
        script.chmod(0o755)
    for path in ("scripts/run", "scripts/run_fleet", "docs", "woosh_robot_agent"):
        (folder / path).symlink_to(SCRIPTS.parent / path)
    return folder / "scripts/run"


@contextmanager
def running(
    script: Path, domain: int, *arguments: str
) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Start `scripts/run`; yield its process and the output until it is ready or ends."""
    process, output = started(script, domain, *arguments)
    while "address already in use" in output:  # another program took a port that was free
        process.communicate(timeout=TIMEOUT)
        process, output = started(script, domain, *arguments)
    try:
        yield process, output
    finally:
        process.terminate()  # stops its programs, too
        process.communicate(timeout=TIMEOUT)


def started(script: Path, domain: int, *arguments: str) -> tuple[subprocess.Popen[str], str]:
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    process = subprocess.Popen(
        ["bash", script, *arguments],
        env={**os.environ, **domain_variables(domain), "PATH": path},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert process.stdout is not None
    lines = []
    for line in process.stdout:
        lines.append(line)
        if "Press Ctrl-C here" in line:
            break
    return process, "".join(lines)


def test_the_address_of_the_page_comes_before_the_commands(tmp_path: Path, domain: int) -> None:
    """Also that no argument for the agent connects it to real robots instead."""
    file = tmp_path / "mine.yaml"
    file.write_text(
        "/woosh_robot/agent: {ros__parameters: {ip: 192.0.2.1, robots: [r1]}}\n"
        "/woosh_robot/r1/agent: {ros__parameters: {ip: 192.0.2.1}}\n"
    )
    script = checkout(tmp_path, "-kilted")
    mine = ("--", "--params-file", str(file), "-r", "__node:=mine")
    with running(script, domain, *mine) as (process, output):
        address = re.search(r"in your browser: (http://127\.0\.0\.1:\d+/)\n", output)
        assert address, output
        before, after = output[: address.start()], output[address.end() :]
        assert "/woosh_robot" not in before
        assert "starting the agent" in after
        assert "/woosh_robot/robot/PoseSpeed" in after
        assert "export WOOSH_ROS=kilted; source" in after
        with urllib.request.urlopen(address[1], timeout=TIMEOUT) as response:
            assert b"main.js" in response.read()
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=TIMEOUT)
    assert process.returncode == 130


@pytest.mark.parametrize("port", ["65535", "5e3"])
def test_a_port_that_cannot_be_used_is_refused(tmp_path: Path, domain: int, port: str) -> None:
    with running(checkout(tmp_path), domain, "--port", port) as (process, output):
        process.wait(TIMEOUT)
    assert output == f"--port must be a number from 1 to 65534, not {port}\n"
    assert process.returncode == 2


@pytest.mark.skipif(mosquitto_path() is None, reason="mosquitto is not installed")
def test_a_fleet_is_sent_round_and_ends_with_ctrl_c(tmp_path: Path, domain: int) -> None:
    with running(checkout(tmp_path), domain, "--fleet", "2") as (process, output):
        address = re.search(r"http://127\.0\.0\.1:\d+/\n", output)
        broker = re.search(r"mosquitto_sub -p (\d+)", output)
        assert address, output
        assert broker, output
        assert "WOOSH_ROS" not in output, "the default release"
        with urllib.request.urlopen(address[0].strip(), timeout=TIMEOUT) as response:
            assert b"main.js" in response.read()
        assert process.stdout is not None
        released = next(line for line in process.stdout if "30002: released" in line)
        assert released
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=TIMEOUT)
    assert process.returncode == 130
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", int(broker[1])), TIMEOUT)
