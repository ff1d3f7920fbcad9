"""What nobody subscribes to is not published, and who subscribes gets it soon."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PolygonStamped
from nav_msgs.msg import Odometry
from rclpy.event_handler import PublisherEventCallbacks, UnsupportedEventTypeError
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from tf2_msgs.msg import TFMessage

from tests.harness import Client, Collector, RunningAgent, wait_until
from woosh_robot_agent.parameters import EXECUTORS
from woosh_robot_agent.simulator import SimulatorThread

UNTOLD = "a middleware that tells of no subscribers"


@pytest.fixture
def published(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """How often each topic was published on, in this process."""
    counts: Counter[str] = Counter()
    publish = Publisher.publish

    def count(publisher: Publisher, message: Any) -> None:
        counts[publisher.topic] += 1
        publish(publisher, message)

    monkeypatch.setattr(Publisher, "publish", count)
    return counts


@pytest.fixture(params=[*EXECUTORS, UNTOLD])
def start(
    request: pytest.FixtureRequest,
    published: Counter[str],
    simulator: SimulatorThread,
    start_agent: Callable[..., RunningAgent],
    monkeypatch: pytest.MonkeyPatch,
) -> Callable[..., RunningAgent]:
    if request.param == UNTOLD:
        create = PublisherEventCallbacks.create_event_handlers

        def refuse(callbacks: Any, *arguments: Any) -> Any:
            if callbacks.matched:
                raise UnsupportedEventTypeError("no such event")
            return create(callbacks, *arguments)

        monkeypatch.setattr(PublisherEventCallbacks, "create_event_handlers", refuse)
    executor = EXECUTORS[0] if request.param == UNTOLD else request.param

    def start(**parameters: Any) -> RunningAgent:
        agent = start_agent(
            ip="127.0.0.1", port=simulator.port, executor=executor, publish_tf=True, **parameters
        )
        agent.wait_connected()
        return agent

    return start


def listen(client: Client, msg: Any, name: str) -> tuple[Collector, Callable[[], None]]:
    """What comes on a topic, and how to hear no more of it."""
    collector = Collector()
    subscription = client.node.create_subscription(
        msg, client.path(name), collector.add, QoSProfile(depth=10)
    )
    return collector, lambda: client.node.destroy_subscription(subscription)


def test_only_while_somebody_subscribes(
    start: Callable[..., RunningAgent], client: Client, published: Counter[str]
) -> None:
    start()
    wait_until(lambda: published["footprint"], "its first value, kept for whoever comes")
    threading.Event().wait(1.2)  # 24 odoms, 2 footprints and 1 /diagnostics
    assert published["odom"] == published["/tf"] == published["/diagnostics"] == 0
    assert published["footprint"] == 1
    for msg, name in (
        (Odometry, "odom"),
        (TFMessage, "/tf"),
        (DiagnosticArray, "/diagnostics"),
        (PolygonStamped, "footprint"),
        (Odometry, "odom"),
    ):
        received, leave = listen(client, msg, name)
        received.wait_count(2)
        leave()
        wait_quiet(published, name)


def wait_quiet(published: Counter[str], name: str) -> None:
    """Return when a topic was not published on for 1.2 s."""

    def quiet() -> bool:
        before = published[name]
        threading.Event().wait(1.2)
        return published[name] == before

    wait_until(quiet, f"an end of {name}")


def test_odom_comes_with_its_subscriber(start: Callable[..., RunningAgent], client: Client) -> None:
    """And not with the next beat of its rate, of which there is one in 10 s."""
    start(odom_rate=0.1)
    threading.Event().wait(0.5)  # the first beat is over, if there is one
    listen(client, Odometry, "odom")[0].wait_count(1, 5.0)
