"""The SROS2 policies match the endpoints, and the agent runs with SROS2 if it is installed."""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as xml

import pytest
from action_msgs.msg import GoalStatus
from nav2_msgs import action as nav2_actions
from nav2_msgs import msg as nav2_messages
from nav2_msgs import srv as nav2_services

from scripts import sros2_policies
from tests.harness import HUMBLE, Client, RunningAgent, wait_until
from tests.node.goals import replace_answers
from tests.node.nav2.goals import Nav2Client, ahead
from woosh_robot_agent.pb.map.map_pack_pb2 import DownloadResponse
from woosh_robot_agent.ros.standard_endpoints import NAV2, Kind
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.testing import AgentProcess, running_chassis

ROOT = Path(__file__).parents[2]
LARGE = 5_000_000
"""Size of the map that the chassis sends, in bytes."""
EVERY_ROS_NODE = {"ros_discovery_info"}
"""Topics of the middleware, which SROS2 adds to all permissions."""


def permissions(policy: str) -> dict[str, set[str]]:
    """Return the DDS topics that a policy allows, translated as SROS2 does.

    Without those of a service that each node has since Jazzy, on Humble.
    """
    out: dict[str, set[str]] = {"publish": set(), "subscribe": set()}

    def allow_service(name: str, asks: str, answers: str) -> None:
        out[asks].add(f"rq{name}Request")
        out[answers].add(f"rr{name}Reply")

    def allow_action(name: str, asks: str, answers: str) -> None:
        for service in ("send_goal", "cancel_goal", "get_result"):
            allow_service(f"{name}/_action/{service}", asks, answers)
        for topic in ("feedback", "status"):
            out[answers].add(f"rt{name}/_action/{topic}")

    for group in xml.fromstring(policy).findall(".//profile/*"):
        (operation,) = group.attrib
        for element in group:
            name = str(element.text)
            if HUMBLE and name.endswith("/get_type_description"):
                continue
            if group.tag == "topics":
                out[operation].add(f"rt{name}")
            elif operation in ("request", "reply"):
                allow_service(
                    name, *(("publish", "subscribe")[:: 1 if operation == "request" else -1])
                )
            else:
                allow_action(name, *(("publish", "subscribe")[:: 1 if operation == "call" else -1]))
    return out


OF_OTHER_RELEASES = [
    f"/{each.name}/_action/" if each.kind is Kind.ACTION else f"/{each.name}Re"
    for each in NAV2
    if each.type.startswith("nav2_msgs/")
    and not any(
        hasattr(module, each.type.partition("/")[2])
        for module in (nav2_actions, nav2_services, nav2_messages)
    )
]
"""Parts of the names of Nav2's actions and services that this release of ROS lacks."""


def used(client: Client, node: str, namespace: str) -> dict[str, set[str]]:
    """Return the DDS topics that a node publishes and subscribes to."""
    graph: Any = client.node
    found = {
        "publish": graph.get_publisher_names_and_types_by_node(node, namespace, True),
        "subscribe": graph.get_subscriber_names_and_types_by_node(node, namespace, True),
    }
    return {
        operation: {name for name, _ in names} - EVERY_ROS_NODE
        for operation, names in found.items()
    }


def test_the_agent_has_exactly_what_its_policy_allows(
    start_agent: Callable[..., RunningAgent], client: Client
) -> None:
    start_agent(ip="127.0.0.1", port=1, publish_tf=True, nav2=True)
    # from the first goal in another frame on, the agent subscribes to /tf
    Nav2Client(client, "navigate_to_pose", pose=ahead(1.0, "nowhere"))
    policy = permissions(sros2_policies.agent_policy())
    allowed = {
        operation: {name for name in names if not any(each in name for each in OF_OTHER_RELEASES)}
        for operation, names in policy.items()
    }

    def seen() -> bool:
        nodes = client.node.get_node_names_and_namespaces()
        return ("agent", "/woosh_robot") in nodes and allowed == used(
            client, "agent", "/woosh_robot"
        )

    try:
        wait_until(seen, "the graph")
    except AssertionError:
        assert used(client, "agent", "/woosh_robot") == allowed


def test_every_node_has_the_endpoints_that_the_policy_assumes(client: Client) -> None:
    nothing = permissions(sros2_policies.client_policy(read_only=True, only=["robot/General"]))
    nothing["publish"].remove("rq/woosh_robot/robot/GeneralRequest")
    nothing["subscribe"].remove("rr/woosh_robot/robot/GeneralReply")
    wait_until(lambda: used(client, "client", "/") == nothing, "the endpoints of a node")


def test_policies_of_agent_and_client_match() -> None:
    agent = permissions(sros2_policies.agent_policy())
    client = permissions(sros2_policies.client_policy())
    common = {"rt/rosout", "rt/parameter_events"}

    def of_the_robot(names: set[str]) -> set[str]:
        return {name for name in names - common if "/client/" not in name and "/agent/" not in name}

    published, subscribed = of_the_robot(agent["publish"]), of_the_robot(agent["subscribe"])
    assert of_the_robot(client["publish"]) <= subscribed
    assert of_the_robot(client["subscribe"]) <= published
    assert subscribed - of_the_robot(client["publish"]) <= published
    assert published <= of_the_robot(client["subscribe"])


needs_sros2 = pytest.mark.skipif(
    not (importlib.util.find_spec("sros2") and shutil.which("ros2")),
    reason="SROS2 is not installed (apt-get install ros-jazzy-sros2)",
)


@pytest.fixture
def keystore(domain: int, tmp_path: Path) -> Path:
    """Keys and permissions of the agent, of a client and of a display that may only read."""
    path = tmp_path / "keystore"
    make = [ROOT / "scripts" / "make_keystore", path]
    subprocess.run(make, check=True, timeout=100)
    subprocess.run([*make, "--node", "/display", "--", "--read-only"], check=True, timeout=100)
    return path


@pytest.fixture
def secured(keystore: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Enforce security in the processes that are started from now on."""
    monkeypatch.setenv("ROS_SECURITY_KEYSTORE", str(keystore))
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    monkeypatch.setenv("ROS_SECURITY_STRATEGY", "Enforce")


@needs_sros2
@pytest.mark.timeout(900)
def test_agent_and_clients_work_under_sros2(
    domain: int, client: Client, secured: None, tmp_path: Path
) -> None:
    """`client` is started without security, so it must not see the agent."""
    from woosh_robot_msgs.srv import PoseSpeed

    with running_chassis() as chassis:
        give_large_map(chassis)
        agent = AgentProcess(
            domain,
            "/woosh_robot",
            *("--enclave", "/woosh_robot/agent"),
            ip="127.0.0.1",
            port=chassis.port,
        )
        try:
            wait_until(lambda: "connected to " in agent.output or agent.process.poll() is not None)
            if "doesn't have the security libraries" in agent.output:
                pytest.skip("the middleware was built without security")
            agent.wait_connected()
            reads = ["service", "topic", "scan True", "map True", f"download True {LARGE}"]
            said = run("display", tmp_path)
            assert said[:5] == reads
            assert refused(said[5:]) == [
                "robot/SwitchControlMode",
                "robot/ExecTask",
                "task",
                "cmd_vel",
                "set_parameters",
            ]
            said = run("client", tmp_path)
            assert said[:6] == [*reads, f"task {GoalStatus.STATUS_SUCCEEDED} True"]
            assert refused(said[6:]) == ["set_parameters"]
            outsider = client.node.create_client(PoseSpeed, "/woosh_robot/robot/PoseSpeed")
            assert not outsider.service_is_ready()
        finally:
            agent.close()


def give_large_map(chassis: SimulatorThread) -> None:
    """Let the chassis answer map/Download with a file of `LARGE` bytes."""
    scene = DownloadResponse()
    scene.file_datas.add(name="map.png", data=bytes(LARGE))
    name = "woosh.map.Download"
    replace_answers(chassis, name, ok=True, msg="", type=f"{name}Response", body=scene)


def run(role: str, folder: Path) -> list[str]:
    """Run the client with the keys of its role; return the lines that it wrote."""
    said = folder / role
    done = subprocess.run(
        [
            *(sys.executable, "-m", "tests.node.secured_client", role, said),
            *("--ros-args", "--enclave", f"/woosh_robot/{role}"),
        ],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return said.read_text().splitlines()


def refused(lines: list[str]) -> list[str]:
    """Return what was refused; fail if something was not."""
    words = [line.split() for line in lines]
    assert all(each[1] == "refused" for each in words), lines
    return [each[0] for each in words]
