"""State of the link: its values, callbacks on changes, and waiting until it is ready."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from enum import Enum

from woosh_robot_agent.link.callbacks import call
from woosh_robot_agent.link.errors import LinkError, NotConnectedError
from woosh_robot_agent.link.timeouts import run_with_timeout


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
