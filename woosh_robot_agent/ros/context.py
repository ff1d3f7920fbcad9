"""Objects that the services, actions and topics of one robot share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from woosh_robot_agent.convert.converter import RequestMaker
from woosh_robot_agent.link import ChassisClient
from woosh_robot_agent.motion.gate import MotionGate
from woosh_robot_agent.robot.last_known import LastKnown
from woosh_robot_agent.ros.bridge import LinkThread


@dataclass(frozen=True)
class RobotContext:
    """The shared objects of one robot."""

    node: Any
    """Owner of the ROS entities."""
    thread: LinkThread
    """The link thread."""
    chassis: ChassisClient
    """The link; use it in the link thread only, except for methods that are thread-safe."""
    gate: MotionGate
    """Sends commands to the chassis."""
    last_known: LastKnown
    """Last values that the chassis reported; use it in the link thread only."""
    requests: RequestMaker
    """Creates requests to the chassis."""
