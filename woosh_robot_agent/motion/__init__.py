"""Everything that decides whether the robot may move: `MotionGate` is the only way to the wheels.

Example::

    async with ChassisClient("172.20.8.74") as chassis:
        gate = MotionGate(chassis)
        await gate.request(Twist(linear=0.2))
"""

from woosh_robot_agent.motion.gate import MotionGate

__all__ = ["MotionGate"]
