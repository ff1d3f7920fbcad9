"""The agent with the discovery server of Fast DDS, as docs/deployment.md describes it."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import socket
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.harness import NAMESPACE, Client, Program, wait_until
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_msgs.srv import PoseSpeed, Setting

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


@pytest.fixture
def discovery_server(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A discovery server, which all nodes and programs that start from now on use."""
    port = free_port()
    monkeypatch.setenv("ROS_DISCOVERY_SERVER", f"127.0.0.1:{port}")
    server = subprocess.Popen(documented_server(port), stdout=subprocess.DEVNULL)
    yield
    server.kill()
    server.wait()


@pytest.fixture
def agent(discovery_server: None, domain: int, simulator: SimulatorThread) -> Iterator[Program]:
    program = Program(domain, "-p", "ip:=127.0.0.1", "-p", f"port:={simulator.port}")
    try:
        program.wait_says("connected to")
        yield program
    finally:
        program.process.kill()
        program.process.wait()


@pytest.fixture
def start_client(domain: int) -> Iterator[Callable[[str], Client]]:
    """Function that starts a node with the environment of its moment."""
    clients: list[Client] = []

    def start(name: str) -> Client:
        clients.append(Client(domain, name=name))
        return clients[-1]

    yield start
    for client in clients:
        client.close()


def test_a_client_of_the_discovery_server_uses_the_agent(
    agent: Program, start_client: Callable[[str], Client], simulator: SimulatorThread
) -> None:
    setting = start_client("client").call(Setting, "robot/Setting").info
    assert setting.identity.name == str(simulator.call(lambda server: server.chassis.robot_id))


def test_a_node_without_the_discovery_server_does_not_find_the_agent(
    agent: Program, start_client: Callable[[str], Client], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("ROS_DISCOVERY_SERVER")
    alone, _other = start_client("alone"), start_client("other")
    # The two nodes find each other, so they would have found the agent too.
    wait_until(lambda: "other" in alone.node.get_node_names(), "the node")
    assert not alone.node.count_services(SETTING)


def test_only_a_super_client_sees_what_it_does_not_use(
    agent: Program, start_client: Callable[[str], Client], monkeypatch: pytest.MonkeyPatch
) -> None:
    usual = start_client("usual")
    usual.call(PoseSpeed, "robot/PoseSpeed")
    monkeypatch.setenv("ROS_SUPER_CLIENT", "TRUE")
    onlooker = start_client("onlooker")
    wait_until(lambda: onlooker.node.count_services(SETTING), "the service")
    assert not usual.node.count_services(SETTING)
