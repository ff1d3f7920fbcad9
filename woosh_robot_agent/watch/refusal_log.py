"""Log of the commands that the chassis refuses, with the reason as far as it is known."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Container

from woosh_robot_agent.endpoints import ACTIONS
from woosh_robot_agent.link.log_once import LogOnce
from woosh_robot_agent.motion import AnsweredCommand, MotionGate
from woosh_robot_agent.refusals import RefusalExplainer, type_of

_LOG = logging.getLogger(__name__)
_ACTION_NAMES = {action.arg: action.name for action in ACTIONS}


class RefusalLog:
    """Logs each refusal once, until a command of the same kind succeeds.

    Args:
        gate: sender of the commands.
        explainer: finds the reasons.
        silent: sources that log their refusals themselves.
    """

    def __init__(
        self, gate: MotionGate, explainer: RefusalExplainer, silent: Container[str] = ()
    ) -> None:
        self._explainer = explainer
        self._silent = silent
        self._logs: dict[str, LogOnce] = {}
        """Logs of the commands whose last answer was a refusal, by name."""
        self._pending: dict[str, asyncio.Task[None]] = {}
        """Tasks that wait for a reason, by name of the command."""
        gate.on_answered(self._answered)

    @property
    def pending(self) -> int:
        """Number of refusals whose reason is not known yet."""
        return len(self._pending)

    def _answered(self, command: AnsweredCommand) -> None:
        if command.answer.ok and not self._logs:
            return
        request_type = type_of(command.message)
        name = command.source or _ACTION_NAMES.get(request_type, request_type)
        if command.answer.ok:
            self._logs.pop(name, None)
        elif name not in self._silent and name not in self._pending:
            work = self._explain(name, request_type, command.answer.msg)
            task = asyncio.get_running_loop().create_task(work, name="reason of a refusal")
            self._pending[name] = task
            task.add_done_callback(lambda _: self._pending.pop(name))

    async def _explain(self, name: str, request_type: str, msg: str) -> None:
        reasons = await self._explainer.reasons(request_type)
        why = "; ".join(
            f"{each.reason}: {each.remedy}" if each.remedy else each.reason for each in reasons
        )
        log = self._logs.setdefault(name, LogOnce(_LOG))
        log.warn(
            f"{msg}: {why}", f"the chassis refused {name}: {msg}" + (f" ({why})" if why else "")
        )
