"""The executor keeps its rules, over real DDS, while some entities are idle."""

from __future__ import annotations

import gc
import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import closing
from typing import Any

import pytest
import rclpy
import rclpy.timer
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import Int32
from std_srvs.srv import Trigger

from tests.harness import TIMEOUT, wait_until
from woosh_robot_agent.ros.entities import Kind, UrgentCallbackGroup, WaitSet, Watched
from woosh_robot_agent.ros.executor import Executor

MANY = 40
"""Number of further services of a node, so that some entities are idle."""
QUIET = 0.1
"""Time to spin when nothing should happen, in seconds."""
SECOND = 1_000_000_000
"""Nanoseconds in a second."""
IDLE = "idle entities"
"""Name of the thread that waits for idle entities."""
Make = Callable[[], None]
"""Makes an entity ready, and returns when it is."""


class Rig:
    """A node in an executor, and a node that nobody spins.

    Attributes:
        context: their context.
        executor: the executor.
        node: the node in it.
        other: the other node.
        ran: names of the callbacks that have run.
    """

    def __init__(self, domain: int, further: int) -> None:
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.executor = Executor(context=self.context)
        self.node = Node("spun", context=self.context)
        self.other = Node("other", context=self.context)
        self.ran: list[str] = []
        for number in range(further):
            self.node.create_service(Trigger, f"further_{number}", lambda _, response: response)
        self.executor.add_node(self.node)

    def named(self, name: str) -> Callable[..., Any]:
        """Return a callback that adds a name to `ran`."""

        def run(*_arguments: Any) -> Any:
            self.ran.append(name)
            return Trigger.Response(success=True)

        return run

    def service(self, name: str, callback: Any = None, **options: Any) -> Make:
        """Create a service; return a function that calls it."""
        service = self.node.create_service(
            Trigger,
            name,
            callback or self.named(name),
            qos_profile=QoSProfile(depth=100),
            **options,
        )
        client = self.other.create_client(Trigger, name)
        wait_until(client.service_is_ready, name)

        def call() -> None:
            client.call_async(Trigger.Request())
            self._wait_ready(service, Kind.SERVICE)

        return call

    def subscription(self, name: str, callback: Any = None, **options: Any) -> Make:
        """Create a subscription; return a function that publishes to it."""
        subscription = self.node.create_subscription(
            Int32, name, callback or self.named(name), 10, **options
        )
        publisher = self.other.create_publisher(Int32, name, 10)
        wait_until(publisher.get_subscription_count, name)

        def publish() -> None:
            publisher.publish(Int32())
            self._wait_ready(subscription, Kind.SUBSCRIPTION)

        return publish

    def guard(self, name: str) -> Any:
        """Create a guard condition."""
        return self.node.create_guard_condition(self.named(name))

    def _wait_ready(self, entity: Any, kind: Kind) -> None:
        assert WaitSet(self.context, [Watched(entity, kind)]).wait(int(TIMEOUT * SECOND))

    def use(self, *makes: Make) -> None:
        """Have each entity run once, so that none is idle."""
        for make in makes:
            make()
            self.spin(1)
        self.end_turn()
        self.ran.clear()

    def end_turn(self) -> None:
        """End the turn, in which entities may run again."""
        self.executor.spin_once(0.0)

    def spin(self, callbacks: int) -> list[str]:
        """Run a number of callbacks; return `ran`."""
        for _ in range(callbacks):
            self.executor.spin_once(TIMEOUT)
        return self.ran

    def spin_quietly(self) -> list[str]:
        """Spin for a short time; return `ran`."""
        self.executor.spin_once(QUIET)
        return self.ran

    def spin_until(self, condition: Callable[[], object]) -> None:
        """Run callbacks until a condition holds."""

        def turn() -> object:
            self.executor.spin_once(0.01)
            return condition()

        wait_until(turn)

    def close(self) -> None:
        self.executor.shutdown()
        for node in (self.node, self.other):
            node.destroy_node()
        rclpy.try_shutdown(context=self.context)


@pytest.fixture
def further() -> int:
    """Number of further services of the node."""
    return MANY


@pytest.fixture
def rig(domain: int, further: int) -> Iterator[Rig]:
    with closing(Rig(domain, further)) as started:
        yield started


# The order of a turn


@pytest.mark.parametrize("further", [0, MANY], ids=["few", "many"])
def test_order_of_a_turn(rig: Rig) -> None:
    makes = [
        rig.service("service"),
        rig.guard("guard").trigger,
        rig.subscription("subscription"),
        rig.service("urgent", callback_group=UrgentCallbackGroup()),
    ]
    rig.use(*makes)
    timer = rig.node.create_timer(0.001, lambda: (rig.ran.append("timer"), timer.cancel()))
    wait_until(timer.is_ready)
    for make in makes:
        make()
    rig.executor.create_task(rig.named("task"))
    assert rig.spin(6) == ["urgent", "task", "timer", "subscription", "guard", "service"]


def test_of_one_kind_the_one_that_has_not_run_longest_comes_first(rig: Rig) -> None:
    makes = {name: rig.subscription(name) for name in "abc"}
    rig.use(*makes.values())
    for name in "cab":
        makes[name]()
        rig.spin(1)
        rig.end_turn()
    for make in makes.values():
        make()
    assert rig.spin(3) == [*"cab", *"cab"]


def test_urgent_entities_wait_for_one_callback_at_most(rig: Rig) -> None:
    urgent = rig.subscription("urgent", callback_group=UrgentCallbackGroup())
    makes = [rig.subscription(name) for name in ("first", "second")]
    rig.use(urgent, *makes)
    for make in makes:
        make()
    assert rig.spin(1) == ["first"]
    urgent()
    assert rig.spin(2) == ["first", "urgent", "second"]


def test_a_flood_for_an_urgent_entity_holds_up_no_other(rig: Rig) -> None:
    again: list[Make] = []

    def flooded(_message: Any) -> None:
        rig.ran.append("flood")
        if again:
            again[0]()  # the next message is there before the next callback

    flood = rig.subscription("flood", flooded, callback_group=UrgentCallbackGroup())
    stop = rig.service("stop", callback_group=UrgentCallbackGroup())
    other = rig.subscription("other")
    rig.use(flood, stop, other)
    again.append(flood)
    flood()
    assert rig.spin(3) == ["flood"] * 3
    stop()
    other()
    # the flood may fill the rest of a turn, whose length is limited
    rig.spin_until(lambda: {"stop", "other"} <= set(rig.ran))
    again.clear()


# Which entities are in use


def test_a_defect_of_the_second_thread_is_logged_and_nothing_is_lost(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    wait = WaitSet.wait
    failed = threading.Event()

    def failing(wait_set: WaitSet, timeout: int) -> list[Watched]:
        if threading.current_thread().name == IDLE and not failed.is_set():
            failed.set()
            raise RuntimeError("mistake")
        return wait(wait_set, timeout)

    monkeypatch.setattr(logging.getLogger("woosh_robot_agent"), "propagate", True)
    monkeypatch.setattr(WaitSet, "wait", failing)
    makes = [rig.subscription(f"topic_{number}") for number in range(30)]
    rig.use(*makes)
    assert failed.is_set()
    assert "mistake" in caplog.text
    rig.use(*makes)


# Entities, nodes and the executor come and go


def test_what_is_destroyed_leaves_the_graph_when_nobody_spins(rig: Rig) -> None:
    for name in ("one", "other"):
        rig.use(rig.subscription(f"used_{name}"))
        rig.subscription(f"unused_{name}")
    rig.spin_quietly()

    def wait_left(name: str) -> None:
        for topic in (f"used_{name}", f"unused_{name}"):
            wait_until(lambda: not rig.other.count_subscribers(topic), "its end")  # noqa: B023

    for subscription in list(rig.node.subscriptions)[-4:-2]:
        rig.node.destroy_subscription(subscription)
    wait_left("one")
    rig.executor.remove_node(rig.node)
    rig.node.destroy_node()
    wait_left("other")


def test_an_entity_that_is_destroyed_in_its_turn_does_not_run(rig: Rig) -> None:
    def destroy(*_: Any) -> None:
        rig.node.destroy_subscription(list(rig.node.subscriptions)[-1])

    makes = [rig.subscription("first"), rig.subscription("second")]
    rig.use(*makes)
    for make in makes:
        make()
    rig.executor.create_task(destroy)
    assert rig.spin(2) == ["first"]
    assert rig.spin_quietly() == ["first"]


def test_shutdown_of_the_context_ends_spin(rig: Rig) -> None:
    threading.Timer(QUIET, rclpy.try_shutdown, kwargs={"context": rig.context}).start()
    with pytest.raises(ExternalShutdownException):
        rig.executor.spin_once(TIMEOUT)


def test_the_second_thread_ends(rig: Rig) -> None:
    def ended() -> bool:
        return IDLE not in {thread.name for thread in threading.enumerate()}

    rig.spin_quietly()
    assert not ended()
    rig.executor.shutdown()
    assert ended()
    forgotten = Executor(context=rig.context)
    forgotten.add_node(rig.node)
    forgotten.spin_once(0.0)
    assert not ended()
    del forgotten
    gc.collect()
    wait_until(ended)


# Callbacks


def test_an_exception_leaves_spin_once_and_the_rest_of_the_turn_follows(rig: Rig) -> None:
    def fail(*_: Any) -> None:
        raise RuntimeError("mistake")

    subscribe = rig.subscription("subscription", fail)
    subscribe()
    with pytest.raises(RuntimeError, match="mistake"):
        rig.spin(1)
    call = rig.service("service")
    rig.use(call)
    for turn in range(1, 4):
        subscribe()
        call()
        with pytest.raises(RuntimeError, match="mistake"):
            rig.spin(1)
        assert rig.spin(1) == ["service"] * turn
        rig.end_turn()

    rig.executor.create_task(fail)
    with pytest.raises(RuntimeError, match="mistake"):
        rig.spin(1)
