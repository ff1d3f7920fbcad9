"""The link to a chassis, usable without ROS.

To drive the robot with velocities, use `woosh_robot_agent.motion.MotionGate` around the client.
docs/link_protocol.md has an example.
"""

from woosh_robot_agent.link.client import ChassisClient
from woosh_robot_agent.link.config import (
    ConnectionLostError,
    HandshakeError,
    LinkConfig,
    LinkError,
    NotConnectedError,
    NotPermittedError,
    OtherRobotError,
    RequestTimeoutError,
    SupersededError,
    TooManyRequestsError,
)
from woosh_robot_agent.link.connection import Sending
from woosh_robot_agent.link.frames import Answer, Body, FrameError
from woosh_robot_agent.link.reconnect import LinkState, RobotIdentity

__all__ = [
    "Answer",
    "Body",
    "ChassisClient",
    "ConnectionLostError",
    "FrameError",
    "HandshakeError",
    "LinkConfig",
    "LinkError",
    "LinkState",
    "NotConnectedError",
    "NotPermittedError",
    "OtherRobotError",
    "RequestTimeoutError",
    "RobotIdentity",
    "Sending",
    "SupersededError",
    "TooManyRequestsError",
]
