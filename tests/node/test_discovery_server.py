"""The agent with the discovery server of Fast DDS, as docs/deployment.md describes it."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from tests.harness import Program
from woosh_robot_agent.simulator import SimulatorThread

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs/deployment.md"

pytestmark = pytest.mark.skipif(
    not shutil.which("fast-discovery-server")
    or os.environ.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp") != "rmw_fastrtps_cpp",
    reason="needs Fast DDS and its program fast-discovery-server",
)


def free_port() -> int:
    """Return a UDP port that nothing uses."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def documented_server(port: int) -> list[str]:
    """Return the documented command that starts a server, with an address of this machine."""
    start = "fast-discovery-server" + (" 42" if os.environ.get("ROS_DISTRO") == "kilted" else "")
    (line,) = re.findall(rf"{start} -i [^`\n]*", PAGE.read_text())
    words = shlex.split(line)
    words[words.index("-l") + 1] = "127.0.0.1"
    words[words.index("-p") + 1] = str(port)
    return words


@pytest.fixture
def server() -> Iterator[str]:
    """Start a discovery server; return its address."""
    port = free_port()
    process = subprocess.Popen(documented_server(port), stdout=subprocess.DEVNULL)
    yield f"127.0.0.1:{port}"
    process.kill()
    process.wait()


@pytest.fixture
def agent(
    server: str, domain: int, simulator: SimulatorThread, monkeypatch: pytest.MonkeyPatch
) -> Iterator[None]:
    """Start an agent that uses the discovery server."""
    with monkeypatch.context() as environment:
        environment.setenv("ROS_DISCOVERY_SERVER", server)
        program = Program(domain, ip="127.0.0.1", port=simulator.port)
    with closing(program):
        program.wait_says("connected to")
        yield


@pytest.mark.usefixtures("agent")
def test_a_node_with_the_server_uses_the_agent_and_is_told_of_nothing_else(
    server: str, domain: int, simulator: SimulatorThread
) -> None:
    for _ in range(2):  # a client of bare rclpy has crashed once, on Kilted
        done = subprocess.run(
            [sys.executable, "-m", "tests.node.discovery_client", str(domain)],
            cwd=ROOT,
            env=os.environ | {"ROS_DISCOVERY_SERVER": server},
            capture_output=True,
            text=True,
        )
        if done.returncode != -signal.SIGSEGV:
            break
    assert done.returncode == 0, done.stderr
    name = simulator.call(lambda inner: inner.chassis.robot_id)
    assert done.stdout.split() == [str(name), "0"]
