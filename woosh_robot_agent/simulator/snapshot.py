"""The state at one moment, for assertions."""

from __future__ import annotations

from dataclasses import dataclass

from woosh_robot_agent.pb.robot import robot_pb2
from woosh_robot_agent.simulator.body.base import Velocity
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.protocol.reports import robot_info
from woosh_robot_agent.simulator.world.geometry import Pose


@dataclass(frozen=True, slots=True)
class Snapshot:
    """What is true of the simulated chassis, beyond what it reports.

    Attributes:
        elapsed: Simulated s since the start.
        pose: Where it is, in m and rad in the map's frame.
        velocity: How it moves, in m/s and rad/s.
        odometer: m driven.
        jack: The height of LiftControl's lift in m.
        column: The height of LiftControl3's lift in m.
        following: It follows somebody.
        spoken: What it was told to say lately.
        info: What it reports.
    """

    elapsed: float
    pose: Pose
    velocity: Velocity
    odometer: float
    jack: float
    column: float
    following: bool
    spoken: tuple[str, ...]
    info: robot_pb2.RobotInfo


def snapshot(chassis: Chassis) -> Snapshot:
    """The state of `chassis` now."""
    return Snapshot(
        elapsed=chassis.elapsed,
        pose=chassis.base.pose,
        velocity=chassis.base.velocity,
        odometer=chassis.base.odometer,
        jack=chassis.jack.height,
        column=chassis.column.height,
        following=chassis.follower.active,
        spoken=tuple(chassis.spoken),
        info=robot_info(chassis),
    )
