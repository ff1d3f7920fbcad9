"""State of a robot as known to a program that shows it, independent of ROS and of the display."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

from google.protobuf.message import Message

from woosh_robot_agent.last_known import LastKnown
from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode, StatusCodes
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo
from woosh_robot_agent.pb.ros.ros_pack_pb2 import Feedback, Feedbacks

_MAX_CODES = 50
"""Number of status codes kept."""


class RobotView:
    """State of one robot, updated with each message from it.

    Attributes:
        is_empty: True until the first message.
        has_robot_info: True once a RobotInfo, which holds the whole state, has been received.
        codes: Status codes, the newest last.
        actions: Last feedback of each action of `woosh.ros`, by the action's name.
        values: Last value of each message type.
    """

    def __init__(self) -> None:
        self.codes: deque[StatusCode] = deque(maxlen=_MAX_CODES)
        self.actions: dict[str, Feedback] = {}
        self.values = LastKnown(None)
        self.forget()

    def forget(self) -> None:
        """Forget everything: the next messages come from another robot."""
        self.is_empty = True
        self.has_robot_info = False
        self.codes.clear()
        self.actions.clear()
        self.values.forget()
        # An empty one, because its parts can arrive before it.
        self.values.remember(RobotInfo())

    @property
    def info(self) -> RobotInfo:
        """The robot's state, with the latest value of each part; absent fields are unknown."""
        info = self.values.value(RobotInfo)
        assert info is not None
        return info

    def update(self, message: Message) -> None:
        """Update the state from a push or an answer of the robot."""
        self.is_empty = False
        if isinstance(message, StatusCode):
            self._add_codes([message])
        elif isinstance(message, Feedbacks):
            for feedback in message.fbs:
                self._set_feedback(feedback)
        elif isinstance(message, Feedback):
            self._set_feedback(message)
        else:
            self.values.remember(message)
            if isinstance(message, RobotInfo):
                self.has_robot_info = True
                self._add_codes(message.status_codes.scs)
            elif isinstance(message, StatusCodes):
                self._add_codes(message.scs)

    def _set_feedback(self, feedback: Feedback) -> None:
        self.actions[feedback.action.rpartition(".")[2]] = feedback

    def _add_codes(self, codes: Iterable[StatusCode]) -> None:
        """Add status codes, each once: they arrive both as pushes and inside of RobotInfo."""
        merged = {
            (code.time, code.code, code.robot_task_id): code for code in (*self.codes, *codes)
        }
        self.codes.clear()
        self.codes.extend(sorted(merged.values(), key=lambda code: code.time))
