"""Rules for moving the robot. All motion commands pass through `MotionGate`.

Example::

    async with ChassisClient("172.20.8.74") as chassis:
        gate = MotionGate(chassis)
        await gate.request(Twist(linear=0.2))
"""

from woosh_robot_agent.motion.gate import (
    AnsweredCommand,
    MotionGate,
    Sender,
    StopReport,
)
from woosh_robot_agent.motion.speed_limiter import SpeedLimiter
from woosh_robot_agent.motion.timeliness import MotionTiming
from woosh_robot_agent.motion.velocity_driver import (
    MAX_VELOCITY,
    Silence,
    UnusableVelocityError,
    VelocityDriver,
    VelocityLimits,
)

__all__ = [
    "MAX_VELOCITY",
    "AnsweredCommand",
    "MotionGate",
    "MotionTiming",
    "Sender",
    "Silence",
    "SpeedLimiter",
    "StopReport",
    "UnusableVelocityError",
    "VelocityDriver",
    "VelocityLimits",
]
