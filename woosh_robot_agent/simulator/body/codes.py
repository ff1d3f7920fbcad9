"""The log of status codes, and the list of current problems."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from woosh_robot_agent.pb.robot import robot_count_pb2
from woosh_robot_agent.pb.util import action_pb2 as util_action_pb2
from woosh_robot_agent.simulator.status_codes import Code, Language

_MAX_RECENT = 50
"""Number of status codes that are kept."""


Publish = Callable[[robot_count_pb2.StatusCode], None]


class Codes:
    """The log of status codes.

    Args:
        language: Language of the texts.
        publish: Adds time, state and task to a new code, and sends it to the clients.

    Attributes:
        recent: The last 50 codes, oldest first.
    """

    def __init__(self, language: Language, publish: Publish) -> None:
        self.recent: deque[robot_count_pb2.StatusCode] = deque(maxlen=_MAX_RECENT)
        self._language = language
        self._publish = publish
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
    ) -> robot_count_pb2.StatusCode:
        """Log a status code and send it to the clients.

        Args:
            code: The code.
            kind: The kind of action that it is about.
            detail: Further text, in English; it is left out in other languages.
        """
        text = code.text(self._language)
        if detail and self._language == "en":
            text += f": {detail}"
        status = robot_count_pb2.StatusCode(code=code.number, msg=text, level=code.level, type=kind)
        self._publish(status)
        self.recent.append(status)
        return status

    def watch(self, code: Code, *, present: bool) -> None:
        """Report a code when its cause appears, and list it as abnormal until the cause is gone."""
        if not present:
            self._abnormal.pop(code.number, None)
        elif code.number not in self._abnormal:
            self._abnormal[code.number] = self.report(code)
