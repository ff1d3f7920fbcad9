"""The link to a chassis, usable without ROS.

To drive the robot with velocities, use `woosh_robot_agent.motion.MotionGate` around the client.

Example::

    import asyncio
    from woosh_robot_agent.link import ChassisClient
    from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed
    from woosh_robot_agent.pb.robot.robot_pack_pb2 import Speak

    async def main() -> None:
        async with ChassisClient("172.20.8.74") as chassis:
            chassis.subscribe(PoseSpeed, lambda push: print(push.pose.x, push.pose.y))
            answer = await chassis.request(Speak(text="hello"))
            print(answer.ok, answer.msg)

    asyncio.run(main())
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
