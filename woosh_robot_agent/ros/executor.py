"""An executor for nodes with many entities, of which few are in use at a time.

rclpy's executors look at all entities of their nodes each time they wake. This executor looks only
at the entities in use:

1. Timers, guard conditions and clients are always in use. Another entity is in use if it was ready
   lately; at most `_MAX_IN_USE` of these are.
2. A second thread waits for all other entities, which are idle. When an idle entity becomes ready,
   the second thread reports it to the thread that spins, and the entity is in use from then on.
3. All callbacks run in the thread that spins, in turns. A turn begins with a wait. Then the
   callbacks of all ready entities run: first those of urgent entities (`UrgentCallbackGroup`), then
   tasks, then the others in the order of `entities.Kind`. Within one kind, the entity that has not
   run for the longest time comes first.
4. Each callback runs once. Services and subscriptions that have more to do run again at the end of
   the turn, until the turn has taken `_MAX_TURN`.
5. Between two callbacks of a turn, urgent services and subscriptions are looked at again, so that
   they wait for at most one callback that is not urgent. Each runs at most once there, so that a
   flood of messages for one of them holds up no other callback.
6. `spin_once` runs one callback. An exception of the callback leaves `spin_once`, but not one of a
   future's done callback, which rclpy turns into a warning. The next call continues the turn.
7. After an urgent callback, the thread that spins lets other threads run: the callback has handed
   its work to one of them, which needs the GIL to begin.
8. Callbacks are functions: none of them awaits anything. So callback groups need not be kept apart.
"""

from __future__ import annotations

import logging
import threading
import time
import weakref
from collections import deque
from collections.abc import Callable
from typing import Any

from rclpy.exceptions import InvalidHandle
from rclpy.executors import ExternalShutdownException
from rclpy.guard_condition import GuardCondition
from rclpy.utilities import get_default_context

from woosh_robot_agent.ros.entities import WaitSet, Watched, entities_of

_LOG = logging.getLogger(__name__)
_MAX_IN_USE = 24
"""Maximum number of entities in use that may become idle. If there are more, only half of this
number stay in use."""
_MAX_TURN = 0.005
"""Time after which no callback runs again in the same turn, in seconds."""
_HAND_OVER = 0.0001
"""Time for which other threads run after an urgent callback, in seconds. One of them needs about
half of it to wake up."""
_SECOND = 1_000_000_000
"""A second, in nanoseconds."""
_FOREVER = -1
"""Timeout of a wait without a limit."""


class Executor:
    """Runs the callbacks of nodes in the thread that spins it.

    It has what the agent and its tools need of rclpy's executors. `shutdown` also ends its second
    thread.

    Args:
        context: rclpy's context; by default the global one.
    """

    def __init__(self, *, context: Any = None) -> None:
        self._context = context or get_default_context()
        self._guard = GuardCondition(None, None, self._context)
        """Wakes the thread that spins."""
        self._tasks: deque[Callable[[], object]] = deque()
        """Tasks for the next turn."""
        self._lock = threading.RLock()
        """Protects the attributes from here to `_idle`."""
        self._nodes: set[Any] = set()
        self._are_entities_outdated = False
        """True if the nodes' entities may differ from `_watched`."""
        self._watched: dict[Any, Watched] = {}
        """The nodes' entities, by rclpy's object."""
        self._wait_set: WaitSet | None = None
        """The entities in use; None if it has to be made again."""
        self._idle = _IdleThread(self._context, self._lock, self._guard)
        # Only the thread that spins uses the attributes from here on.
        self._turn = 0
        """Number of the turn."""
        self._turn_ends = 0.0
        """Monotonic time after which no callback runs again in this turn."""
        self._has_run = False
        """True if a callback of this turn has run."""
        self._queue: deque[Any] = deque()
        """The rest of this turn: entities and tasks."""
        self._urgent: list[Watched] = []
        """Urgent services and subscriptions."""
        self._urgent_left: list[Watched] = []
        """Those of `_urgent` that were not looked at since the last callback of the queue."""
        self._context.on_shutdown(self.wake)  # ends the waits of both threads
        weakref.finalize(self, self._idle.close)  # for an executor that is not shut down

    def add_node(self, node: Any) -> bool:
        """Add a node; return False if it has been added before."""
        with self._lock:
            if node in self._nodes:
                return False
            self._nodes.add(node)
            node.executor = self
        self.wake()
        return True

    def remove_node(self, node: Any) -> None:
        """Remove a node. A callback that is running continues."""
        with self._lock:
            if node not in self._nodes:
                return
            self._nodes.remove(node)
            self._update()
        self.wake()

    def wake(self) -> None:
        """Read the nodes' entities again. rclpy calls it when one was created or destroyed."""
        with self._lock:
            self._are_entities_outdated = True
            self._idle.wake()
        self._interrupt()

    def create_task(self, callback: Callable[[], object]) -> None:
        """Call a function in the next turn. Thread-safe."""
        self._tasks.append(callback)
        self._interrupt()

    def shutdown(self) -> None:
        """Release the nodes, and end the second thread. Call it when no thread spins any more."""
        self._idle.close()
        with self._lock:
            self._nodes.clear()
            self._update()
        try:
            self._guard.destroy()
        except InvalidHandle:  # shut down before
            pass

    def spin_once(self, timeout_sec: float) -> None:
        """Wait for a callback and run it.

        Args:
            timeout_sec: maximum time to wait, in seconds.

        Raises:
            ExternalShutdownException: the context was shut down.
        """
        deadline = time.monotonic() + timeout_sec
        waited = False
        while not self._run_next():
            left = max(deadline - time.monotonic(), 0.0)
            if waited and not left:  # also look once if the timeout is 0
                return
            self._begin_turn(int(left * _SECOND))
            waited = True

    def _begin_turn(self, timeout: int) -> None:
        """Wait until entities are ready, for at most `timeout` nanoseconds, and queue them."""
        self._check_context()
        ready = self._entities_in_use().wait(0 if self._tasks else timeout)
        self._check_context()
        self._turn += 1
        self._turn_ends = time.monotonic() + _MAX_TURN
        self._has_run = False
        if self._idle.reported:
            ready += self._use_reported()
        ready.sort(key=Watched.rank)
        urgent_count = sum(each.is_urgent for each in ready)
        tasks = [self._tasks.popleft() for _ in range(len(self._tasks))]
        self._queue.extend((*ready[:urgent_count], *tasks, *ready[urgent_count:]))

    def _check_context(self) -> None:
        if not self._context.ok():
            raise ExternalShutdownException

    def _entities_in_use(self) -> WaitSet:
        """Return the wait set of the entities in use; make it again after a change of these."""
        with self._lock:
            if self._are_entities_outdated:
                self._update()
            if self._wait_set is None:
                self._urgent = [
                    each for each in self._watched.values() if each.is_urgent and each.is_queue
                ]
                in_use = (each for each in self._watched.values() if not each.owner.is_idle)
                self._wait_set = WaitSet(self._context, in_use, self._guard)
            return self._wait_set

    def _update(self) -> None:
        """Update `_watched` from the entities of the nodes. The caller holds the lock."""
        self._are_entities_outdated = False
        known, self._watched = self._watched, {}
        for node in self._nodes:
            for kind, entity in entities_of(node):
                watched = known.pop(entity) if entity in known else Watched(entity, kind)
                self._watched[entity] = watched
            for subscription in node.subscriptions:
                # a message also wakes the thread that waits for an event of the subscription, so
                # the same thread must wait for both
                for handler in subscription.event_handlers:
                    if handler in self._watched and subscription in self._watched:
                        self._watched[handler].owner = self._watched[subscription]
        for each in known.values():  # these are left over: no node has them any more
            each.is_present = False
        self._limit_use()
        self._watch_idle()

    def _use_reported(self) -> list[Watched]:
        """Put in use the entities that the second thread has reported, and return them."""
        with self._lock:
            reported, self._idle.reported = self._idle.reported, []
            for each in reported:
                each.owner.last_turn = self._turn
            if self._limit_use():
                self._watch_idle()
        return reported

    def _limit_use(self) -> bool:
        """Make entities idle if more than `_MAX_IN_USE` are in use; return True if there were.

        Those that are urgent stay in use first, then those that were ready most recently. Call it
        after each change of the entities in use, because it also discards the wait set.
        """
        self._wait_set = None
        in_use = [each for each in self._watched.values() if each.may_idle and not each.is_idle]
        if len(in_use) <= _MAX_IN_USE:
            return False
        in_use.sort(key=lambda each: (each.is_urgent, each.last_turn), reverse=True)
        # only half stay, so that the next entity in use does not exceed the limit again
        for place, each in enumerate(in_use):
            was_ready = each.last_turn > 0
            stays_in_use = place < _MAX_IN_USE // 2 and (each.is_urgent or was_ready)
            each.is_idle = not stays_in_use
        return True

    def _watch_idle(self) -> None:
        self._idle.watch([each for each in self._watched.values() if each.owner.is_idle])

    def _run_next(self) -> bool:
        """Run the next callback of this turn; return False if the turn is over."""
        if self._has_run and self._queue:  # between two callbacks
            while self._urgent_left:
                if self._run(self._urgent_left.pop()):
                    return True
        while self._queue:
            self._urgent_left = self._urgent[:]
            each = self._queue.popleft()
            if not isinstance(each, Watched):
                self._has_run = True
                each()
                return True
            if self._run(each):
                if each.may_hold_several and time.monotonic() < self._turn_ends:
                    self._queue.append(each)
                return True
        return False

    def _run(self, watched: Watched) -> bool:
        """Run the callback of an entity, if it is ready; return True if it has run."""
        call = watched.take() if watched.is_present else None
        if call is None:
            return False
        self._has_run = True
        watched.last_turn = self._turn
        call()
        if watched.is_urgent:
            time.sleep(_HAND_OVER)
        return True

    def _interrupt(self) -> None:
        """Wake the thread that spins."""
        try:
            self._guard.trigger()
        except InvalidHandle:  # shut down
            pass


class _IdleThread:
    """The thread that waits for idle entities. It is started for the first idle entity.

    Args:
        lock: the executor's lock. Hold it when you call `watch` or `wake`, or take `reported`.
        executor_guard: triggered when entities have been reported.

    Attributes:
        reported: entities that have become ready.
    """

    def __init__(self, context: Any, lock: threading.RLock, executor_guard: Any) -> None:
        self._context = context
        self._lock = lock
        self._executor_guard = executor_guard
        self._guard = GuardCondition(None, None, context)
        """Ends the wait of this thread."""
        self._watched: list[Watched] = []
        """The idle entities."""
        self.reported: list[Watched] = []
        self._thread: threading.Thread | None = None
        self._is_closed = False

    def watch(self, watched: list[Watched]) -> None:
        """Wait for these entities from now on."""
        self._watched = watched
        if self._thread is not None:
            self.wake()
        elif watched and not self._is_closed:
            self._thread = threading.Thread(target=self._main, name="idle entities", daemon=True)
            self._thread.start()

    def wake(self) -> None:
        """End the wait, so that entities that have been destroyed are released."""
        if not self._is_closed:
            self._guard.trigger()

    def close(self) -> None:
        """End the thread. Further calls do nothing."""
        with self._lock:
            if self._is_closed:
                return
            self._guard.trigger()
            self._is_closed = True
        # the garbage collector may run the executor's finalizer, which calls this, in that thread
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join()
        self._guard.destroy()

    def _main(self) -> None:
        try:
            while self._wait():
                pass
        except Exception:
            with self._lock:
                if self._context.ok():
                    _LOG.exception("the thread for idle entities failed; it is started again")
                # the thread that spins waits for its entities, until `watch` starts a new one
                self._report(self._watched)
                self._thread = None

    def _wait(self) -> bool:
        """Wait until entities are ready, and report them; return False if the thread has to end."""
        with self._lock:
            if self._is_closed or not self._context.ok():
                return False
            wait_set = WaitSet(self._context, self._watched, self._guard)
        ready = wait_set.wait(_FOREVER)
        with self._lock:
            self._report(ready)
        return True

    def _report(self, ready: list[Watched]) -> None:
        """Put ready entities in use, and report them to the thread that spins."""
        for each in ready:
            each.owner.is_idle = False
        if ready:
            self._watched = [each for each in self._watched if each.owner.is_idle]
            self.reported += ready
            self._executor_guard.trigger()
