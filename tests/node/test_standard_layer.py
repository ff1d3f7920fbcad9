"""The standard layer as a whole: its endpoints and its switches."""

from __future__ import annotations

import time
from typing import Any

import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan

from tests.harness import Client, Logs, wait_until
from tests.node.test_parameters import change
from woosh_robot_agent.parameters import PARTS, StandardSettings
from woosh_robot_agent.ros.standard import diagnostics
from woosh_robot_agent.ros.standard_endpoints import STANDARD, Kind

PART_OF = {
    "/tf": "tf",
    "/tf_static": "tf",
    "/diagnostics": "diagnostics",
    "keepout_mask": "map",
    "cancel": "goal_pose",
}
"""Parts of the topics and services that are not named like their part."""


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


@pytest.mark.parametrize(
    "used", [PARTS[::2], PARTS[1::2], ["tf"]], ids=["one half", "the other half", "tf"]
)
def test_each_part_can_be_used_without_others(used, start_agent, client):
    off = [each for each in PARTS if each not in used]
    start_agent(ip="127.0.0.1", port=1, disabled_parts=off, publish_tf="tf" in used)
    names = {entry.name for entry in STANDARD}
    wait_for_endpoints(client, {name for name in names if PART_OF.get(name, name) in used})


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
    arrays = client.echo_with(DiagnosticArray, "/diagnostics", QoSProfile(depth=10))
    (status,) = [each for each in arrays.wait_count(1)[0].status if each.name.endswith(": clock")]
    assert status.level >= DiagnosticStatus.WARN
    assert "no time has come on /clock" in status.message
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


def test_invalid_frames_are_refused():
    for name in ("map_frame", "odom_frame", "base_frame", "scan_frame"):
        for bad in ("/map", ""):
            with pytest.raises(ValueError, match=name):
                StandardSettings(**{name: bad})
