"""The topics that clients can subscribe to, and the detection of changed states."""

from __future__ import annotations

from google.protobuf.message import Message

from woosh_robot_agent.pb.robot import robot_count_pb2, robot_pb2
from woosh_robot_agent.pb.ros import ros_pack_pb2
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.protocol.reports import STATES

_STATES = {cls.DESCRIPTOR.full_name: report for cls, report in STATES.items()}
_POSE_SPEED = robot_pb2.PoseSpeed.DESCRIPTOR.full_name

_EVENTS = {
    cls.DESCRIPTOR.full_name
    for cls in (robot_pb2.TaskProc, robot_count_pb2.StatusCode, ros_pack_pb2.Feedbacks)
}
"""Messages that are pushed each time they are emitted, even if nothing has changed."""

TOPICS = frozenset(_STATES) | _EVENTS
"""Full protobuf names of all messages that a client can subscribe to."""


class StateWatch:
    """Detects which of the watched states have changed since the last call."""

    def __init__(self, chassis: Chassis) -> None:
        self._chassis = chassis
        self._last: dict[str, bytes] = {}

    def watch(self, topics: set[str]) -> None:
        """Watch these topics only. Their current states do not count as changes."""
        self._last = {
            topic: self._last.get(topic) or _STATES[topic](self._chassis).SerializeToString()
            for topic in _STATES
            if topic in topics
        }

    def changed(self, *, while_moving: bool) -> list[Message]:
        """Return the states that have changed since the last call.

        Args:
            while_moving: Include PoseSpeed, which changes with every step of a moving robot.
        """
        found = []
        for topic, last in self._last.items():
            if topic == _POSE_SPEED and not while_moving:
                continue
            message = _STATES[topic](self._chassis)
            now = message.SerializeToString()
            if now != last:
                self._last[topic] = now
                found.append(message)
        return found
