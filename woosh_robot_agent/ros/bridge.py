"""Hand-over between the executor thread and the link thread.

rclpy callbacks run in the executor thread and never wait. They pass a coroutine to the link thread,
which replies later (`DeferredService`). Publishers publish directly from the link thread.
"""

from __future__ import annotations

import asyncio
import logging
import selectors
import threading
import time
from collections.abc import Callable, Coroutine
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeoutError
from contextvars import Context
from functools import partial
from typing import Any, TypeVar

from rclpy.qos import QoSProfile

from woosh_robot_agent.link.tasks import ThreadPerCall, start_task
from woosh_robot_agent.ros.entities import DeferredCallback, UrgentCallbackGroup
from woosh_robot_agent.ros.logs import log_as
from woosh_robot_agent.ros.qos import SERVICE_QOS
from woosh_robot_agent.ros.rclpy_private import PEER_GONE_ERRORS

T = TypeVar("T")

_LOG = logging.getLogger(__name__)


class LoopThread:
    """A thread with an asyncio event loop, shared by the links of any number of robots."""

    def __init__(self) -> None:
        self._selector = _TimedSelector()
        self.loop = asyncio.SelectorEventLoop(self._selector)
        self.loop.set_default_executor(ThreadPerCall())
        self._thread = threading.Thread(target=self._main, name="link", daemon=True)
        self._thread.start()

    @property
    def longest_turns(self) -> tuple[float, float]:
        """Longest turn of the event loop in the last one or two minutes, and ever, in seconds.

        A turn is the time between two waits for sockets and timers; commands wait meanwhile. A long
        turn comes from a long callback in this thread, or from another thread that kept the GIL.
        """
        selector = self._selector
        return max(selector.longest, selector.longest_before), selector.longest_ever

    def stop(self, timeout: float) -> None:
        """Stop the loop, cancel its tasks and join the thread, within `timeout` seconds."""
        self.loop.call_soon_threadsafe(self.loop.stop)
        self._thread.join(timeout)
        if self._thread.is_alive():
            _LOG.error("the link thread did not end within %g s", timeout)

    def _main(self) -> None:
        asyncio.set_event_loop(self.loop)
        try:
            self.loop.run_forever()
            leftover = asyncio.all_tasks(self.loop)
            for task in leftover:
                task.cancel()
            self.loop.run_until_complete(asyncio.gather(*leftover, return_exceptions=True))
        finally:
            self.loop.close()


class _TimedSelector(selectors.DefaultSelector):
    """A selector that measures the turns of its event loop: the times between two waits.

    Attributes:
        longest: longest turn of this minute, in seconds.
        longest_before: longest turn of the minute before, in seconds.
        longest_ever: longest turn, in seconds.
    """

    def __init__(self) -> None:
        super().__init__()
        self.longest = self.longest_before = self.longest_ever = 0.0
        # starts of this turn and of this minute
        self._began = self._minute = time.monotonic()

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        now = time.monotonic()
        turn = now - self._began
        if now - self._minute > 60.0:
            self._minute, self.longest_before, self.longest = now, self.longest, 0.0
        if turn > self.longest:
            self.longest = turn
            self.longest_ever = max(turn, self.longest_ever)
        events = super().select(timeout)
        self._began = time.monotonic()
        if timeout is not None:  # the turn began at the timeout, even if another thread had the GIL
            self._began = min(self._began, now + timeout)
        return events


class AgentStoppingError(Exception):
    """A coroutine was cancelled, because the agent is stopping."""

    def __init__(self) -> None:
        super().__init__("the agent is stopping")


class LinkThread:
    """The link thread, as the agent of one robot uses it.

    All work that is started with this object logs to the robot's node.

    Args:
        thread: the link thread; it may serve other robots too.
        context: context in which all work runs; it holds the node's logger (`logs.context_of`).
    """

    def __init__(self, thread: LoopThread, context: Context) -> None:
        self.loop = thread.loop
        self.loop_thread = thread
        self._context = context
        self._tasks: dict[asyncio.Task[None], Callable[[BaseException], None] | None] = {}
        """Spawned coroutines that have not ended, and their `on_error`."""

    def call(self, function: Callable[..., object], *args: object) -> None:
        """Schedule a call of `function` in the loop. Thread-safe."""
        self.loop.call_soon_threadsafe(function, *args, context=self._context)

    def spawn(
        self,
        work: Callable[[], Coroutine[Any, Any, None]],
        on_error: Callable[[BaseException], None] | None = None,
    ) -> None:
        """Start a coroutine in the loop and do not wait for it. Thread-safe.

        Args:
            work: creates the coroutine.
            on_error: called with an exception that the coroutine did not handle, after it has been
                logged, or with an AgentStoppingError if the coroutine was cancelled.
        """
        self.call(self._spawn, work, on_error)

    def begin(self, work: Coroutine[Any, Any, T]) -> Future[T]:
        """Start a coroutine in the loop and return its future. Thread-safe."""
        # a copy, because the loop may be running in the context itself at this moment
        return self._context.copy().run(asyncio.run_coroutine_threadsafe, work, self.loop)

    def run(self, work: Coroutine[Any, Any, T], timeout: float) -> T:
        """Run a coroutine in the loop and wait for it, from another thread.

        Raises:
            TimeoutError: the coroutine took longer than `timeout` seconds and has been cancelled.
        """
        return wait_for_result(self.begin(work), timeout)

    async def cancel(self) -> None:
        """Cancel all spawned coroutines and wait for their end; call it in the loop."""
        tasks = tuple(self._tasks)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        for task in tasks:  # a coroutine that had not started has not called its `on_error`
            if (on_error := self._tasks.pop(task, None)) is not None:
                on_error(AgentStoppingError())

    def _spawn(
        self,
        work: Callable[[], Coroutine[Any, Any, None]],
        on_error: Callable[[BaseException], None] | None,
    ) -> None:
        task = start_task(self._run_spawned(work, on_error))
        if not task.done():  # `start_task` runs it up to its first wait, perhaps to its end
            self._tasks[task] = on_error  # the loop itself keeps only a weak reference

    async def _run_spawned(
        self,
        work: Callable[[], Coroutine[Any, Any, None]],
        on_error: Callable[[BaseException], None] | None,
    ) -> None:
        # errors are handled here: a done callback would take another turn of the loop
        error: BaseException | None = None
        try:
            await work()
        except asyncio.CancelledError:
            error = AgentStoppingError()
            raise
        except Exception as unexpected:
            _LOG.exception("a background task failed")
            error = unexpected
        finally:
            if (task := asyncio.current_task()) is not None:
                self._tasks.pop(task, None)
            if error is not None and on_error is not None:
                on_error(error)


def wait_for_result(future: Future[T], timeout: float) -> T:
    """Wait for a coroutine of another thread and return its result.

    Raises:
        TimeoutError: the coroutine took longer than `timeout` seconds and has been cancelled.
    """
    try:
        return future.result(timeout)
    except FutureTimeoutError:
        future.cancel()
        raise TimeoutError from None  # the two classes are the same only since Python 3.11


class Reply:
    """The reply to one service call; it is sent exactly once, from any thread.

    Args:
        send: sends a response to the client that a header identifies.
        header: identifies the client and its call.
    """

    def __init__(self, response_class: Any, send: Callable[[Any, Any], None], header: Any) -> None:
        self._response_class = response_class
        self._send = send
        self._header = header
        self._lock = threading.Lock()
        self._sent = False

    @property
    def sequence_number(self) -> int:
        """Number of the call, assigned by its client."""
        return int(self._header.request_id.sequence_number)

    @property
    def times(self) -> tuple[float, float]:
        """Unix times at which the client sent the call, and at which the middleware received it.

        The first time is by the client's clock. 0 means unknown.
        """
        return self._header.source_timestamp / 1e9, self._header.received_timestamp / 1e9

    def send(self, response: Any) -> bool:
        """Send the response; return False if the client has disappeared.

        A second response is a bug: it is logged and not sent.
        """
        with self._lock:
            was_sent, self._sent = self._sent, True
        if was_sent:
            _LOG.error("a service call was answered twice; second response: %r", response)
            return True
        try:
            try:
                self._send(response, self._header)
            except PEER_GONE_ERRORS:
                raise
            except Exception as error:  # rclpy cannot convert the response
                _LOG.exception("a service response could not be sent: %a", response)
                self._send(self._failure(error), self._header)
        except PEER_GONE_ERRORS as error:
            _LOG.debug("the client disappeared before its response was sent: %s", error)
            return False
        return True

    def fail(self, error: BaseException) -> None:
        """Send a response that reports a bug of the agent, or that the agent is stopping."""
        self.send(self._failure(error))

    def _failure(self, error: BaseException) -> Any:
        response = self._response_class()
        text = f"internal error of the agent, please report it: {error!a}"
        if isinstance(error, AgentStoppingError):
            text = str(error)
        for field in ("msg", "message"):  # of the robot's services, and of Trigger
            if hasattr(response, field):
                setattr(response, field, text)
        if hasattr(response, "RESULT_UNDEFINED_FAILURE"):  # Nav2's LoadMap; the default is success
            response.result = response.RESULT_UNDEFINED_FAILURE
        return response


class DeferredService:
    """A service whose callback returns at once; the response is sent later, from any thread.

    The node owns the service, so the object need not be kept.

    Args:
        handle: called with the request and the `Reply` in the executor thread; must not block.
        urgent: True to handle requests before all other callbacks (`UrgentCallbackGroup`).
    """

    def __init__(
        self,
        node: Any,
        srv_type: Any,
        name: str,
        handle: Callable[[Any, Reply], None],
        *,
        urgent: bool = False,
        qos: QoSProfile = SERVICE_QOS,
    ) -> None:
        self._response_class = srv_type.Response
        self._handle = handle
        self._log_as_node = partial(log_as, node.get_logger())
        self._service = node.create_service(
            srv_type,
            name,
            DeferredCallback(self._serve),
            qos_profile=qos,
            callback_group=UrgentCallbackGroup() if urgent else None,
        )

    def _serve(self, request: Any, header: Any) -> None:
        self._log_as_node()
        reply = Reply(self._response_class, self._service.send_response, header)
        try:
            self._handle(request, reply)
        except Exception as error:  # an escaping exception would end the executor
            _LOG.exception("a service callback failed")
            reply.fail(error)
