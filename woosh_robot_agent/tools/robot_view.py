"""The state of a robot and of its link, for tools that show it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from google.protobuf.message import Message

from woosh_robot_agent.endpoints import TOPICS
from woosh_robot_agent.link import ChassisClient, LinkState, OtherRobotError
from woosh_robot_agent.link.protos import message_type
from woosh_robot_agent.link.reports import RecentDict
from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode, StatusCodes
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo
from woosh_robot_agent.pb.ros.ros_pack_pb2 import Feedback, Feedbacks
from woosh_robot_agent.robot.last_known import LastKnown
from woosh_robot_agent.tools.options import link_arguments

_MAX_CODES = 50
"""Maximum number of status codes that are kept, the newest ones."""
_MAX_ACTIONS = 20
"""Maximum number of actions whose feedback is kept: a robot could send any number of names."""


class RobotView:
    """State of one robot, updated with each message from it.

    Attributes:
        is_empty: True until the first message.
        has_robot_info: True once a RobotInfo, which holds the whole state, has been received.
        codes: the newest status codes, at most `_MAX_CODES`, the newest last; by time, code and
            task.
        actions: last feedback of each action of `woosh.ros`, by the action's name, e.g. `MoveBase`.
        values: last value of each type of the other messages.
    """

    def __init__(self) -> None:
        self.codes: RecentDict[tuple[int, ...], StatusCode] = RecentDict(_MAX_CODES)
        self.actions: RecentDict[str, Feedback] = RecentDict(_MAX_ACTIONS)
        self.values = LastKnown()  # filled by `update`
        # empty, because parts that arrive before the first RobotInfo are merged into it
        self.values.remember(RobotInfo())
        self.is_empty = True
        self.has_robot_info = False

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
                if self.has_robot_info:
                    self.actions.clear()  # the link was lost, and they may have ended meanwhile
                self.has_robot_info = True
                self._add_codes(message.status_codes.scs)
            elif isinstance(message, StatusCodes):
                self._add_codes(message.scs)

    def _set_feedback(self, feedback: Feedback) -> None:
        self.actions[feedback.action.rpartition(".")[2]] = feedback

    def _add_codes(self, codes: Iterable[StatusCode]) -> None:
        """Add status codes, each only once: codes arrive both as pushes and in RobotInfo.

        What comes later is newer, whatever its time: the robot's clock may have been set back.
        """
        for code in sorted(codes, key=lambda code: code.time):
            key = code.time, code.code, code.robot_task_id
            if key not in self.codes:
                self.codes[key] = code


MAX_BACKOFF = 3.0
"""Longest pause between attempts to connect, in seconds; short, because somebody is watching."""


def subscribe_all(chassis: ChassisClient, callback: Callable[[Message], None]) -> None:
    """Call `callback` with each push, and with the first RobotInfo of each connection.

    Laser scans and growing maps are left out, because they are large.
    """
    chassis.on_snapshot(callback)
    for topic in TOPICS:
        if not topic.on_demand:
            chassis.subscribe(message_type(topic.push), callback)
    # not in `TOPICS`, because the agent publishes it as the feedback of its actions
    chassis.subscribe(Feedbacks, callback)


@dataclass(frozen=True)
class LinkReport:
    """State of the connection from the robot to a program that shows the robot.

    Attributes:
        good: False if the shown values may be outdated, because the connection is down.
        detail: counters or advice; may be empty.
    """

    good: bool
    text: str
    detail: str = ""


def link_report(chassis: ChassisClient) -> LinkReport:
    """Return the state of the link to a chassis."""
    stats = chassis.stats
    since = time.strftime("%H:%M:%S", time.localtime(chassis.since))
    if chassis.state is LinkState.READY:
        bad, dropped = stats.bad_frames.total(), stats.dropped_pushes.total()
        counts = (
            f"frames: {stats.rx} received, {stats.tx} sent, {bad} invalid; {dropped} pushes dropped"
        )
        ping = "" if stats.round_trip is None else f"round trip {stats.round_trip * 1000:.0f} ms; "
        return LinkReport(True, f"connected since {since}", ping + counts)
    state = "connection lost" if stats.connects else "not connected"
    reason = f": {chassis.last_error}" if chassis.last_error else ""
    if isinstance(chassis.last_error, OtherRobotError):  # its text has the remedy
        remedy = ""
    else:
        remedy = f"run `doctor {link_arguments(chassis.config)}` to find the cause"
    return LinkReport(False, f"{state} since {since}, retrying{reason}", remedy)
