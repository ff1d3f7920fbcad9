"""The table of endpoints matches the facts, and the agent offers each one."""

from __future__ import annotations

from contextlib import closing
from typing import Any

import pytest
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

from tests.fact_files import facts
from tests.harness import HUMBLE, Client, wait_until
from tests.tooling.interface_facts import HASHES
from woosh_robot_agent.endpoints import ACTIONS, AGENT_INFO, COMMANDS, QUERIES, TOPICS

FACTS = facts("endpoints.yaml")
TWICE = "setting/SetIdentity"
"""Second name of setting/Identity; the facts have it only in a comment."""


def test_table_matches_the_facts():
    queries = {e.name: {"srv": e.srv, "request": e.request} for e in QUERIES if not e.extra}
    assert queries == FACTS["info_services"]
    commands = {}
    for e in COMMANDS:
        if e.extra:
            continue
        commands[e.name] = {"srv": e.srv, "request": e.request}
        if e.answer:
            commands[e.name]["answer"] = e.answer
    assert commands.pop(TWICE) == commands["setting/Identity"]
    assert commands == FACTS["command_services"]
    topics = {e.name: {"msg": e.msg, "push": e.push} for e in TOPICS if not e.extra}
    assert topics == FACTS["topics"]
    actions = [e for e in ACTIONS if not e.extra]
    assert {e.name: (e.action, e.feedback) for e in actions} == {
        name: (fact["action"], fact["feedback"].replace("Feedbacks", "Feedback"))
        for name, fact in FACTS["actions"].items()
    }
    for e in actions:
        fact = FACTS["actions"][e.name]["request"]
        assert fact == (f"woosh.ros.CallAction{{{e.member}}}" if e.member else e.arg)


@pytest.mark.parametrize("namespace", ["", "/site/robot_7"])
def test_all_endpoints_exist_with_their_types_and_qos(namespace, start_agent, domain):
    start_agent(ip="127.0.0.1", port=1, namespace=namespace)
    with closing(Client(domain, namespace)) as watcher:
        check_graph(watcher.node, namespace)


def check_graph(node: Any, namespace: str) -> None:
    wait_until(lambda: ("agent", namespace or "/") in node.get_node_names_and_namespaces())

    def offered(names_and_types: Any) -> dict[str, str]:
        """Return types of the agent's endpoints by relative name, without those of any node."""
        prefix = f"{namespace}/"
        return {
            name.removeprefix(prefix): types[0]
            for name, types in names_and_types("agent", namespace or "/")
            if "woosh_" in types[0] and "/_action/" not in name
        }

    services = {e.name: e.srv.replace("/", "/srv/") for e in (*QUERIES, *COMMANDS)}
    wait_until(lambda: offered(node.get_service_names_and_types_by_node) == services, "services")
    topics = {e.name: e.msg.replace("/", "/msg/") for e in (*TOPICS, AGENT_INFO)}
    wait_until(lambda: offered(node.get_publisher_names_and_types_by_node) == topics, "topics")
    for topic in TOPICS:
        (info,) = node.get_publishers_info_by_topic(f"{namespace}/{topic.name}")
        assert info.qos_profile.reliability == ReliabilityPolicy.RELIABLE
        assert info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
        if not HUMBLE and (not topic.extra or topics[topic.name] in HASHES):
            assert str(info.topic_type_hash) == HASHES[topics[topic.name]]
    for action in ACTIONS:
        feedback = f"{namespace}/{action.name}/_action/feedback"
        wait_until(lambda feedback=feedback: node.count_publishers(feedback) == 1, feedback)
