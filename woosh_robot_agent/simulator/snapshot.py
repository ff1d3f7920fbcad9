"""Snapshots of the state of the robot, for assertions in tests."""

from __future__ import annotations

from dataclasses import dataclass

from woosh_robot_agent.pb.robot import robot_pack_pb2, robot_pb2
from woosh_robot_agent.simulator.body.base import Velocity
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.protocol.reports import robot_info
from woosh_robot_agent.simulator.world.geometry import Pose


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The state of the robot at one moment.

    Attributes:
        elapsed: Simulated time since the start, in seconds.
        pose: Pose in the map's frame, in metres and radians.
        velocity: Velocity, in m/s and rad/s.
        odometer: Total distance driven, in metres.
        jack: Height of the lift of LiftControl, in metres.
        column: Height of the lift of LiftControl2 and LiftControl3, in metres.
        following: The robot follows a leader.
        spoken: The last texts that the robot was told to say.
        lights: Settings of the lights, by submodule.
        remote_keys: Keys of the radio remote controller that are held down, one bit each.
        info: All states as reported to clients.
    """

    elapsed: float
    pose: Pose
    velocity: Velocity
    odometer: float
    jack: float
    column: float
    following: bool
    spoken: tuple[str, ...]
    lights: dict[int, robot_pack_pb2.LED]
    remote_keys: int
    info: robot_pb2.RobotInfo


def snapshot(chassis: Chassis) -> Snapshot:
    """Return the current state of `chassis`."""
    return Snapshot(
        elapsed=chassis.elapsed,
        pose=chassis.pose,
        velocity=chassis.base.velocity,
        odometer=chassis.base.odometer,
        jack=chassis.jack.height,
        column=chassis.column.height,
        following=chassis.follower.active,
        spoken=tuple(chassis.spoken),
        lights=dict(chassis.lights),
        remote_keys=chassis.remote_controller.keys,
        info=robot_info(chassis),
    )
