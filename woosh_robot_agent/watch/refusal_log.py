"""Log of the commands that the chassis refuses, with the reason as far as it is known."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Container, Coroutine
from typing import Any

from woosh_robot_agent.link import ChassisClient
from woosh_robot_agent.link.log_once import LogOnce
from woosh_robot_agent.motion import AnsweredCommand, MotionGate
from woosh_robot_agent.readiness import Objection
from woosh_robot_agent.refusals import RefusalExplainer, type_of
from woosh_robot_agent.watch.command_names import command_name

_LOG = logging.getLogger(__name__)
GOAL_CANCEL = "the cancel of a goal"
"""Source of the cancels of goals, which log their refusals themselves."""


class RefusalLog:
    """Logs each refusal once, until a command of the same kind succeeds.

    Args:
        chassis: the link.
        gate: sender of the commands.
        explainer: finds the reasons.
        silent: sources that log their refusals themselves.
    """

    def __init__(
        self,
        chassis: ChassisClient,
        gate: MotionGate,
        explainer: RefusalExplainer,
        silent: Container[str] = (),
    ) -> None:
        self._explainer = explainer
        self._silent = silent
        self._logs: dict[str, LogOnce] = {}
        """Logs of the commands whose last answer was a refusal, by name."""
        self._pending: dict[tuple[str, str], asyncio.Task[None]] = {}
        """Tasks that wait for a reason, by name of the command and the chassis's words."""
        chassis.on_robot_changed(self._logs.clear)
        gate.on_answered(self._answered)

    @property
    def pending(self) -> int:
        """Number of refusals whose reason is not known yet."""
        return len(self._pending)

    def _answered(self, command: AnsweredCommand) -> None:
        if command.answer.ok and not self._logs:
            return
        name, msg = command_name(command), command.answer.msg
        if command.answer.ok:
            self._logs.pop(name, None)
            return
        if name not in self._silent and (name, msg) not in self._pending:
            # made now, because the link may turn to another robot before the task runs
            log = self._logs.setdefault(name, LogOnce(_LOG))
            reasons = self._explainer.reasons(type_of(command.message))
            work = self._explain(name, msg, reasons, log)
            task = asyncio.get_running_loop().create_task(work, name="reason of a refusal")
            self._pending[name, msg] = task
            task.add_done_callback(lambda _: self._pending.pop((name, msg)))

    @staticmethod
    async def _explain(
        name: str, msg: str, reasons: Coroutine[Any, Any, list[Objection]], log: LogOnce
    ) -> None:
        why = "; ".join(
            f"{each.reason}: {each.remedy}" if each.remedy else each.reason
            for each in await reasons
        )
        log.warn(
            f"{msg}: {why}", f"the chassis refused {name}: {msg}" + (f" ({why})" if why else "")
        )
