"""The parameters of the standard layer: one field each, with default, range and meaning."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from woosh_robot_agent.motion import MAX_VELOCITY, VelocityLimits
from woosh_robot_agent.parameter import parameter_field as _parameter


def _switch(description: str) -> Any:
    """Return the field of a parameter that enables a part."""
    return _parameter(True, description, read_only=True)


@dataclass(frozen=True)
class StandardSettings:
    """The values of the standard layer's parameters; each field has a description.

    Raises:
        ValueError: the name of a frame is invalid.
    """

    enable_odom: bool = _switch("Publish odom.")
    enable_scan: bool = _switch("Publish scan.")
    enable_battery_state: bool = _switch("Publish battery_state.")
    enable_map: bool = _switch("Publish map.")
    enable_plan: bool = _switch("Publish plan.")
    enable_footprint: bool = _switch("Publish footprint.")
    enable_cmd_vel: bool = _switch("Drive the robot by cmd_vel.")
    enable_initialpose: bool = _switch("Set the robot's pose by initialpose.")
    enable_goal_pose: bool = _switch("Navigate by goal_pose, and offer the service cancel.")
    enable_stop: bool = _switch("Offer the service stop.")
    enable_connected: bool = _switch("Publish connected.")
    enable_diagnostics: bool = _switch("Publish /diagnostics.")
    publish_tf: bool = _parameter(False, "Publish map -> odom -> base_link on /tf.", read_only=True)
    publish_laser_tf: bool = _parameter(
        True,
        "With publish_tf, publish base_link -> laser on /tf_static if the firmware reports it; set "
        "it to false if a URDF defines that transform.",
        read_only=True,
    )

    frame_prefix: str = _parameter("", "Prefix of all frame names, e.g. robot1/.", read_only=True)
    map_frame: str = _parameter("map", "Frame of the chassis's map.", read_only=True)
    odom_frame: str = _parameter(
        "odom", "Frame in which the robot's pose never jumps.", read_only=True
    )
    base_frame: str = _parameter("base_link", "Frame of the robot.", read_only=True)
    scan_frame: str = _parameter("laser", "Frame of the laser.", read_only=True)

    odom_rate: float = _parameter(
        20.0, "Rate of odom, in Hz. If odom_prediction is false, its highest rate.", 0.1, 200.0
    )
    odom_prediction: bool = _parameter(
        True,
        "Predict odom between the reports of a moving robot; false publishes each report once.",
    )
    pose_covariance: tuple[float, ...] = _parameter(
        (0.0025, 0.0025, 1e6, 1e6, 1e6, 0.0076),
        "Diagonal of the pose covariance in odom: x, y, z in m^2, roll, pitch, yaw in rad^2.",
        0.0,
        1e12,
    )
    twist_covariance: tuple[float, ...] = _parameter(
        (0.0025, 0.0025, 1e6, 1e6, 1e6, 0.0076),
        "Diagonal of the twist covariance in odom: x, y, z in (m/s)^2, roll, pitch, yaw in "
        "(rad/s)^2.",
        0.0,
        1e12,
    )
    scan_rate: float = _parameter(
        10.0, "Rate at which scans are requested and published, in Hz.", 0.1, 50.0
    )

    cmd_vel_stamped: bool = _parameter(
        False, "Subscribe to cmd_vel as TwistStamped instead of Twist.", read_only=True
    )
    cmd_vel_rate: float = _parameter(
        20.0, "Maximum rate of velocity commands sent to the chassis, in Hz.", 1.0, 100.0
    )
    cmd_vel_timeout: float = _parameter(
        0.5,
        "Time without a message on cmd_vel after which the robot is stopped, in seconds.",
        0.05,
        5.0,
    )
    cmd_vel_max_age: float = _parameter(
        0.5,
        "Maximum age of a velocity on cmd_vel when it is sent, at most 0.5 s, and difference of a "
        "TwistStamped's stamp from now, in seconds; 0 accepts any stamp.",
        0.0,
        60.0,
    )
    cmd_vel_max_linear: float = _parameter(
        1.0,
        "Maximum linear speed, in m/s; cmd_vel and robot/Twist are clamped to it.",
        0.0,
        MAX_VELOCITY,
    )
    cmd_vel_max_angular: float = _parameter(
        1.0,
        "Maximum angular speed, in rad/s; cmd_vel and robot/Twist are clamped to it.",
        0.0,
        MAX_VELOCITY,
    )
    cmd_vel_override: bool = _parameter(
        False, "Accept cmd_vel even while a goal or another client's task is running."
    )

    def __post_init__(self) -> None:
        for name in ("frame_prefix", "map_frame", "odom_frame", "base_frame", "scan_frame"):
            frame = getattr(self, name)
            if frame.startswith("/"):
                raise ValueError(f"{name} must not begin with a slash: {frame!r}")
            if not frame and name != "frame_prefix":
                raise ValueError(f"{name} must not be empty")

    @property
    def velocity_limits(self) -> VelocityLimits:
        """Limits of cmd_vel; those of the speed also hold for robot/Twist."""
        return VelocityLimits(
            max_linear=self.cmd_vel_max_linear,
            max_angular=self.cmd_vel_max_angular,
            rate=self.cmd_vel_rate,
            timeout=self.cmd_vel_timeout,
            override=self.cmd_vel_override,
            max_age=self.cmd_vel_max_age or math.inf,
        )
