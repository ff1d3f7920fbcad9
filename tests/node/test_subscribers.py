"""Topics without subscribers are not published; new subscribers get a message soon."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PolygonStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile

from tests.harness import Client, Collector, RunningAgent, wait_until
from woosh_robot_agent.ros import subscribers
from woosh_robot_agent.ros.releases import UnsupportedEventTypeError
from woosh_robot_agent.ros.standard.odom import Odom


@pytest.fixture
def published(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """Number of messages published in this process, by topic."""
    counts: Counter[str] = Counter()
    publish = Publisher.publish

    def count(publisher: Publisher, message: Any) -> None:
        counts[publisher.topic] += 1
        publish(publisher, message)

    monkeypatch.setattr(Publisher, "publish", count)
    return counts


@pytest.fixture
def created(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """Number of publishers created in this process, by topic."""
    counts: Counter[str] = Counter()
    create = Node.create_publisher

    def count(node: Node, message_class: Any, topic: str, *arguments: Any, **options: Any) -> Any:
        counts[topic] += 1
        return create(node, message_class, topic, *arguments, **options)

    monkeypatch.setattr(Node, "create_publisher", count)
    return counts


@pytest.fixture(params=[True, False], ids=["events", "a middleware without matched events"])
def start(
    request: pytest.FixtureRequest,
    published: Counter[str],
    created: Counter[str],
    connect: Callable[..., RunningAgent],
    monkeypatch: pytest.MonkeyPatch,
) -> Callable[..., RunningAgent]:
    if not request.param:

        def refuse(*_arguments: Any) -> Any:
            raise UnsupportedEventTypeError("no such event")

        monkeypatch.setattr(subscribers, "subscriber_event_handlers", refuse)

    def start(**parameters: Any) -> RunningAgent:
        return connect(publish_tf=True, **parameters)

    return start


def listen(client: Client, msg: Any, name: str) -> tuple[Collector, Callable[[], None]]:
    """Subscribe to a topic; return the collector of its messages, and a function to unsubscribe."""
    collector = Collector()
    subscription = client.node.create_subscription(
        msg, client.path(name), collector.add, QoSProfile(depth=10)
    )
    return collector, lambda: client.unsubscribe(subscription)


def test_topics_are_published_only_while_there_are_subscribers(
    start: Callable[..., RunningAgent],
    client: Client,
    published: Counter[str],
    created: Counter[str],
) -> None:
    start()
    # subscribers may not discover a publisher that follows a destroyed one of the same topic
    assert created["/diagnostics"] == created["odom"] == 1
    del created["/parameter_events"]  # of the agent and of the client
    assert {topic: number for topic, number in created.items() if number > 1} == {}
    wait_until(lambda: published["footprint"], "the first value, which is latched")
    assert published["/diagnostics"] == 0
    received, leave = listen(client, DiagnosticArray, "/diagnostics")
    received.wait_count(3)  # meanwhile, 20 messages on odom and 2 on footprint are due
    leave()
    assert published["odom"] == published["/tf"] == 0
    assert published["footprint"] == 1
    for msg, name in (
        (Odometry, "odom"),
        (DiagnosticArray, "/diagnostics"),
        (PolygonStamped, "footprint"),
        (Odometry, "odom"),
    ):
        received, leave = listen(client, msg, name)
        received.wait_count(2)
        leave()
        wait_quiet(client, published, name)


def wait_quiet(client: Client, published: Counter[str], name: str) -> None:
    """Wait until a topic is silent for longer than its period."""

    def quiet() -> bool:
        before = published[name]
        pass_a_period(client, name)
        return published[name] == before

    wait_until(quiet, f"an end of {name}")


def pass_a_period(client: Client, name: str) -> None:
    """Receive another topic for longer than the period of `name`.

    odom is published at 20 Hz, footprint at 2 Hz, and /diagnostics at 1 Hz.
    """
    if name == "odom":
        received, leave = listen(client, PolygonStamped, "footprint")
        received.wait_count(3)
    else:
        received, leave = listen(client, Odometry, "odom")
        received.wait_count(25)
    leave()


def test_odom_is_published_as_soon_as_it_has_a_subscriber(
    connect: Callable[..., RunningAgent], client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first message does not wait for the next period, which is beyond the end of this test."""
    monkeypatch.setattr(Odom, "_rate", lambda _: 0.001)
    connect()
    diagnostics, _ = listen(client, DiagnosticArray, "/diagnostics")
    diagnostics.wait_count(2)  # the first period of odom would have begun
    listen(client, Odometry, "odom")[0].wait_count(1)
