"""The entities of nodes (subscriptions, services, ...) for the executor, and their wait sets."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Iterator
from enum import IntEnum
from functools import partial
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.exceptions import InvalidHandle

from woosh_robot_agent.ros import rclpy_private


class UrgentCallbackGroup(ReentrantCallbackGroup):
    """Group of entities whose callbacks run before all others."""


class DeferredCallback:
    """Callback of a service that replies later, from any thread, with `Service.send_response`.

    Args:
        handle: called with the request, and the header that `send_response` needs.
    """

    def __init__(self, handle: Callable[[Any, Any], None]) -> None:
        self.handle = handle

    def __call__(self, _request: Any, _response: Any) -> Any:
        raise TypeError("add this node to a woosh_robot_agent.ros.executor.Executor, to no other")


class Kind(IntEnum):
    """Kinds of entities, with rclpy's names, and in the order in which rclpy runs callbacks."""

    WAITABLE = 0
    TIMER = 1
    SUBSCRIPTION = 2
    GUARD_CONDITION = 3
    CLIENT = 4
    SERVICE = 5


def entities_of(node: Any) -> Iterator[tuple[Kind, Any]]:
    """Yield the entities of a node."""
    for kind, entities in (
        (Kind.WAITABLE, node.waitables),
        (Kind.TIMER, node.timers),
        (Kind.SUBSCRIPTION, node.subscriptions),
        (Kind.GUARD_CONDITION, node.guards),
        (Kind.CLIENT, node.clients),
        (Kind.SERVICE, node.services),
    ):
        for entity in entities:
            yield kind, entity


class Watched:
    """An entity of a node, as the executor watches it.

    Attributes:
        entity: rclpy's object.
        owner: this object; for an event of a subscription, the `Watched` of the subscription. An
            entity and its owner are idle together.
        is_urgent: True if the callback of the entity runs before all others.
        is_idle: True if the executor's second thread waits for the entity, or for its owner.
        is_present: False once the node has destroyed the entity, or has left the executor.
        last_turn: number of the turn in which the entity was last ready; 0 if it never was.
    """

    def __init__(self, entity: Any, kind: Kind) -> None:
        self.entity = entity
        self.kind = kind
        self.owner = self
        self.is_urgent = isinstance(entity.callback_group, UrgentCallbackGroup)
        self.is_idle = False
        self.is_present = True
        self.last_turn = 0
        self._takes_info = kind is Kind.SUBSCRIPTION and _takes_info(entity.callback)

    @property
    def may_idle(self) -> bool:
        """True if the entity may become idle by itself, instead of together with its owner."""
        return self.owner is self and (self.is_queue or self.kind is Kind.WAITABLE)

    @property
    def is_queue(self) -> bool:
        """True if it queues messages or requests; `take` may then be called at any time."""
        return self.kind in (Kind.SERVICE, Kind.SUBSCRIPTION)

    @property
    def may_hold_several(self) -> bool:
        """True if several messages or requests may be queued."""
        return self.is_queue and self.entity.qos_profile.depth != 1

    def rank(self) -> tuple[bool, int, int]:
        """Return the sort key that determines the order of callbacks in a turn."""
        return not self.is_urgent, self.kind, self.last_turn

    def take(self) -> Callable[[], Any] | None:
        """Take a message, request, ...; return a function that runs the callback with it.

        None if there is nothing to take.
        """
        entity = self.entity
        try:
            if self.kind is Kind.SERVICE:
                taken = rclpy_private.take_request(entity)
                return None if taken is None else partial(_serve, entity, *taken)
            if self.kind is Kind.SUBSCRIPTION:
                taken = rclpy_private.take_message(entity)
                if taken is None:
                    return None
                return partial(entity.callback, *(taken if self._takes_info else taken[:1]))
            if self.kind is Kind.TIMER:
                return rclpy_private.call_timer(entity)
            if self.kind is Kind.CLIENT:
                return rclpy_private.take_response(entity)
            if self.kind is Kind.WAITABLE:
                return partial(_process, entity, entity.take_data())
            callback: Callable[[], Any] | None = entity.callback
            return callback  # of a guard condition, which has nothing to take
        except InvalidHandle:  # destroyed
            return None


def _takes_info(callback: Callable[..., Any]) -> bool:
    """Return True if a subscription's callback takes a message and the information about it."""
    try:
        inspect.signature(callback).bind(None)  # fails if one argument, the message, is too few
    except TypeError:
        return True
    except ValueError:  # a function of a C library, without a signature
        pass
    return False


def _serve(service: Any, request: Any, header: Any) -> None:
    """Run the callback of a service, and reply unless the callback does so later."""
    callback = service.callback
    if isinstance(callback, DeferredCallback):
        callback.handle(request, header)
    else:
        service.send_response(callback(request, service.srv_type.Response()), header)


def _process(waitable: Any, data: Any) -> None:
    """Run the coroutine with which a waitable, e.g. an event of a subscription, runs its callback.

    Raises:
        TypeError: the coroutine awaits something.
    """
    coroutine = waitable.execute(data)
    try:
        coroutine.send(None)
    except StopIteration:
        return
    coroutine.close()
    raise TypeError(f"the callback of {waitable!r} must not await anything")


class WaitSet:
    """Entities that a thread waits for.

    Args:
        guards: guard conditions that only end a wait.
    """

    def __init__(self, context: Any, watched: Iterable[Watched], *guards: Any) -> None:
        entities: list[Watched] = []
        self._waitables: list[Watched] = []
        for each in watched:
            (self._waitables if each.kind is Kind.WAITABLE else entities).append(each)
        # in the order of the arguments of rclpy's WaitSet
        counts = dict.fromkeys(
            ("subscription", "guard_condition", "timer", "client", "service", "event"), 0
        )
        for each in entities:
            counts[each.kind.name.lower()] += 1
        self._kinds = [name for name, count in counts.items() if count]
        """Kinds of the entities, other than waitables, by rclpy's names."""
        counts["guard_condition"] += len(guards)
        for each in self._waitables:
            parts = each.entity.get_num_entities()
            for name in counts:
                counts[name] += getattr(parts, f"num_{name}s")
        self._wait_set = rclpy_private.WaitSet(*counts.values(), context.handle)
        self._handles = [  # each with the function that adds it to the wait set
            (each.entity.handle, getattr(self._wait_set, f"add_{each.kind.name.lower()}"))
            for each in entities
        ]
        self._handles += [(each.handle, self._wait_set.add_guard_condition) for each in guards]
        self._by_pointer = {each.entity.handle.pointer: each for each in entities}

    def wait(self, timeout: int) -> list[Watched]:
        """Wait for at most `timeout` nanoseconds, or forever if negative; return ready entities."""
        wait_set = self._wait_set
        entered: list[Any] = []  # kept from being destroyed during the wait
        waitables: list[Watched] = []
        try:
            wait_set.clear_entities()
            for handle, add in self._handles:
                try:
                    handle.__enter__()
                except InvalidHandle:  # destroyed, so the executor is about to be woken
                    continue
                entered.append(handle)
                add(handle)
            for each in self._waitables:
                try:
                    each.entity.__enter__()
                except InvalidHandle:
                    continue
                entered.append(each.entity)
                each.entity.add_to_wait_set(wait_set)
                waitables.append(each)
            wait_set.wait(timeout)
            ready = [
                self._by_pointer[pointer]
                for kind in self._kinds
                for pointer in wait_set.get_ready_entities(kind)
                if pointer in self._by_pointer  # not the guards and the parts of waitables
            ]
            ready += [each for each in waitables if each.entity.is_ready(wait_set)]
            return ready
        finally:
            for handle in entered:
                handle.__exit__(None, None, None)
