"""The reconnect loop, the only place that retries a connection."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Coroutine
from dataclasses import replace
from functools import partial
from typing import Any

from woosh_robot_agent.link.backoff import Backoff
from woosh_robot_agent.link.codecs.choice import client_codec
from woosh_robot_agent.link.config import LinkConfig
from woosh_robot_agent.link.connection import Connection
from woosh_robot_agent.link.drop_log import DropLog
from woosh_robot_agent.link.errors import (
    ConnectionLostError,
    HandshakeError,
    LinkError,
    NotConnectedError,
)
from woosh_robot_agent.link.handshake import handshake, open_link
from woosh_robot_agent.link.log_once import LogOnce
from woosh_robot_agent.link.state import LinkState, LinkStatus
from woosh_robot_agent.link.stats import LinkStats
from woosh_robot_agent.link.subscriptions import Subscriptions

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
        self._stats.round_trip = None
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
            task.cancel()

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
