"""Helpers for asyncio: tasks that start at once, timeouts, and a thread for large messages."""

from __future__ import annotations

import asyncio
import contextlib
import contextvars
import socket
import struct
import sys
from collections.abc import Callable, Coroutine
from concurrent.futures import Future, ThreadPoolExecutor
from threading import Thread
from typing import Any, TypeVar

T = TypeVar("T")


def start_task(work: Coroutine[Any, Any, T], name: str | None = None) -> asyncio.Task[T]:
    """Start a coroutine in the running event loop.

    The coroutine runs up to its first wait before this function returns, which saves a turn of the
    event loop. Before Python 3.12 it starts with the loop's next turn.
    """
    loop = asyncio.get_running_loop()
    if sys.version_info >= (3, 12):
        return asyncio.Task(work, loop=loop, name=name, eager_start=True)
    return loop.create_task(work, name=name)


_GRACE = 1.0
"""Maximum wait for cancelled work to end, in seconds. Only a library that blocks uses it up."""


async def run_with_timeout(timeout: float, work: Coroutine[Any, Any, T] | asyncio.Future[T]) -> T:
    """Return the result of `work`; cancel it on timeout, and when the caller is cancelled.

    Use it instead of `asyncio.wait_for`, which swallows a cancellation that coincides with a result
    (in Python 3.10 and 3.11), and waits for cancelled work without a limit.

    Raises:
        TimeoutError: `work` took longer than `timeout` seconds.
    """
    task = asyncio.ensure_future(work)
    try:
        await asyncio.wait({task}, timeout=timeout)
        if task.done():
            return task.result()
        raise TimeoutError(f"not within {timeout:g} s")
    finally:
        if not task.done():
            await cancel_and_wait(task)
        elif not task.cancelled():
            task.exception()  # marks it as retrieved


async def cancel_and_wait(*tasks: asyncio.Future[Any]) -> None:
    """Cancel tasks and wait for their end, at most one second."""
    for task in tasks:
        task.cancel()
        task.add_done_callback(retrieve_exception)
    if tasks:
        await asyncio.wait(tasks, timeout=_GRACE)


async def close_or_abort(
    closing: Coroutine[Any, Any, object], abort: Callable[[], None], timeout: float
) -> None:
    """Close a connection in an orderly way; abort it if that takes longer than `timeout` seconds.

    Args:
        closing: closes the connection.
        abort: drops the connection; also called after an orderly close, where it has no effect.
        timeout: maximum duration of the orderly close, in seconds.
    """
    task = asyncio.ensure_future(closing)
    try:
        await asyncio.wait({task}, timeout=timeout)
    finally:
        abort()
        try:
            await asyncio.wait({task}, timeout=_GRACE)  # the abort lets it end by itself
        finally:
            await cancel_and_wait(task)


def abort_transport(transport: asyncio.WriteTransport) -> None:
    """Abort a connection, which may have ended already."""
    # asyncio fails if the transport was closed with unsent bytes, and these have been sent since
    with contextlib.suppress(AttributeError):
        transport.abort()


def drop_unsent_at_end(transport: asyncio.BaseTransport) -> None:
    """Let the end of a TCP connection drop what the kernel has not sent yet.

    Otherwise the kernel goes on sending for minutes: a command would be executed long after the
    link was given up, even after a stop over a new link. The other end sees a reset.
    """
    linger = struct.pack("ii", 1, 0)  # on, for 0 s
    with contextlib.suppress(OSError):  # it has ended already
        transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)


def retrieve_exception(task: asyncio.Future[Any]) -> None:
    """Mark the exception of an ended task as retrieved, so that asyncio does not log it."""
    if not task.cancelled():
        task.exception()


class ThreadPerCall(ThreadPoolExecutor):
    """An executor that runs each call in a daemon thread of its own.

    As the default executor of an event loop, it looks up host names: the name of a robot that is
    off blocks its thread for 5 to 20 s, which must delay neither another robot nor the end of the
    program.
    """

    def submit(self, function: Callable[..., T], /, *args: Any, **options: Any) -> Future[T]:
        future: Future[T] = Future()

        def run() -> None:
            if not future.set_running_or_notify_cancel():
                return
            try:
                future.set_result(function(*args, **options))
            except BaseException as error:
                future.set_exception(error)

        Thread(target=run, daemon=True).start()
        return future


def run_main(work: Coroutine[Any, Any, T]) -> T:
    """Run the main coroutine of a program, like `asyncio.run`, but with `ThreadPerCall`."""

    async def main() -> T:
        asyncio.get_running_loop().set_default_executor(ThreadPerCall())
        return await work

    return asyncio.run(main())


LARGE = 64 * 1024
"""Length from which a frame is handled by `offload`, in characters or bytes.

The conversion of a shorter frame takes some milliseconds at most.
"""
_SWITCH_INTERVAL = 0.0005
"""Switch interval of Python while the thread for large messages works, in seconds: the time for
which other threads wait for the GIL. The link thread needs it again after each system call. With
Python's 5 ms, a few system calls would take 20 ms."""
_THREAD = ThreadPoolExecutor(1, thread_name_prefix="large messages")
"""One thread, so that large messages keep their order, and at most one competes for the GIL."""


async def offload(function: Callable[..., T], *args: Any) -> T:
    """Return the result of a function that runs in the thread for large messages.

    The function must consist of small steps of Python: a long call into C that keeps the GIL would
    hold up all threads.
    """
    context = contextvars.copy_context()  # it holds the logger of the robot's node
    return await asyncio.get_running_loop().run_in_executor(
        _THREAD, context.run, _run, function, *args
    )


def _run(function: Callable[..., T], *args: Any) -> T:
    """Return the result of a function, with a short switch interval while it runs."""
    interval = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH_INTERVAL)
    try:
        return function(*args)
    finally:
        sys.setswitchinterval(interval)
