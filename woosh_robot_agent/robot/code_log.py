"""Log of the status codes that the chassis sends, and of the commands that it refuses."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Coroutine
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.link import Body, ChassisClient
from woosh_robot_agent.link.reports import LogOnce
from woosh_robot_agent.motion import AnsweredCommand, MotionGate
from woosh_robot_agent.pb.robot.robot_count_pb2 import AbnormalCodes, StatusCode
from woosh_robot_agent.robot.readiness import Objection
from woosh_robot_agent.robot.refusals import RefusalExplainer, type_of
from woosh_robot_agent.robot.status_codes import explained
from woosh_robot_agent.robot.who_drives import command_name

_LOG = logging.getLogger(__name__)

QUIET = 60.0
"""Time after which a code that was not sent meanwhile is logged again, in seconds."""
_LEVELS = {StatusCode.kWarn: logging.WARNING, StatusCode.kFault: logging.ERROR}
"""Logging levels of warnings and faults, by level of the status code."""


class CodeLog:
    """Logs warnings and faults of the chassis, each status code once while it lasts.

    A code lasts while AbnormalCodes contains it. Any other code lasts until it has not been sent
    for `QUIET` seconds. Used in the event loop of the link.
    """

    def __init__(self, chassis: ChassisClient) -> None:
        self._log = LogOnce(_LOG, QUIET)
        self._abnormal: frozenset[int] = frozenset()
        """The codes in the last AbnormalCodes."""
        chassis.on_snapshot(lambda info: self._abnormal_changed(info.abnormal_codes))
        chassis.subscribe_raw(StatusCode, self._pushed)
        chassis.subscribe(AbnormalCodes, self._abnormal_changed)

    def _abnormal_changed(self, codes: AbnormalCodes) -> None:
        """Log the codes that last; forget those that have ended."""
        before, self._abnormal = self._abnormal, frozenset(code.code for code in codes.scs)
        for number in before - self._abnormal:  # a code that comes back is logged again
            self._log.clear(str(number))
        for code in codes.scs:
            if code.code not in before:
                self._log_code(code)

    def _pushed(self, body: Body) -> None:
        """Log a status code if it is a warning or a fault."""
        if body.read(_is_logged_json, _is_logged):  # without decoding the other codes
            code = body.message()
            if code.code not in self._abnormal:  # else it is logged already
                self._log_code(code)

    def _log_code(self, code: StatusCode) -> None:
        level = _LEVELS.get(code.level, logging.DEBUG)
        text = f"the robot reports {explained(code.code, code.msg)}"
        self._log.warn(str(code.code), text, level)


def _is_logged_json(value: Any) -> bool:
    """Return True if a status code in JSON has a level that is logged."""
    return isinstance(value, dict) and value.get("level") not in _UNLOGGED_JSON


def _is_logged(code: Message) -> bool:
    return isinstance(code, StatusCode) and code.level in _LEVELS


_UNLOGGED_JSON = (None, StatusCode.kNormal, StatusCode.kTips, "kNormal", "kTips")
"""Levels that are not logged, as written in JSON."""


GOAL_CANCEL = "the cancel of a goal"
"""Source of the cancel requests of goals: goals log the refusals of these requests themselves."""


class RefusalLog:
    """Logs each refusal of a command with its reason, unless it repeats the last ones.

    It is logged again once a command of its name has succeeded, or after 10 minutes without one.
    """

    def __init__(self, gate: MotionGate, explainer: RefusalExplainer) -> None:
        self._explainer = explainer
        self._logs: dict[str, LogOnce] = {}
        """Logs of the commands whose last answer was a refusal, by name."""
        self._pending: dict[tuple[str, str], asyncio.Task[None]] = {}
        """Tasks that wait for a reason, by name of the command and the chassis's words."""
        gate.on_answered(self._answered)

    def _answered(self, command: AnsweredCommand) -> None:
        """Start to explain a refusal; forget earlier refusals after a success."""
        if command.answer.ok and not self._logs:  # the usual case needs no name
            return
        name, msg = command_name(command), command.answer.reason
        if command.answer.ok:
            self._logs.pop(name, None)
            return
        if name != GOAL_CANCEL and (name, msg) not in self._pending:
            # taken now: a success before the task runs removes it from `_logs`
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
        """Log a refusal with its reasons, once they are known."""
        why = "; ".join(map(str, await reasons))
        log.warn(
            f"{msg}: {why}", f"the chassis refused {name}: {msg}" + (f" ({why})" if why else "")
        )
