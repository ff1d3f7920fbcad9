"""Everything that passes between the two threads: rclpy's in main, asyncio's with the link.

rclpy callbacks never wait. They hand a coroutine to the link's thread, which answers when it can:
services by `DeferredService`, publishers straight from the link's thread (they need no executor).
"""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections.abc import Callable, Coroutine
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeoutError
from contextvars import Context
from functools import partial
from typing import Any, TypeVar

from rclpy.exceptions import InvalidHandle
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.qos import QoSProfile

from woosh_robot_agent.logs import speak_as

T = TypeVar("T")

_LOG = logging.getLogger(__name__)
SERVICE_QOS = QoSProfile(depth=10_000)
"""Of all services, those of actions too: what DDS cannot keep, calls and answers alike, is lost and
nobody learns of it. So many are 5 s of 2,000 calls/s; DDS asks for what it missed every 3 s."""
_GONE = (InvalidHandle, _rclpy.RCLError)
"""What sending raises when nobody is there any more."""
_TURN = 0.005
"""s for which calls of one service are taken before it is the turn of the others."""


class LoopThread:
    """An asyncio event loop in a thread of its own, for the links of any number of robots."""

    def __init__(self) -> None:
        self.loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._main, name="link", daemon=True)
        self._thread.start()

    def stop(self, timeout: float) -> None:
        """Cancel what runs, end the loop and join the thread, within `timeout` s."""
        self.loop.call_soon_threadsafe(self.loop.stop)
        self._thread.join(timeout)
        if self._thread.is_alive():
            _LOG.error("the link's thread did not end within %g s", timeout)

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


class LinkThread:
    """What one robot's agent hands over to the link's thread.

    Args:
        thread: the thread, shared perhaps with other robots.
        context: in which all of it runs; tells whose it is, see `logs`.
    """

    def __init__(self, thread: LoopThread, context: Context) -> None:
        self.loop = thread.loop
        self._context = context
        self._tasks: set[asyncio.Task[None]] = set()

    def call(self, function: Callable[..., object], *args: object) -> None:
        """Have `function` called in the loop soon; from any thread."""
        self.loop.call_soon_threadsafe(function, *args, context=self._context)

    def spawn(
        self,
        work: Callable[[], Coroutine[Any, Any, None]],
        failed: Callable[[BaseException], None] | None = None,
    ) -> None:
        """Have a coroutine run in the loop; from any thread.

        Args:
            work: makes the coroutine.
            failed: gets what it raised, a mistake of ours; it is logged too.
        """
        self.call(self._spawn, work, failed)

    def begin(self, work: Coroutine[Any, Any, T]) -> Future[T]:
        """Begin a coroutine in the loop; from any thread. `outcome` waits for its end."""
        # a copy, as the loop may be in the context itself at this moment
        return self._context.copy().run(asyncio.run_coroutine_threadsafe, work, self.loop)

    def run(self, work: Coroutine[Any, Any, T], timeout: float) -> T:
        """Run a coroutine in the loop and wait for it; from any other thread.

        Raises:
            TimeoutError: it took longer than `timeout` s; it is cancelled.
        """
        return outcome(self.begin(work), timeout)

    async def cancel(self) -> None:
        """Cancel what was spawned, and wait for its end; in the loop."""
        tasks = tuple(self._tasks)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    def _spawn(
        self,
        work: Callable[[], Coroutine[Any, Any, None]],
        failed: Callable[[BaseException], None] | None,
    ) -> None:
        task = self.loop.create_task(work())
        self._tasks.add(task)  # the loop itself keeps only a weak reference
        task.add_done_callback(partial(self._done, failed))

    def _done(
        self, failed: Callable[[BaseException], None] | None, task: asyncio.Task[None]
    ) -> None:
        self._tasks.discard(task)
        error = RuntimeError("the agent is stopping") if task.cancelled() else task.exception()
        if error is None:
            return
        if not task.cancelled():
            _LOG.error("a task of the agent failed", exc_info=error)
        if failed is not None:
            failed(error)


def outcome(begun: Future[T], timeout: float) -> T:
    """What a coroutine of another thread gives.

    Raises:
        TimeoutError: it took longer than `timeout` s; it is cancelled.
    """
    try:
        return begun.result(timeout)
    except FutureTimeoutError:
        begun.cancel()
        raise TimeoutError from None  # until Python 3.11 they are two


class Reply:
    """The answer to one service call, sent once, by whichever thread has it.

    Args:
        response_class: class of the answer.
        send: sends an answer to the one whom a header names.
        header: whom to answer.
    """

    def __init__(self, response_class: Any, send: Callable[[Any, Any], None], header: Any) -> None:
        self._response_class = response_class
        self._send = send
        self._header = header
        self._lock = threading.Lock()
        self._sent = False

    def send(self, response: Any) -> None:
        """Answer the call. A second answer is a mistake of ours; it is logged and not sent."""
        with self._lock:
            again, self._sent = self._sent, True
        if again:
            _LOG.error("a service call was answered twice: %r", response)
            return
        try:
            try:
                self._send(response, self._header)
            except _GONE:
                raise
            except Exception as error:  # rclpy could not convert it
                _LOG.exception("an answer could not be sent: %a", response)
                self._send(self._failure(error), self._header)
        except _GONE as error:
            _LOG.debug("the client has gone before its answer: %s", error)

    def fail(self, error: BaseException) -> None:
        """Answer for want of anything better: a mistake of ours kept the real answer away."""
        self.send(self._failure(error))

    def _failure(self, error: BaseException) -> Any:
        response = self._response_class()
        if hasattr(response, "msg"):
            response.msg = f"the agent failed: {error!a}; please report this"
        return response


class DeferredService:
    """A service whose callback returns at once and whose answer is sent later, from any thread.

    The executor passes on what the callback returns, and whom to answer, to `send_response`. So the
    callback returns the request itself, and calls are served in `send_response`: as the last thing
    that the executor does, so that the link's thread, which wakes for it, gets Python's lock.

    Args:
        node: owner of the service.
        srv_type: ROS type of the service.
        name: name of the service.
        handle: takes the request and the `Reply`, in the executor's thread; must not wait.
    """

    def __init__(
        self, node: Any, srv_type: Any, name: str, handle: Callable[[Any, Reply], None]
    ) -> None:
        self._srv_type = srv_type
        self._handle = handle
        self._speak = partial(speak_as, node.get_logger())
        self._service = node.create_service(srv_type, name, _request, qos_profile=SERVICE_QOS)
        self._send_now = self._service.send_response
        self._service.send_response = self._serve_all

    def _serve_all(self, request: Any, header: Any) -> None:
        """Serve a call, and what waits besides.

        An executor may look at all its entities for each single call. With that, calls come faster
        than they are taken, until DDS drops the oldest of them.
        """
        self._speak()
        deadline = time.monotonic() + _TURN
        while header is not None:
            served = request, header
            try:
                request, header = self._take() if time.monotonic() < deadline else (None, None)
            finally:
                self._serve(*served)

    def _take(self) -> tuple[Any, Any]:
        """The next call's request and header, or two times None."""
        handle = self._service.handle
        with handle:
            return handle.service_take_request(self._srv_type.Request) or (None, None)

    def _serve(self, request: Any, header: Any) -> None:
        reply = Reply(self._srv_type.Response, self._send_now, header)
        try:
            self._handle(request, reply)
        except Exception as error:  # one that escaped would end the executor
            _LOG.exception("a service callback failed")
            reply.fail(error)


def _request(request: Any, _response: Any) -> Any:
    return request
