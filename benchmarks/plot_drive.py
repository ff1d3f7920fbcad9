"""Drive a simulated robot through its hall; plot odom and scans over the walls."""

from __future__ import annotations

import math
import sys
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import LaserScan
from tf2_msgs.msg import TFMessage

from tests.harness import Client
from woosh_robot_agent.ros.standard.poses import Pose2D
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.testing import own_domain, running_agent, running_chassis, wait_until

GOALS = ((8.0, -5.0), (3.0, 7.0), (-9.0, 0.5))
"""Points that the robot drives to, in the map frame, in metres."""
_LASER = Pose2D(0.25, 0.0, 0.0)
"""Pose of the laser in the robot's frame."""


def main(path: str) -> None:
    """Drive to all goals and write the plot to `path`."""
    with own_domain() as domain, running_chassis(speed=2) as chassis:
        with running_agent(chassis, domain=domain, publish_tf=True):
            client = Client(domain)
            qos = QoSProfile(depth=10_000)
            odoms = client.echo_with(Odometry, "odom", qos)
            transforms = client.echo_with(TFMessage, "/tf", qos)
            scans = client.echo_with(LaserScan, "scan", qos_profile_sensor_data)
            goals = client.node.create_publisher(PoseStamped, client.path("goal_pose"), 1)
            wait_until(goals.get_subscription_count, "the agent")
            for x, y in GOALS:
                goals.publish(goal_pose(x, y))
                wait_until(lambda: near(chassis, x, y), f"({x}, {y})", 120.0)  # noqa: B023
            client.close()
        walls = chassis.call(lambda sim: sim.chassis.map.walls)
    draw(path, walls, odoms.messages, transforms.messages, scans.messages)


def goal_pose(x: float, y: float) -> PoseStamped:
    goal = PoseStamped()
    goal.header.frame_id = "map"
    goal.pose.position.x, goal.pose.position.y = x, y
    goal.pose.orientation.w = 1.0
    return goal


def near(chassis: SimulatorThread, x: float, y: float) -> bool:
    pose = chassis.state.pose
    return math.hypot(pose.x - x, pose.y - y) < 0.05


def draw(path: str, walls: Any, odoms: Any, transforms: Any, scans: Any) -> None:
    figure, axes = plt.subplots(figsize=(9, 7.5))
    for wall in walls:
        axes.plot([wall.x1, wall.x2], [wall.y1, wall.y2], color="0.25", linewidth=2)
    # time of each transform, and the pose of the robot in the map
    poses = [
        (
            stamp(m.transforms[0]),
            planar_pose(m.transforms[0].transform.translation, m.transforms[0].transform.rotation)
            * planar_pose(
                m.transforms[1].transform.translation, m.transforms[1].transform.rotation
            ),
        )
        for m in transforms
    ]
    for scan in scans[::15]:
        laser = min(poses, key=lambda each: abs(each[0] - stamp(scan)))[1] * _LASER
        points = [
            laser
            * Pose2D(
                r * math.cos(scan.angle_min + i * scan.angle_increment),
                r * math.sin(scan.angle_min + i * scan.angle_increment),
            )
            for i, r in enumerate(scan.ranges)
            if math.isfinite(r)
        ]
        axes.scatter([p.x for p in points], [p.y for p in points], s=1, color="tab:red", alpha=0.3)
    start = poses[0][1]
    track = [start * planar_pose(m.pose.pose.position, m.pose.pose.orientation) for m in odoms]
    axes.plot([p.x for p in track], [p.y for p in track], color="tab:blue", label="odom")
    axes.scatter([], [], s=6, color="tab:red", label="scan")
    axes.plot(*zip(*GOALS, strict=True), "x", color="tab:green", label="goal_pose")
    axes.plot(start.x, start.y, "o", color="tab:blue", label="start")
    axes.set(xlabel="x in map, m", ylabel="y in map, m", aspect="equal")
    axes.legend(loc="upper right")
    figure.tight_layout()
    figure.savefig(path, dpi=80)


def stamp(message: Any) -> float:
    """Return the time of a stamped message, in seconds."""
    return float(message.header.stamp.sec + message.header.stamp.nanosec / 1e9)


def planar_pose(position: Any, rotation: Any) -> Pose2D:
    """Return the planar part of a pose or transform."""
    return Pose2D(position.x, position.y, 2 * math.atan2(rotation.z, rotation.w))


if __name__ == "__main__":
    main(sys.argv[1])
