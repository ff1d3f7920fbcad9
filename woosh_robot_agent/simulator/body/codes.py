"""Status codes: a log of events, and the current problems."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from woosh_robot_agent.pb.robot import robot_count_pb2
from woosh_robot_agent.pb.util import action_pb2 as util_action_pb2

_MAX_RECENT = 50
"""Number of status codes that are kept."""


class Code(NamedTuple):
    """The number of a status code and its text."""

    number: int
    text: str


NEW_NAVIGATION = Code(130104000000, "new navigation task received, obstacle avoidance starts")
DRIVING_STRAIGHT = Code(130104000061, "driving straight")
EMERGENCY_STOP = Code(110101000010, "emergency stop pressed")
LOCALISATION_LOST = Code(120102000011, "localisation lost")
BATTERY_LOW = Code(110103000020, "battery low")
OBSTACLE_AVOIDED = Code(130104000031, "obstacle avoided")
KEY_SWITCH_MANUAL = Code(110101000011, "key switch turned to manual")
OBSTACLE_IN_THE_WAY = Code(130104000030, "an obstacle stands in the way")
TASK_FAILED = Code(140105000009, "task failed")

Publish = Callable[[robot_count_pb2.StatusCode], None]


class Codes:
    """The log of status codes.

    Args:
        publish: Adds time, state and task to a new code, and sends it to the clients.

    Attributes:
        recent: The last 50 codes, oldest first.
    """

    def __init__(self, publish: Publish) -> None:
        self.recent: deque[robot_count_pb2.StatusCode] = deque(maxlen=_MAX_RECENT)
        self._publish = publish
        self._abnormal: dict[int, robot_count_pb2.StatusCode] = {}

    @property
    def abnormal(self) -> list[robot_count_pb2.StatusCode]:
        """Codes of the current problems, in the order in which they began."""
        return list(self._abnormal.values())

    def report(
        self,
        code: Code,
        level: robot_count_pb2.StatusCode.Level,
        kind: util_action_pb2.Type = util_action_pb2.kTypeUndefined,
        detail: str = "",
    ) -> robot_count_pb2.StatusCode:
        """Log a status code and send it to the clients.

        Args:
            code: The code.
            level: Its severity.
            kind: The kind of action that it is about.
            detail: Further text.
        """
        status = robot_count_pb2.StatusCode(
            code=code.number,
            msg=f"{code.text}: {detail}" if detail else code.text,
            level=level,
            type=kind,
        )
        self._publish(status)
        self.recent.append(status)
        return status

    def watch(self, code: Code, level: robot_count_pb2.StatusCode.Level, *, present: bool) -> None:
        """Report a code when its cause appears, and list it as abnormal until the cause is gone."""
        if not present:
            self._abnormal.pop(code.number, None)
        elif code.number not in self._abnormal:
            self._abnormal[code.number] = self.report(code, level)
