"""Status codes: what happened, and what is wrong now."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from woosh_robot_agent.pb.robot import robot_count_pb2
from woosh_robot_agent.pb.util import action_pb2 as util_action_pb2

KEPT = 50


class Code(NamedTuple):
    """A status code and its text."""

    number: int
    text: str


NEW_NAVIGATION = Code(130104000000, "new navigation task received, obstacle avoidance starts")
DRIVING_STRAIGHT = Code(130104000061, "driving straight")
EMERGENCY_STOP = Code(110101000010, "emergency stop pressed")
LOCALISATION_LOST = Code(120102000011, "localisation lost")
BATTERY_LOW = Code(110103000020, "battery low")
AVOIDED = Code(130104000031, "obstacle avoided")
KEY_AT_MANUAL = Code(110101000011, "key switch turned to manual")
IMPEDED = Code(130104000030, "an obstacle stands in the way")
TASK_FAILED = Code(140105000009, "task failed")

Stamp = Callable[[robot_count_pb2.StatusCode], None]


class Codes:
    """The log of status codes.

    Args:
        stamp: Fills in time, state and task of a new code, and sends it out.

    Attributes:
        recent: The last 50, oldest first.
    """

    def __init__(self, stamp: Stamp) -> None:
        self.recent: deque[robot_count_pb2.StatusCode] = deque(maxlen=KEPT)
        self._stamp = stamp
        self._abnormal: dict[int, robot_count_pb2.StatusCode] = {}

    @property
    def abnormal(self) -> list[robot_count_pb2.StatusCode]:
        """What is wrong now, in the order in which it began."""
        return list(self._abnormal.values())

    def report(
        self,
        code: Code,
        level: robot_count_pb2.StatusCode.Level,
        kind: util_action_pb2.Type = util_action_pb2.kTypeUndefined,
        detail: str = "",
    ) -> robot_count_pb2.StatusCode:
        """Log a code of a kind of action, with more to say about it in `detail`."""
        status = robot_count_pb2.StatusCode(
            code=code.number,
            msg=f"{code.text}: {detail}" if detail else code.text,
            level=level,
            type=kind,
        )
        self._stamp(status)
        self.recent.append(status)
        return status

    def watch(self, code: Code, level: robot_count_pb2.StatusCode.Level, *, present: bool) -> None:
        """Log a code when its cause appears, and keep it as abnormal until the cause is gone."""
        if not present:
            self._abnormal.pop(code.number, None)
        elif code.number not in self._abnormal:
            self._abnormal[code.number] = self.report(code, level)
