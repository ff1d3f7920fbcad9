"""The standard layer as a whole: its endpoints, its switches, and two robots in one domain."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan
from tf2_msgs.msg import TFMessage

from tests.harness import Client, Logs, RunningAgent, wait_until
from tests.node.cmd_vel import Sender
from tests.node.test_parameters import change
from tests.quick_chassis import quick_config
from woosh_robot_agent.parameters import PARTS, StandardSettings
from woosh_robot_agent.ros.standard import diagnostics
from woosh_robot_agent.ros.standard_endpoints import STANDARD, Kind
from woosh_robot_agent.simulator import SimulatorThread

TWIST = "woosh.robot.Twist"


def endpoints(client: Client) -> dict[str, Any]:
    """Return the agent's endpoints by name, with the type of a service or the info of a topic."""
    found: dict[str, Any] = {}
    node = client.node
    if ("agent", client.namespace) not in node.get_node_names_and_namespaces():
        return found  # not discovered yet
    services = dict(node.get_service_names_and_types_by_node("agent", client.namespace))
    for entry in STANDARD:
        path = client.path(entry.name)
        if entry.kind is Kind.SERVICE:
            if path in services:
                found[entry.name] = services[path][0].replace("/srv/", "/")
            continue
        ask = (
            node.get_subscriptions_info_by_topic
            if entry.kind is Kind.INPUT
            else node.get_publishers_info_by_topic
        )
        mine = [i for i in ask(path) if i.node_name == "agent"]
        if mine:
            found[entry.name] = mine[0]
    return found


def wait_for_endpoints(client: Client, wanted: set[str]) -> dict[str, Any]:
    """Wait until the agent has exactly these endpoints; return them, as `endpoints` does."""
    found: dict[str, Any] = {}

    def is_complete() -> bool:
        nonlocal found
        found = endpoints(client)
        return set(found) == wanted

    try:
        wait_until(is_complete)
    except AssertionError:
        missing, extra = sorted(wanted - set(found)), sorted(set(found) - wanted)
        pytest.fail(f"the endpoints of the agent: missing {missing}, too many {extra}")
    return found


def test_the_agent_has_all_endpoints_of_the_table(start_agent, client):
    start_agent(ip="127.0.0.1", port=1, publish_tf=True)
    found = wait_for_endpoints(client, {entry.name for entry in STANDARD})
    for entry in STANDARD:
        if entry.kind is Kind.SERVICE:
            assert found[entry.name] == entry.type
            continue
        info = found[entry.name]
        assert info.topic_type.replace("/msg/", "/") == entry.type
        latched = info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
        assert latched == (entry.kind is Kind.LATCHED)
        # REP 2003: best-effort subscribers are compatible with a reliable publisher
        assert info.qos_profile.reliability == ReliabilityPolicy.RELIABLE


def test_all_parts_can_be_switched_off(start_agent, client):
    start_agent(ip="127.0.0.1", port=1, disabled_parts=list(PARTS))
    wait_until(lambda: client.publishers("robot/PoseSpeed"), "the agent")
    assert not endpoints(client)


@pytest.mark.parametrize("part", [*PARTS, "tf"])
def test_each_part_can_be_used_alone(part, start_agent, client):
    off = [each for each in PARTS if each != part]
    start_agent(ip="127.0.0.1", port=1, disabled_parts=off, publish_tf=part == "tf")
    wait_for_endpoints(client, {entry.name for entry in STANDARD if entry.part == part})


def test_a_part_that_failed_runs_again(
    monkeypatch: pytest.MonkeyPatch, start_agent: Any, client: Client, logs: Logs
) -> None:
    link_status = diagnostics.link_status
    failures = iter([ZeroDivisionError("once")])

    def fail_once(*arguments: Any) -> Any:
        for error in failures:
            raise error
        return link_status(*arguments)

    monkeypatch.setattr(diagnostics, "link_status", fail_once)
    start_agent(ip="127.0.0.1", port=1)
    client.echo_with(DiagnosticArray, "/diagnostics", QoSProfile(depth=10)).wait_count(2)
    restarts = logs.with_text("restarting it")
    assert [str(each.exc_info[1]) for each in restarts] == ["once"]


def test_stamps_follow_the_parameter_use_sim_time(connect, client):
    connect(use_sim_time=True)
    clock = client.publisher(Clock, "/clock")
    now = Clock(clock=Time(sec=100))
    # a message is lost if the agent has not discovered the publisher yet
    client.in_executor(lambda: client.node.create_timer(0.1, lambda: clock.publish(now)))
    scans = client.echo_with(LaserScan, "scan", QoSProfile(depth=10))
    scans.wait(lambda scan: scan.header.stamp.sec == 99)  # between request and answer
    odom = client.echo_with(Odometry, "odom", QoSProfile(depth=10))
    odom.wait(lambda message: message.header.stamp == Time(sec=100))
    change(client, use_sim_time=False)
    odom.wait(lambda message: abs(message.header.stamp.sec - time.time()) < 10.0)


@pytest.mark.parametrize("name", ["map_frame", "odom_frame", "base_frame", "scan_frame"])
def test_invalid_frames_are_refused(name):
    for bad in ("/map", ""):
        with pytest.raises(ValueError, match=name):
            StandardSettings(**{name: bad})


class TestTwoRobots:
    @pytest.fixture
    def robots(self, domain: int) -> Iterator[list[tuple[SimulatorThread, RunningAgent, Client]]]:
        """Two robots in one domain, each with its own agent, namespace and frame prefix."""
        running = []
        for name in ("r1", "r2"):
            config = quick_config(port=0, tcp_port=0, speed=5, seed=1)
            simulator = SimulatorThread(config).__enter__()
            agent = RunningAgent(
                domain,
                f"/{name}",
                ip="127.0.0.1",
                port=simulator.port,
                publish_tf=True,
                frame_prefix=f"{name}/",
            )
            running.append((simulator, agent, Client(domain, f"/{name}")))
        yield running
        for simulator, agent, client in running:
            client.close()
            agent.close()
            simulator.__exit__(None, None, None)

    def test_each_robot_has_its_own_velocities_and_frames(self, robots):
        for _, agent, _ in robots:
            agent.wait_connected()
        (one, _, first), (two, _, second) = robots
        frames = first.echo_with(TFMessage, "/tf", QoSProfile(depth=100))
        odoms = [
            client.echo_with(Odometry, "odom", QoSProfile(depth=10)) for client in (first, second)
        ]
        for odom in odoms:
            odom.wait_count(1)
        sender = Sender(first)
        sender.repeat(10.0, turn=0.5)
        one.wait_received(TWIST)
        odoms[0].wait(lambda m: m.twist.twist.angular.z > 0.0)
        sender.pause()
        odoms[1].wait_count(3)
        assert two.counts[TWIST] == 0
        assert not any(m.twist.twist.angular.z for m in odoms[1].messages)
        assert {m.header.frame_id for m in odoms[1].messages} == {"r2/odom"}
        for prefix in ("r1/", "r2/"):
            frames.wait(lambda m: m.transforms[0].header.frame_id == f"{prefix}map")  # noqa: B023
