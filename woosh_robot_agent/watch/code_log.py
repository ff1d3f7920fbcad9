"""Log of the status codes that the chassis sends, with their meaning."""

from __future__ import annotations

import logging
import time
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.link import Body, ChassisClient
from woosh_robot_agent.pb.robot.robot_count_pb2 import AbnormalCodes, StatusCode
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo
from woosh_robot_agent.recent_dict import RecentDict
from woosh_robot_agent.status_codes import explained

_LOG = logging.getLogger(__name__)

QUIET = 60.0
"""Time after which a code is logged again if it has not been sent meanwhile, in seconds."""
_MAX_CODES = 500
"""Maximum number of codes that are remembered."""
_LEVELS = {StatusCode.kWarn: logging.WARNING, StatusCode.kFault: logging.ERROR}
"""Logging levels, by level of the status code. Other codes are logged at DEBUG at most."""


class CodeLog:
    """Logs warnings and faults of the chassis, each once while it lasts.

    A code lasts while AbnormalCodes contains it. Any other code lasts until it has not been sent
    for `QUIET` seconds.

    Args:
        chassis: the link; used in its event loop only.
    """

    def __init__(self, chassis: ChassisClient) -> None:
        self._logged: RecentDict[int, float] = RecentDict(_MAX_CODES)
        """Monotonic times at which the logged codes were last sent."""
        self._abnormal: frozenset[int] = frozenset()
        """The codes in the last AbnormalCodes."""
        chassis.on_robot_changed(self._forget)
        chassis.on_snapshot(self._snapshot)
        chassis.subscribe_raw(StatusCode, self._pushed)
        chassis.subscribe(AbnormalCodes, self._abnormal_changed)

    def _forget(self) -> None:
        self._logged.clear()
        self._abnormal = frozenset()

    def _snapshot(self, info: RobotInfo) -> None:
        self._abnormal_changed(info.abnormal_codes)

    def _abnormal_changed(self, codes: AbnormalCodes) -> None:
        before, self._abnormal = self._abnormal, frozenset(code.code for code in codes.scs)
        for number in before - self._abnormal:
            self._logged.pop(number, None)
        for code in codes.scs:
            self._log(code)

    def _pushed(self, body: Body) -> None:
        if body.read(_is_logged_json, _is_logged):
            self._log(body.message())

    def _log(self, code: StatusCode) -> None:
        level = _LEVELS.get(code.level, logging.DEBUG)
        now = time.monotonic()
        last = self._logged.get(code.code)
        self._logged[code.code] = now
        if last is None or (now - last > QUIET and code.code not in self._abnormal):
            _LOG.log(level, "the robot reports %s", explained(code.code, code.msg))


def _is_logged_json(value: Any) -> bool:
    """Return True if a status code in JSON has a level that is logged."""
    return isinstance(value, dict) and value.get("level") not in _UNLOGGED_JSON


def _is_logged(code: Message) -> bool:
    return isinstance(code, StatusCode) and code.level in _LEVELS


_UNLOGGED_JSON = (None, StatusCode.kNormal, StatusCode.kTips, "kNormal", "kTips")
"""Levels that are not logged, as written in JSON."""
