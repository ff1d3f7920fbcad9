"""Cancellation of a goal at the request of its client."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable

from woosh_robot_agent.link import Answer, LinkError

_LOG = logging.getLogger(__name__)


class Cancellation:
    """Forwards the cancel requests of a goal's client to the chassis, one at a time.

    A request that the chassis did not answer stays pending. It is sent again only when `send_soon`
    is called again: the cancel request for a task does not name the task, so it may only be sent
    while the goal is running.

    Args:
        name: name of the goal, for the log.
        send: sends the cancel request to the chassis.
        replaced: waits until it is known if a newer goal replaced this one; returns True if so.
        accepted: called when the chassis has accepted the cancel.
    """

    def __init__(
        self,
        name: str,
        send: Callable[[], Awaitable[Answer]],
        replaced: Callable[[], Awaitable[bool]],
        accepted: Callable[[], None],
    ) -> None:
        self.requested = False
        """True once the client has asked, even if the goal has not handled that event yet."""
        self.pending = False
        """True if a cancel has to be sent."""
        self._name = name
        self._send = send
        self._replaced = replaced
        self._accepted = accepted
        self._task: asyncio.Task[None] | None = None

    def send_soon(self) -> None:
        """Send a pending cancel unless one is in flight. Call it only for an accepted goal."""
        if self.pending and (self._task is None or self._task.done()):
            self._task = asyncio.get_running_loop().create_task(self._run(), name="goal: cancel")

    def stop(self) -> None:
        """Stop sending."""
        if self._task is not None:
            self._task.cancel()

    async def _run(self) -> None:
        if await self._replaced():
            return  # the cancel would hit the newer goal, and this one is over
        while self.pending:  # repeat if the client has asked again meanwhile
            self.pending = False
            try:
                answer = await self._send()
            except LinkError as error:
                self.pending = True
                _LOG.warning(
                    "cannot cancel %s, which is still running; trying again when the chassis "
                    "reports on the goal: %s",
                    self._name,
                    error,
                )
                return
            if answer.ok:
                self._accepted()
            else:
                _LOG.warning(
                    "the chassis refused to cancel %s, which is still running: %s",
                    self._name,
                    answer.msg,
                )
