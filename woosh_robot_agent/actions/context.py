"""Objects shared by the goals of one action."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.actions.open_goals import OpenGoals
from woosh_robot_agent.actions.timing import GoalTiming
from woosh_robot_agent.link import ChassisClient
from woosh_robot_agent.motion.gate import MotionGate


@dataclass(frozen=True)
class Context:
    """Objects shared by the goals of one action; used in the link thread only."""

    chassis: ChassisClient
    """The link, for polls."""
    gate: MotionGate
    """Sends commands."""
    open_goals: OpenGoals
    """The open goals of the action, and of others that displace each other."""
    timing: Callable[[], GoalTiming]
    """Returns the timing of a goal that starts now."""
    to_proto: Callable[[Any], Message]
    """Converts the `arg` of a goal to the chassis's message."""
    empty: Callable[[type[Message]], Message]
    """Makes an empty request of a message class."""
    to_ros: Callable[[Message], Any]
    """Converts a report to its ROS message."""
    explain: Callable[[str], Awaitable[str]]
    """Returns why the chassis has just refused a request, given its type; empty if unknown."""
