"""Pause, resumption and cancellation of a task or an action of the robot."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
from collections.abc import Callable, Coroutine
from typing import Any

from woosh_robot_agent.link import Answer, LinkError, NotConnectedError, TooManyRequestsError
from woosh_robot_agent.link.reports import LogOnce
from woosh_robot_agent.link.tasks import run_with_timeout
from woosh_robot_agent.vda5050.orders.legs import Control
from woosh_robot_agent.vda5050.robot.link import RobotLink

_LOG = logging.getLogger(__name__)
_EFFECT_WITHIN = 1.5
"""Maximum time from a resumption to the report of its effect, in seconds."""


class Controller:
    """Pauses, resumes and cancels one task or action. Used in the event loop of the link.

    A pause or a cancellation is repeated until the robot reports its effect: it does no harm,
    because it only stops the robot. A pause is sent again if the robot goes on. A resumption waits
    for a link, and reaches the robot at most once. After a cancellation, no other command is sent.

    Args:
        name: name of the task or the action, for the log.
        answered: called with each command that was answered, or has failed, e.g. was not sent.
        may_send: returns False while the robot would apply the commands to another task or action.

    Attributes:
        paused: True if the robot has reported that it is paused.
        stays_paused: True if it is paused, and no resumption was sent that may still take effect.
        cancel_accepted: True if the robot has accepted a cancellation, and has not reported since
            that it goes on.
    """

    def __init__(
        self,
        link: RobotLink,
        name: str,
        send: Callable[[Control], Coroutine[Any, Any, Answer]],
        answered: Callable[[Control], None],
        may_send: Callable[[], bool] = lambda: True,
    ) -> None:
        self._link = link
        self._name = name
        self._send_command = send
        self._answered = answered
        self._may_send = may_send
        self.paused = False
        self.stays_paused = False
        self.cancel_accepted = False
        self._wanted: Control | None = None
        """Command that the robot must obey; None without a command."""
        self._is_pause_pending = False
        """True if the last command was a pause that was not refused, and has had no effect yet."""
        self._is_own_pause = False
        """True from a pause that was sent and not refused, or adopted, to the resumption."""
        self._resumed_at = -math.inf
        """Loop time of a resumption whose effect was not reported yet; else minus infinity."""
        self._has_ended = False
        self._wake = asyncio.Event()
        """Set to end the pause before the wanted command is sent again."""
        self._log = LogOnce(_LOG)

    def want(self, control: Control) -> None:
        """Replace the wanted command, unless it is a cancellation; send it as soon as possible."""
        if self._wanted is not Control.CANCEL:
            self._wanted = control
            self._wake.set()
            self._start_sending()

    def withdraw_pause(self) -> None:
        """Stop repeating a pause."""
        if self._wanted is Control.PAUSE:
            self._wanted = None

    def end_own_pause(self) -> None:
        """Resume, unless the task or action was paused by somebody else: then it stays paused."""
        if self._is_own_pause:
            self.want(Control.RESUME)
        else:
            self.withdraw_pause()

    def adopt_pause(self) -> None:
        """Treat the current pause as an own one, which `end_own_pause` ends."""
        self._is_own_pause |= self.paused

    def disown_pause(self) -> None:
        """Treat an own pause as one by somebody else, which `end_own_pause` does not end."""
        self._is_own_pause = False

    def update(self, paused: bool) -> bool:
        """Set `paused` and `stays_paused` by a report; return True if one of them has changed."""
        before = (self.paused, self.stays_paused)
        self.paused, self.cancel_accepted = paused, False
        if paused:
            self._is_pause_pending = False
        else:
            self._resumed_at = -math.inf
        now = asyncio.get_running_loop().time()
        # soon after a resumption, the report may be older than its effect
        self.stays_paused = paused and now >= self._resumed_at + _EFFECT_WITHIN
        changed = (self.paused, self.stays_paused) != before
        if changed:
            self._wake.set()
        self._start_sending()
        return changed

    def send_now(self) -> None:
        """Send the wanted command now instead of after the pause, e.g. after a reconnect."""
        self._wake.set()

    def end(self) -> None:
        """Command nothing more, whatever is wanted: the task or action has ended."""
        self._has_ended = True
        self._wake.set()

    def _start_sending(self) -> None:
        """Start to send the wanted command, unless the robot has obeyed it."""
        if self._update_wanted() is not None:
            self._link.background.start_once(self._send_until_obeyed, self)

    async def _send_until_obeyed(self) -> None:
        """Send the wanted command until the robot has obeyed it; a resumption only once."""
        while (control := self._update_wanted()) is not None:
            self._wake.clear()
            if self._link.ready and self._may_send():
                was_own_pause = self._is_own_pause
                self._is_pause_pending = self._is_own_pause = control is Control.PAUSE
                if control is Control.RESUME:  # sent once
                    self._wanted, self.stays_paused = None, False
                    self._resumed_at = asyncio.get_running_loop().time()
                self._link.background.start(self._send(control, was_own_pause))
            with contextlib.suppress(TimeoutError):
                await run_with_timeout(self._link.timing.repeat_after, self._wake.wait())

    def _update_wanted(self) -> Control | None:
        """Forget a resumption of what is not paused, and return the command to send.

        Returns:
            None if there is no command, or the robot has obeyed it, or the task or action has
            ended. An obeyed pause stays wanted, because it must last.
        """
        if self._has_ended:
            return None
        if self._wanted is Control.RESUME and not (self.paused or self._is_pause_pending):
            self._wanted, self._is_own_pause = None, False
        if self._wanted is Control.PAUSE and self.stays_paused:
            return None
        return self._wanted

    async def _send(self, control: Control, was_own_pause: bool) -> None:
        """Send a command once, and handle its answer; a refused pause is not an own one."""
        command = f"{control.value} of {self._name}"
        try:
            answer = await self._send_command(control)
        except LinkError as error:
            self._log.warn(command, f"the {command} was not sent or not answered: {error}")
            is_unsent = isinstance(error, NotConnectedError | TooManyRequestsError)
            if is_unsent and control is Control.RESUME:
                self._is_own_pause = True
                if self._wanted is None:
                    self._wanted = control  # `_send_until_obeyed` tries again
        else:
            self.cancel_accepted |= answer.ok and control is Control.CANCEL
            if not answer.ok:
                if control is Control.PAUSE:
                    self._is_pause_pending = False
                    self._is_own_pause &= was_own_pause  # an earlier pause may have been accepted
                elif control is Control.RESUME:
                    self._resumed_at = -math.inf
                    self.stays_paused = self.paused
                    self._link.changed()
                self._log.warn(command, f"the robot refused the {command}: {answer.reason}")
        self._answered(control)
