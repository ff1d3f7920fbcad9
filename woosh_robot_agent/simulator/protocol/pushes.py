"""The topics that clients can subscribe to, and the detection of changed states."""

from __future__ import annotations

import math
from collections.abc import Callable

from google.protobuf.message import Message

from woosh_robot_agent.pb.robot import robot_count_pb2, robot_pack_pb2, robot_pb2
from woosh_robot_agent.pb.ros import ros_pack_pb2
from woosh_robot_agent.simulator.agenda import ROUNDING
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.protocol.reports import PERIODIC, STATES

_STATES = {cls.DESCRIPTOR.full_name: report for cls, report in STATES.items()}
_PERIODIC = {cls.DESCRIPTOR.full_name: report for cls, report in PERIODIC.items()}
_POSE_SPEED = robot_pb2.PoseSpeed.DESCRIPTOR.full_name
_BATTERY = robot_pb2.Battery.DESCRIPTOR.full_name

_DUE_TIMES: dict[str, Callable[[Chassis], float]] = {
    robot_pb2.ScannerData.DESCRIPTOR.full_name: lambda chassis: chassis.pushed_scan_time,
    robot_pack_pb2.BuildMapData.DESCRIPTOR.full_name: lambda chassis: chassis.mapping.picture_time,
}
"""Simulated times at which the periodic reports were last due, by topic."""

_EVENTS = {
    cls.DESCRIPTOR.full_name
    for cls in (
        robot_pb2.TaskProc,
        robot_count_pb2.StatusCode,
        robot_count_pb2.Operation,
        robot_count_pb2.Task,
        robot_count_pb2.Status,
        ros_pack_pb2.Feedbacks,
    )
}
"""Messages that are pushed each time they are emitted, even if nothing has changed."""

TOPICS = frozenset(_STATES) | frozenset(_PERIODIC) | _EVENTS
"""Full protobuf names of all messages that a client can subscribe to."""


class StateWatch:
    """Detects which of the watched states have changed since the last call.

    It limits the rate of PoseSpeed, and repeats an unchanged Battery, as the profile says.
    """

    def __init__(self, chassis: Chassis) -> None:
        self._chassis = chassis
        self._last: dict[str, bytes] = {}
        """Last known state of each watched topic, encoded."""
        self._due: dict[str, float] = {}
        """Time at which each watched periodic report was last due, in seconds."""
        self._next_pose = 0.0
        """Simulated time from which PoseSpeed may be pushed again, in seconds."""
        self._repeat_battery = math.inf
        """Simulated time at which an unchanged Battery is pushed again, in seconds."""

    def watch(self, topics: set[str]) -> None:
        """Watch these topics only. Their current states do not count as changes."""
        if _BATTERY in topics and _BATTERY not in self._last:
            self._plan_battery()
        self._last = {
            topic: self._last.get(topic) or _STATES[topic](self._chassis).SerializeToString()
            for topic in _STATES
            if topic in topics
        }
        self._due = {
            topic: self._due.get(topic, due(self._chassis))
            for topic, due in _DUE_TIMES.items()
            if topic in topics
        }

    def changed(self, *, while_moving: bool) -> list[Message]:
        """Return the periodic reports that are due and the states that have changed.

        Args:
            while_moving: Include PoseSpeed, which changes with every step of a moving robot.
        """
        found = []
        for topic, last_due in self._due.items():
            due = _DUE_TIMES[topic](self._chassis)
            if due != last_due:
                self._due[topic] = due
                found.append(_PERIODIC[topic](self._chassis))
        for topic, last in self._last.items():
            if topic == _POSE_SPEED and not (while_moving and self._pose_is_due()):
                continue
            message = _STATES[topic](self._chassis)
            now = message.SerializeToString()
            if now != last or (topic == _BATTERY and self._battery_is_due()):
                self._last[topic] = now
                found.append(message)
                if topic == _POSE_SPEED:
                    self._plan_pose()
                elif topic == _BATTERY:
                    self._plan_battery()
        return found

    def _pose_is_due(self) -> bool:
        return self._chassis.elapsed >= self._next_pose - ROUNDING

    def _battery_is_due(self) -> bool:
        return self._chassis.elapsed >= self._repeat_battery - ROUNDING

    def _plan_pose(self) -> None:
        self._next_pose = self._wake_after(self._chassis.profile.rates.pose_speed)

    def _plan_battery(self) -> None:
        period = self._chassis.profile.rates.battery
        if period:
            self._repeat_battery = self._wake_after(period.at(self._chassis.chance.random()))

    def _wake_after(self, delay: float) -> float:
        """Schedule another check for changes after `delay` seconds; return its time."""
        if delay > 0.0:
            self._chassis.after(delay, lambda: None)  # the chassis reports the end of each call
        return self._chassis.elapsed + delay
