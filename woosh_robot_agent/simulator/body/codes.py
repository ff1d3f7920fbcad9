"""The log of status codes, and the list of current problems."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from woosh_robot_agent.pb.robot import robot_count_pb2
from woosh_robot_agent.pb.util import action_pb2 as util_action_pb2
from woosh_robot_agent.simulator.body.statistics import Statistics
from woosh_robot_agent.simulator.status_codes import Code, Language

_MAX_RECENT = 50
"""Number of status codes that are kept."""


Publish = Callable[[robot_count_pb2.StatusCode], None]


class Codes:
    """The log of status codes.

    Args:
        language: Language of the texts.
        publish: Adds time, state and task to a new code, and sends it to the clients.
        statistics: Counts the problems: codes from warnings upwards, and those of `watch`.

    Attributes:
        recent: The last 50 codes, oldest first.
    """

    def __init__(self, language: Language, publish: Publish, statistics: Statistics) -> None:
        self.recent: deque[robot_count_pb2.StatusCode] = deque(maxlen=_MAX_RECENT)
        self._language = language
        self._publish = publish
        self._statistics = statistics
        self._abnormal: dict[int, robot_count_pb2.StatusCode] = {}

    @property
    def abnormal(self) -> list[robot_count_pb2.StatusCode]:
        """Codes of the current problems, in the order in which they began."""
        return list(self._abnormal.values())

    def report(
        self,
        code: Code,
        kind: util_action_pb2.Type = util_action_pb2.kTypeUndefined,
        detail: str = "",
    ) -> None:
        """Log a status code and send it to the clients.

        Args:
            code: The code.
            kind: Kind of the action that the code is about.
            detail: Further text, in English; it is left out in other languages.
        """
        status = self._report(code, kind, detail)
        if code.level >= robot_count_pb2.StatusCode.kWarn:
            self._statistics.problem_occurred(status)

    def watch(self, code: Code, *, present: bool) -> None:
        """Report a code when its cause appears, and list it as abnormal until the cause is gone."""
        if present and code.number not in self._abnormal:
            status = self._abnormal[code.number] = self._report(code)
            self._statistics.problem_began(status)
        elif not present and code.number in self._abnormal:
            del self._abnormal[code.number]
            self._statistics.problem_ended(code.number)

    def _report(
        self,
        code: Code,
        kind: util_action_pb2.Type = util_action_pb2.kTypeUndefined,
        detail: str = "",
    ) -> robot_count_pb2.StatusCode:
        text = code.text(self._language)
        if detail and self._language == "en":
            text += f": {detail}"
        status = robot_count_pb2.StatusCode(code=code.number, msg=text, level=code.level, type=kind)
        self._publish(status)
        self.recent.append(status)
        return status
