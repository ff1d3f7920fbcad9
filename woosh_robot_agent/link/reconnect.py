"""The only owner of retries: connects, makes the handshake, reports the state, and reconnects."""

from __future__ import annotations

import asyncio
import logging
import random
import time
from collections.abc import Awaitable, Callable, Coroutine
from dataclasses import replace
from enum import Enum
from functools import partial
from typing import Any

from woosh_robot_agent.link.answer import Answer
from woosh_robot_agent.link.codecs import client_codec
from woosh_robot_agent.link.config import (
    ConnectionLostError,
    HandshakeError,
    LinkConfig,
    LinkError,
    NotConnectedError,
)
from woosh_robot_agent.link.connection import Connection
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.link.reports import DropLog, LinkStats, LogOnce, one_line
from woosh_robot_agent.link.subscriptions import Subscriptions, call
from woosh_robot_agent.link.tasks import cancel_and_wait, run_with_timeout
from woosh_robot_agent.link.transport import Transport, TransportClosedError, open_transport
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo

_JITTER = 0.2
"""Maximum share by which a pause is shortened at random, so that many agents do not retry in
step."""


class Backoff:
    """Pauses with jitter that double each time, until reset.

    Args:
        shortest: first pause, in seconds.
        longest: longest pause, in seconds.
    """

    def __init__(self, shortest: float, longest: float) -> None:
        self._shortest = shortest
        self._longest = longest
        self._next = shortest

    def next(self) -> float:
        """Return the pause before the next attempt, in seconds."""
        pause = self._next
        self._next = min(self._longest, pause * 2)
        return pause * (1 - _JITTER * random.random())

    def reset(self) -> None:
        """Start again with the shortest pause."""
        self._next = self._shortest


class LinkState(Enum):
    """State of the link."""

    STOPPED = "stopped"
    """Not started, or closed: no attempt to connect is made."""
    CONNECTING = "connecting"
    """An attempt is in progress: the transport is opening, or the first RobotInfo is pending."""
    READY = "ready"
    """The first RobotInfo has arrived; requests can be sent."""
    WAITING = "waiting"
    """The last attempt failed, or the link was lost; the next attempt follows after a pause."""


class LinkStatus:
    """The current state of the link, with its callbacks and waiters.

    Attributes:
        state: current state.
        since: Unix time at which the link last became ready or ceased to be, in seconds.
        last_error: error that ended the last attempt or the last link; None if the link is ready,
            or if no attempt has ended since the start.
        address: address of the chassis, for error texts.
    """

    def __init__(self, address: str) -> None:
        self.state = LinkState.STOPPED
        self.since = time.time()
        self.last_error: LinkError | None = None
        self.address = address
        self._callbacks: list[Callable[[LinkState], None]] = []
        self._ready_waiters: set[asyncio.Future[None]] = set()

    def on_change(self, callback: Callable[[LinkState], None]) -> None:
        """Call `callback` with each new state, in the event loop."""
        self._callbacks.append(callback)

    def enter(self, state: LinkState) -> None:
        """Change the state, and notify callbacks and waiters."""
        if (state is LinkState.READY) != (self.state is LinkState.READY):
            self.since = time.time()
        self.state = state
        for waiter in self._ready_waiters:
            if state is LinkState.READY and not waiter.done():
                waiter.set_result(None)
            elif state is LinkState.STOPPED and not waiter.done():
                waiter.set_exception(self.not_connected())
        for callback in tuple(self._callbacks):
            call(callback, state)

    def lost(self, cause: BaseException | None) -> None:
        """Enter WAITING if the link is ready, with `cause` as the last error."""
        if self.state is LinkState.READY:
            self.last_error = cause if isinstance(cause, LinkError) else None
            self.enter(LinkState.WAITING)

    async def wait_ready(self, timeout: float) -> None:
        """Wait until the link is ready.

        Raises:
            NotConnectedError: it was closed, or not ready within `timeout` seconds.
        """
        if self.state is LinkState.READY:
            return
        waiter: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._ready_waiters.add(waiter)
        try:
            await run_with_timeout(timeout, waiter)
        except TimeoutError:
            raise self.not_connected() from None
        finally:
            self._ready_waiters.discard(waiter)

    def not_connected(self) -> NotConnectedError:
        """Return the error for a request while there is no link."""
        since = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(self.since))
        why = f"last error: {self.last_error}" if self.last_error else "no attempt has ended yet"
        return NotConnectedError(
            f"not connected to {self.address} since {since} ({why}); check that the robot is on, "
            "that `ip` and `port` are right, and that the network reaches it"
        )


_RETRY_AFTER = 1.0
"""Time without an answer after which RobotInfo is requested once more, in seconds."""


async def open_link(config: LinkConfig) -> Transport:
    """Connect to the chassis.

    Raises:
        NotConnectedError: nothing answers at the address.
        HandshakeError: the other end does not speak the configured transport.
    """
    try:
        return await open_transport(config)
    except OSError as error:
        raise NotConnectedError(error.strerror or str(error) or type(error).__name__) from None
    except TransportClosedError as error:
        raise HandshakeError(str(error)) from None


async def handshake(
    connection: Connection, subscriptions: Subscriptions, config: LinkConfig, log: LogOnce
) -> None:
    """Renew the subscriptions and request RobotInfo; the link is ready with its answer.

    Args:
        connection: a new connection.
        subscriptions: the subscriptions to renew; gets the RobotInfo.
        config: timeout, and id of the robot.
        log: log for a RobotInfo that cannot be read.

    Raises:
        LinkError: the connection ended, or no answer arrived in time.
        HandshakeError: the answer is not a RobotInfo.
    """
    subscriptions.hold()
    try:
        connection.subscribe(subscriptions.wanted, on=True)
        answer = await _request_info(connection, subscriptions, config)
        _check(answer, log)
        subscriptions.release()
    finally:
        subscriptions.discard_held()


def _check(answer: Answer, log: LogOnce) -> None:
    if not answer.ok or answer.type != full_name(RobotInfo):
        reason = answer.msg if not answer.ok else answer.defect or "another type of answer"
        raise HandshakeError(f"the chassis did not send its RobotInfo: {one_line(reason)}")
    if answer.defect:  # perhaps from newer firmware; everything else may work
        log.warn("no snapshot", f"the first values are missing because {answer.defect}")


async def _request_info(
    connection: Connection, subscriptions: Subscriptions, config: LinkConfig
) -> Answer:
    """Request RobotInfo, and again if no answer comes, since a single frame may be lost."""
    remaining = config.handshake_timeout
    message = RobotInfo(robot_id=config.robot_id or None)
    requests: set[asyncio.Task[Answer]] = set()
    try:
        while True:
            request = connection.request(message, remaining, tap=subscriptions.put_snapshot)
            requests.add(asyncio.ensure_future(request))
            done, _ = await asyncio.wait(
                requests,
                timeout=_RETRY_AFTER if remaining > 2 * _RETRY_AFTER else None,
                return_when=asyncio.FIRST_COMPLETED,
            )
            if done:
                return done.pop().result()
            remaining -= _RETRY_AFTER
    except NotConnectedError:  # the connection ended before the request
        raise connection.ended.result() from None
    finally:
        await cancel_and_wait(*requests)


_LOG = logging.getLogger(__name__)
_DEFAULTS = LinkConfig()
_CHANGEABLE = (
    "request_timeout",
    "connect_timeout",
    "handshake_timeout",
    "close_timeout",
    "stable_after",
    "max_in_flight",
    "push_queue",
)
"""Fields of a configuration that can change without a new connection."""


class ReconnectLoop:
    """Connects to the chassis, and again whenever the connection ends, until stopped.

    There is never more than one connection.

    Args:
        config: the configuration.
        status: updated with the state of the link.
        subscriptions: renewed on each connection; gets the pushes.
        stats: counters to add to.
        log: log for failures that repeat.
        drops: log for refused requests.

    Attributes:
        config: current configuration.
        connection: the connection, from the handshake to its end; None if there is none.
    """

    def __init__(
        self,
        config: LinkConfig,
        status: LinkStatus,
        subscriptions: Subscriptions,
        stats: LinkStats,
        log: LogOnce,
        drops: DropLog,
    ) -> None:
        self.config = config
        self.connection: Connection | None = None
        self._status = status
        self._subscriptions = subscriptions
        self._stats = stats
        self._log = log
        self._drops = drops
        self._current: asyncio.Task[None] | None = None
        """The task that connects; None when stopped."""
        self._tasks: set[asyncio.Task[None]] = set()
        """The current task, and cancelled ones that close their connection."""

    @property
    def running(self) -> bool:
        """True between `start` and `stop`."""
        return self._current is not None

    @property
    def task_count(self) -> int:
        """Number of tasks that have not ended."""
        return len(self._tasks)

    def start(self) -> None:
        """Start connecting."""
        self._current = self._add_task(self._run(), "link to the chassis")

    async def stop(self) -> None:
        """Stop connecting and close the connection, within `close_timeout`."""
        self._current = None
        tasks = tuple(self._tasks)
        for task in tasks:
            task.cancel()
        if tasks:
            await asyncio.wait(tasks)
        if not self.running and self._status.state is not LinkState.STOPPED:
            self._status.enter(LinkState.STOPPED)

    async def reconfigure(
        self, config: LinkConfig, farewell: Callable[[], Awaitable[None]] | None = None
    ) -> None:
        """Apply a new configuration; reconnect if a changed field requires it.

        Args:
            config: the configuration.
            farewell: sends last requests, if `config` addresses another robot. The connection to
                the former robot is closed when it has ended.
        """
        previous, self.config = self.config, config
        self._status.address = config.address
        if self.connection is not None:
            self.connection.config = config
        is_other_robot = not config.addresses_same_robot(previous)
        if is_other_robot:
            self._leave_robot(previous.address)
        if self._current is not None and _fixed_part(config) != _fixed_part(previous):
            earlier = tuple(self._tasks)
            if is_other_robot and farewell is not None:
                self._add_task(self._end_after(farewell, self._current), "link farewell")
            else:
                self._current.cancel()
            self.start()
            if earlier:
                await asyncio.wait(earlier)

    def _leave_robot(self, address: str) -> None:
        """Fail all requests to the robot, and forget what it reported."""
        cause = ConnectionLostError(f"the agent turned from {address} to another robot")
        if self.connection is not None:
            self.connection.retire(cause)
        self._status.lost(cause)
        self._forget_times()
        self._log.clear()
        self._subscriptions.forget_robot()

    async def _end_after(
        self, farewell: Callable[[], Awaitable[None]], task: asyncio.Task[None]
    ) -> None:
        """Cancel the task of the former connection after the last requests over it."""
        try:
            await farewell()
        except Exception:  # the new link must not depend on it
            _LOG.exception("the last requests to the former robot failed")
        finally:
            self._forget_times()  # of the answer to the last request
            task.cancel()

    def _forget_times(self) -> None:
        self._stats.round_trip = self._stats.clock_offset = None

    def _add_task(self, work: Coroutine[Any, Any, None], name: str) -> asyncio.Task[None]:
        task = asyncio.get_running_loop().create_task(work, name=name)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    async def _run(self) -> None:
        me = asyncio.current_task()
        if earlier := self._tasks - {me}:
            await asyncio.wait(earlier)
        self._status.last_error = None
        backoff = Backoff(self.config.backoff_min, self.config.backoff_max)
        while self._current is me:
            config = self.config
            self._status.enter(LinkState.CONNECTING)
            try:
                connection = await self._connect(config)
                if await self._serve(connection) >= config.stable_after:
                    backoff.reset()
            except LinkError as error:
                self._log_failure(error, f"cannot connect to {config.address}: {error}")
            except Exception as error:  # the loop must survive whatever a library raises
                _LOG.debug("the link to %s failed", config.address, exc_info=True)
                self._log_failure(HandshakeError(repr(error)), f"internal error: {error!r}")
            if self._status.state is not LinkState.WAITING:
                self._status.enter(LinkState.WAITING)
            await asyncio.sleep(backoff.next())

    async def _connect(self, config: LinkConfig) -> Connection:
        transport = await open_link(config)
        codec = client_codec(config)
        connection = Connection(
            transport,
            codec,
            config,
            self._stats,
            self._log,
            self._drops,
            partial(self._subscriptions.put_push, codec),
        )
        self.connection = connection  # new subscriptions go to it; requests wait for READY
        try:
            await handshake(connection, self._subscriptions, config, self._log)
        except BaseException as error:
            self.connection = None
            cause = error if isinstance(error, LinkError) else NotConnectedError("given up")
            await connection.close(cause)
            raise
        return connection

    async def _serve(self, connection: Connection) -> float:
        """Keep the link ready until the connection ends; return the duration, in seconds."""
        loop = asyncio.get_running_loop()
        ready_at = loop.time()
        cause: LinkError = ConnectionLostError("the link was closed")
        try:
            self._status.last_error = None
            self._log.clear()
            self._stats.connects += 1
            _LOG.info("connected to %s", self.config.address)
            self._status.enter(LinkState.READY)
            cause = await asyncio.shield(connection.ended)
            lasted = loop.time() - ready_at
            self._log_failure(cause, f"lost the link to {self.config.address}: {cause}")
        finally:
            self.connection = None
            self._status.lost(cause)  # first, because the close may take long
            await connection.close(cause)
        return lasted

    def _log_failure(self, error: LinkError, text: str) -> None:
        self._status.last_error = error
        self._log.warn(f"connect: {type(error).__name__}: {error}", text)


def _fixed_part(config: LinkConfig) -> LinkConfig:
    """Return a configuration without the fields that can change while the connection stays."""
    return replace(config, **{name: getattr(_DEFAULTS, name) for name in _CHANGEABLE})
