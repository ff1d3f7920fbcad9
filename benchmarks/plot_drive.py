"""Drives a simulated robot through its hall and plots odom and scans over the walls."""

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

from tests.harness import Client, RunningAgent, own_domain, wait_until
from woosh_robot_agent.simulator import SimulatorConfig, SimulatorThread
from woosh_robot_agent.standard.pose2d import Pose2D

GOALS = ((8.0, -5.0), (3.0, 7.0), (-9.0, 0.5))


def main(path: str) -> None:
    config = SimulatorConfig(port=0, tcp_port=0, speed=2, seed=1)
    with own_domain() as domain, SimulatorThread(config) as simulator:
        agent = RunningAgent(domain, ip="127.0.0.1", port=simulator.port, publish_tf=True)
        client = Client(domain)
        agent.wait_connected()
        plan_qos = QoSProfile(depth=10_000)
        odoms = client.echo_with(Odometry, "odom", plan_qos)
        transforms = client.echo_with(TFMessage, "/tf", plan_qos)
        scans = client.echo_with(LaserScan, "scan", qos_profile_sensor_data)
        goals = client.node.create_publisher(PoseStamped, client.path("goal_pose"), 1)
        wait_until(goals.get_subscription_count, "the agent")
        for x, y in GOALS:
            goal = PoseStamped()
            goal.header.frame_id = "map"
            goal.pose.position.x, goal.pose.position.y = x, y
            goal.pose.orientation.w = 1.0
            goals.publish(goal)
            wait_until(lambda: near(simulator, x, y), f"({x}, {y})", 120.0)  # noqa: B023
        walls = simulator.call(lambda sim: sim.chassis.map.walls)
        client.close()
        agent.close()
    draw(path, walls, odoms.messages, transforms.messages, scans.messages)


def near(simulator: SimulatorThread, x: float, y: float) -> bool:
    pose = simulator.state.pose
    return math.hypot(pose.x - x, pose.y - y) < 0.05


def draw(path: str, walls: Any, odoms: Any, transforms: Any, scans: Any) -> None:
    figure, axes = plt.subplots(figsize=(9, 7.5))
    for wall in walls:
        axes.plot([wall.x1, wall.x2], [wall.y1, wall.y2], color="0.25", linewidth=2)
    in_map = [
        (stamp_of(m.transforms[0]), of(m.transforms[0].transform) * of(m.transforms[1].transform))
        for m in transforms
    ]
    for scan in scans[::15]:
        at = min(in_map, key=lambda each: abs(each[0] - stamp_of(scan)))[1]
        laser = at * Pose2D(0.25, 0.0, 0.0)
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
    start = in_map[0][1]
    track = [start * of_pose(m.pose.pose) for m in odoms]
    axes.plot([p.x for p in track], [p.y for p in track], color="tab:blue", label="odom")
    axes.scatter([], [], s=6, color="tab:red", label="scan")
    axes.plot(*zip(*GOALS, strict=True), "x", color="tab:green", label="goal_pose")
    axes.plot(start.x, start.y, "o", color="tab:blue", label="start")
    axes.set(xlabel="x in map, m", ylabel="y in map, m", aspect="equal")
    axes.legend(loc="upper right")
    figure.tight_layout()
    figure.savefig(path, dpi=80)


def stamp_of(message: Any) -> float:
    return float(message.header.stamp.sec + message.header.stamp.nanosec / 1e9)


def of(transform: Any) -> Pose2D:
    rotation = transform.rotation
    yaw = 2 * math.atan2(rotation.z, rotation.w)
    return Pose2D(transform.translation.x, transform.translation.y, yaw)


def of_pose(pose: Any) -> Pose2D:
    return Pose2D(
        pose.position.x, pose.position.y, 2 * math.atan2(pose.orientation.z, pose.orientation.w)
    )


if __name__ == "__main__":
    main(sys.argv[1])
