"""What the monitor shows of a robot, wherever it comes from. No ROS, no terminal."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Protocol

from google.protobuf.message import Message

from woosh_robot_agent.last_known import LastKnown
from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode, StatusCodes
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo
from woosh_robot_agent.pb.ros.ros_pack_pb2 import Feedback, Feedbacks
from woosh_robot_agent.protos import full_name

CODES_KEPT = 50


@dataclass(frozen=True)
class LinkReport:
    """How what is shown gets here.

    Attributes:
        good: what is shown is what the robot says now.
        text: where the link stands.
        detail: more about it: counts, times, or what to do.
    """

    good: bool
    text: str
    detail: str = ""


class View:
    """What is known of one robot.

    Attributes:
        known: whether the robot has said anything yet.
        complete: whether it has said everything, as RobotInfo does.
        codes: status codes, the newest last.
        actions: the last feedback of each action of woosh.ros, by its name.
    """

    def __init__(self) -> None:
        self.known = self.complete = False
        self.codes: deque[StatusCode] = deque(maxlen=CODES_KEPT)
        self.actions: dict[str, Feedback] = {}
        self._values = LastKnown(None)
        self._values.remember(RobotInfo())  # the parts come one by one, in any order

    @property
    def info(self) -> RobotInfo:
        """What the robot reports, its parts up to date; fields that are absent are not known."""
        info = self._values.get(full_name(RobotInfo))
        assert isinstance(info, RobotInfo)
        return info

    def take(self, message: Message) -> None:
        """Take what the robot said, a push or an answer."""
        self.known = True
        if isinstance(message, StatusCode):
            self._add_codes([message])
        elif isinstance(message, Feedbacks):
            for feedback in message.fbs:
                self._add_feedback(feedback)
        elif isinstance(message, Feedback):
            self._add_feedback(message)
        else:
            self._values.remember(message)
            if isinstance(message, RobotInfo):
                self.complete = True
                self._add_codes(message.status_codes.scs)
            elif isinstance(message, StatusCodes):
                self._add_codes(message.scs)

    def _add_feedback(self, feedback: Feedback) -> None:
        self.actions[feedback.action.rpartition(".")[2]] = feedback

    def _add_codes(self, codes: object) -> None:
        """Add those that are not there yet: they come as pushes and in RobotInfo."""
        merged = {(code.time, code.code, code.robot_task_id): code for code in self.codes}
        for code in codes:  # type: ignore[attr-defined]
            merged[code.time, code.code, code.robot_task_id] = code
        self.codes.clear()
        self.codes.extend(sorted(merged.values(), key=lambda code: code.time))


class Source(Protocol):
    """Where a view comes from. Used in one asyncio event loop.

    Attributes:
        name: what it is, for people.
        view: what is known by now.
    """

    name: str
    view: View

    def link(self) -> LinkReport:
        """Where the link stands now."""

    async def start(self) -> None:
        """Begin to listen."""

    async def close(self) -> None:
        """Listen no more."""
