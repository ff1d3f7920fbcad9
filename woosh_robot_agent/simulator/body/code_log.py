"""The log of status codes."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode
from woosh_robot_agent.pb.util import action_pb2 as util_action_pb2
from woosh_robot_agent.simulator.status_codes import Code, Language

_MAX_RECENT = 50
"""Number of status codes that are kept."""


class CodeLog:
    """The log of status codes.

    Args:
        publish: called with each new code; adds time, state and task to it, and sends it to the
            clients.

    Attributes:
        recent: the last 50 codes, oldest first.
    """

    def __init__(self, language: Language, publish: Callable[[StatusCode], None]) -> None:
        self.recent: deque[StatusCode] = deque(maxlen=_MAX_RECENT)
        self._language = language
        self._publish = publish
        self._abnormal: dict[int, StatusCode] = {}
        """Codes of the current problems, by number."""

    @property
    def abnormal(self) -> list[StatusCode]:
        """Codes of the current problems, in the order in which they began."""
        return list(self._abnormal.values())

    def report(
        self,
        code: Code,
        kind: util_action_pb2.Type = util_action_pb2.kTypeUndefined,
        detail: str = "",
    ) -> StatusCode:
        """Log a status code, send it to the clients and return it.

        Args:
            kind: type of the action that the code concerns; `kTypeUndefined` for none.
            detail: further text in English, which is left out in other languages; may be empty.
        """
        text = code.text(self._language)
        if detail and self._language == "en":
            text += f": {detail}"
        status = StatusCode(code=code.number, msg=text, level=code.level, type=kind)
        self._publish(status)
        self.recent.append(status)
        return status

    def watch(self, code: Code, *, present: bool) -> None:
        """Report a code when its cause appears, and list it as abnormal until the cause is gone.

        Args:
            present: True if the cause is present at this moment.
        """
        if not present:
            self._abnormal.pop(code.number, None)
        elif code.number not in self._abnormal:
            self._abnormal[code.number] = self.report(code)
