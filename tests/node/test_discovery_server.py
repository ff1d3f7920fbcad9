"""The agent with the discovery server of Fast DDS, as docs/deployment.md describes it."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import socket
import subprocess
from pathlib import Path

import pytest

from tests.harness import NAMESPACE, Client, Program, wait_until
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_msgs.srv import Setting

PAGE = Path(__file__).parents[2] / "docs/deployment.md"
SETTING = f"{NAMESPACE}/robot/Setting"

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
    (line,) = re.findall(r"^fast-discovery-server .*$", PAGE.read_text(), re.MULTILINE)
    words = shlex.split(line)
    words[words.index("-l") + 1] = "127.0.0.1"
    words[words.index("-p") + 1] = str(port)
    return words


def test_only_clients_of_the_discovery_server_find_the_agent(
    simulator: SimulatorThread, domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    port = free_port()
    server = subprocess.Popen(documented_server(port), stdout=subprocess.DEVNULL)
    monkeypatch.setenv("ROS_DISCOVERY_SERVER", f"127.0.0.1:{port}")
    program = Program(domain, "-p", "ip:=127.0.0.1", "-p", f"port:={simulator.port}")
    clients = []
    try:
        program.wait_says("connected to")
        with_server = Client(domain)
        clients.append(with_server)
        setting = with_server.call(Setting, "robot/Setting").info
        assert setting.identity.name == str(simulator.call(lambda chassis: chassis.robot_id))

        monkeypatch.delenv("ROS_DISCOVERY_SERVER")
        clients += [Client(domain, name="alone"), Client(domain, name="other")]
        # The two nodes without the server find each other, so they would have found the agent too.
        wait_until(
            lambda: ("other", "/") in clients[1].node.get_node_names_and_namespaces(), "the node"
        )
        assert not clients[1].node.count_services(SETTING)
    finally:
        for client in clients:
            client.close()
        program.process.kill()
        program.process.wait()
        server.kill()
        server.wait()
