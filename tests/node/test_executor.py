"""The executor keeps its rules, over real DDS, with few entities and with idle ones."""

from __future__ import annotations

import gc
import logging
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing
from typing import Any

import pytest
import rclpy
import rclpy.timer
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import Int32
from std_srvs.srv import Trigger

from tests.harness import TIMEOUT, wait_until
from woosh_robot_agent.ros.bridge import DeferredService, Reply
from woosh_robot_agent.ros.entities import Kind, UrgentCallbackGroup, WaitSet, Watched
from woosh_robot_agent.ros.executor import Executor
from woosh_robot_agent.testing.agents import Spinner

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
        self._spinner: Spinner | None = None
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

    def guard(self, name: str, callback: Any = None, **options: Any) -> Any:
        """Create a guard condition."""
        return self.node.create_guard_condition(callback or self.named(name), **options)

    def _wait_ready(self, entity: Any, kind: Kind) -> None:
        if self._spinner is None:
            assert WaitSet(self.context, [Watched(entity, kind)]).wait(int(TIMEOUT * SECOND))

    def client(self, name: str, **options: Any) -> Any:
        """Return a client of a service, in the node that is spun."""
        client = self.node.create_client(Trigger, name, **options)
        wait_until(client.service_is_ready, name)
        return client

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

    def start(self) -> None:
        """Spin in a thread until the end of the test."""
        self._spinner = Spinner(self.executor)

    def close(self) -> None:
        if self._spinner is not None:
            self._spinner.stop()
        self.executor.shutdown()
        for node in (self.node, self.other):
            node.destroy_node()
        rclpy.try_shutdown(context=self.context)


@pytest.fixture(params=[0, MANY], ids=["few", "many"])
def rig(request: pytest.FixtureRequest, domain: int) -> Iterator[Rig]:
    with closing(Rig(domain, request.param)) as started:
        yield started


@pytest.fixture
def busy_rig(domain: int) -> Iterator[Rig]:
    """A rig with many entities."""
    with closing(Rig(domain, MANY)) as started:
        yield started


@pytest.fixture
def waits(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """The number of waits that have begun, by the name of the thread."""
    counts: Counter[str] = Counter()
    wait = WaitSet.wait

    def counted(wait_set: WaitSet, timeout: int) -> list[Watched]:
        counts[threading.current_thread().name] += 1
        return wait(wait_set, timeout)

    monkeypatch.setattr(WaitSet, "wait", counted)
    return counts


MAIN = threading.main_thread().name


# The order of a turn


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


def test_services_with_many_requests_take_turns(rig: Rig) -> None:
    makes = [rig.service("a"), rig.service("b")]
    rig.use(*makes)

    def take_turns() -> bool:
        rig.end_turn()
        rig.ran.clear()
        for make in makes * 3:
            make()
        return rig.spin(6) == [*"ababab"]

    wait_until(take_turns)  # DDS may deliver a request late


def test_a_turn_with_many_requests_ends(rig: Rig) -> None:
    """A service with a request after each other does not keep other entities from running."""
    call = rig.service(
        "service", lambda _, response: (rig.ran.append("service"), call(), response)[2]
    )
    publish = rig.subscription("subscription")
    rig.use(publish)
    call()
    rig.spin(1)
    publish()
    rig.spin_until(lambda: "subscription" in rig.ran)


# Which entities are in use


def test_an_entity_that_was_ready_is_not_idle(busy_rig: Rig, waits: Counter[str]) -> None:
    call = busy_rig.service("service")
    busy_rig.use(call)
    wait_until(lambda: busy_rig.executor.spin_once(QUIET) or waits[IDLE])
    before = waits[IDLE]
    for number in range(1, 20):
        call()
        assert len(busy_rig.spin(1)) == number
    assert waits[IDLE] == before


def test_entities_that_are_no_longer_used_become_idle_and_still_run(busy_rig: Rig) -> None:
    makes = [busy_rig.subscription(f"topic_{number}") for number in range(60)]
    for _ in range(3):
        busy_rig.use(*makes)
    makes[0]()
    assert busy_rig.spin(1) == ["topic_0"]


def test_events_of_an_idle_subscription_run(rig: Rig) -> None:
    """Defaults of rclpy: a publisher with an incompatible profile is reported in the log."""
    rig.subscription("topic")
    handlers = [h for each in rig.node.subscriptions for h in each.event_handlers]
    assert handlers
    for handler in handlers:
        handler.callback = rig.named("event")
    profile = QoSProfile(depth=1, reliability=rclpy.qos.ReliabilityPolicy.BEST_EFFORT)
    rig.other.create_publisher(Int32, "topic", profile)
    rig.spin_until(lambda: rig.ran == ["event"])


def test_a_defect_of_the_second_thread_is_logged_and_nothing_is_lost(
    busy_rig: Rig, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
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
    makes = [busy_rig.subscription(f"topic_{number}") for number in range(30)]
    busy_rig.use(*makes)
    assert failed.is_set()
    assert "mistake" in caplog.text
    busy_rig.use(*makes)


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


def test_two_nodes(rig: Rig) -> None:
    second = Node("second", context=rig.context)
    second.create_service(Trigger, "second", rig.named("second"))
    assert rig.executor.add_node(second)
    assert not rig.executor.add_node(second)
    client = rig.client("second")
    assert _called(rig, client).success
    rig.executor.remove_node(second)
    client.call_async(Trigger.Request())
    assert rig.spin_quietly() == ["second"]
    other = Executor(context=rig.context)  # a node can move
    other.add_node(second)
    other.spin_once(TIMEOUT)
    assert rig.ran == ["second", "second"]
    other.shutdown()
    second.destroy_node()


def test_shutdown_of_the_context_ends_spin(rig: Rig) -> None:
    threading.Timer(QUIET, rclpy.try_shutdown, kwargs={"context": rig.context}).start()
    with pytest.raises(ExternalShutdownException):
        rig.executor.spin_once(TIMEOUT)


def test_the_second_thread_ends(busy_rig: Rig) -> None:
    def ended() -> bool:
        return IDLE not in {thread.name for thread in threading.enumerate()}

    busy_rig.spin_quietly()
    assert not ended()
    busy_rig.executor.shutdown()
    assert ended()
    forgotten = Executor(context=busy_rig.context)
    forgotten.add_node(busy_rig.node)
    forgotten.spin_once(0.0)
    assert not ended()
    del forgotten
    gc.collect()
    wait_until(ended)


# Waking up, and not spinning


def test_another_thread_wakes_it(rig: Rig) -> None:
    guard = rig.guard("guard")
    publish = rig.subscription("topic")
    rig.start()
    for wake in (guard.trigger, lambda: rig.executor.create_task(rig.named("task")), publish):
        rig.ran.clear()
        wake()
        wait_until(lambda: rig.ran)


def test_it_waits_while_nothing_is_ready(rig: Rig, waits: Counter[str]) -> None:
    rig.use(rig.service("service"), rig.subscription("subscription"), rig.guard("guard").trigger)
    rig.spin_quietly()
    waits.clear()
    for _ in range(3):
        rig.spin_quietly()
    assert waits == {MAIN: 3}


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


def test_timers(rig: Rig) -> None:
    timer = rig.node.create_timer(0.01, rig.named("timer"))
    assert rig.spin(5) == ["timer"] * 5
    timer.cancel()
    assert rig.spin_quietly() == ["timer"] * 5
    timer.reset()
    rig.spin(1)
    rig.node.destroy_timer(timer)
    assert rig.spin_quietly() == ["timer"] * 6


def test_messages_with_information_and_raw_messages(rig: Rig) -> None:
    received: list[Any] = []
    publish = rig.subscription("topic", lambda _message, info: received.append(info))
    publish()
    rig.subscription("raw", received.append, raw=True)()
    rig.spin_until(lambda: len(received) == 2)
    info, raw = sorted(received, key=lambda each: isinstance(each, bytes))
    assert info["source_timestamp"] > 0
    assert isinstance(raw, bytes)


def _called(rig: Rig, client: Any) -> Any:
    """Call a service and spin until the response is there; return it."""
    future = client.call_async(Trigger.Request())
    rig.spin_until(future.done)
    return future.result()


def test_a_client(rig: Rig) -> None:
    rig.service("service")
    client = rig.client("service")
    assert _called(rig, client).success
    done: list[Any] = []
    client.call_async(Trigger.Request()).add_done_callback(
        lambda _: done.append(threading.current_thread())
    )
    rig.start()
    wait_until(lambda: done)
    assert done[0].name == "spinner"


def test_a_deferred_service(rig: Rig) -> None:
    replies: list[Reply] = []
    DeferredService(rig.node, Trigger, "service", lambda _, reply: replies.append(reply))
    client = rig.client("service")
    future = client.call_async(Trigger.Request())
    rig.spin_until(lambda: replies)
    assert not future.done()
    thread = threading.Thread(target=replies[0].send, args=(Trigger.Response(message="late"),))
    thread.start()
    rig.spin_until(future.done)
    thread.join()
    assert future.result().message == "late"


def test_a_deferred_service_refuses_another_executor(rig: Rig) -> None:
    DeferredService(rig.other, Trigger, "service", lambda *_: None)
    client = rig.client("service")
    client.call_async(Trigger.Request())
    executor = SingleThreadedExecutor(context=rig.context)
    executor.add_node(rig.other)
    with pytest.raises(TypeError, match=r"woosh_robot_agent\.ros\.executor\.Executor"):
        executor.spin_once(timeout_sec=TIMEOUT)
    executor.shutdown()


def test_a_task_that_creates_another_one_does_not_hold_up_the_others(rig: Rig) -> None:
    def again() -> None:
        rig.executor.create_task(again)

    publish = rig.subscription("topic")
    again()
    publish()
    rig.spin_until(lambda: rig.ran)
