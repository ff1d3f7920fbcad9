"""The standard layer's parameters: one field each, with its default, range and meaning."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

from woosh_robot_agent.parameter import Parameter


def _parameter(
    default: Any, description: str, low: float = 0, high: float = 0, *, fixed: bool = False
) -> Any:
    return field(
        default=default,
        metadata={"description": description, "low": low, "high": high, "fixed": fixed},
    )


def _part(what: str, default: bool = True) -> Any:
    return _parameter(default, what, fixed=True)


@dataclass(frozen=True)
class StandardSettings:
    """The values of the standard layer's parameters; the fields say what they mean.

    Fields that begin with `enable_` switch one part each; frames are without leading slashes.
    """

    enable_odom: bool = _part("Publish odom")
    enable_scan: bool = _part("Publish scan")
    enable_battery_state: bool = _part("Publish battery_state")
    enable_map: bool = _part("Publish map")
    enable_plan: bool = _part("Publish plan")
    enable_footprint: bool = _part("Publish footprint")
    enable_cmd_vel: bool = _part("Drive by cmd_vel")
    enable_initialpose: bool = _part("Set the pose by initialpose")
    enable_goal_pose: bool = _part("Navigate by goal_pose, cancelled by the service cancel")
    enable_stop: bool = _part("Offer the service stop")
    enable_connected: bool = _part("Publish connected")
    enable_diagnostics: bool = _part("Publish /diagnostics")
    publish_tf: bool = _parameter(False, "Publish map -> odom -> base_link on /tf", fixed=True)
    publish_laser_tf: bool = _parameter(
        True,
        "With publish_tf, publish base_link -> laser on /tf_static where the firmware tells it; "
        "false where a URDF does",
        fixed=True,
    )

    frame_prefix: str = _parameter("", "Put before every frame, e.g. robot1/", fixed=True)
    map_frame: str = _parameter("map", "Frame of the chassis's map", fixed=True)
    odom_frame: str = _parameter("odom", "Frame in which odom is continuous", fixed=True)
    base_frame: str = _parameter("base_link", "Frame of the robot", fixed=True)
    scan_frame: str = _parameter("laser", "Frame of the laser", fixed=True)

    odom_rate: float = _parameter(20.0, "Rate of odom, Hz", 0.1, 200.0)
    pose_covariance: tuple[float, ...] = _parameter(
        (0.0025, 0.0025, 1e6, 1e6, 1e6, 0.0076),
        "Diagonal of odom's pose covariance: x, y, z in m^2, roll, pitch, yaw in rad^2",
        0.0,
        1e12,
    )
    twist_covariance: tuple[float, ...] = _parameter(
        (0.0025, 0.0025, 1e6, 1e6, 1e6, 0.0076),
        "Diagonal of odom's twist covariance, (m/s)^2 and (rad/s)^2",
        0.0,
        1e12,
    )
    scan_rate: float = _parameter(10.0, "Rate at which the laser is asked, Hz", 0.1, 50.0)

    cmd_vel_stamped: bool = _parameter(
        False, "cmd_vel is a TwistStamped instead of a Twist", fixed=True
    )
    cmd_vel_rate: float = _parameter(20.0, "Most velocities sent per second", 1.0, 100.0)
    cmd_vel_timeout: float = _parameter(
        0.5, "Silence on cmd_vel after which the robot is stopped, s", 0.05, 5.0
    )
    cmd_vel_max_age: float = _parameter(
        0.5, "Age of a TwistStamped's stamp from which it is refused, s; 0 takes any", 0.0, 60.0
    )
    cmd_vel_max_linear: float = _parameter(
        1.0, "Speed along the floor to which cmd_vel is clamped, m/s", 0.0, 10.0
    )
    cmd_vel_max_angular: float = _parameter(
        1.0, "Turning speed to which cmd_vel is clamped, rad/s", 0.0, 10.0
    )
    cmd_vel_override: bool = _parameter(
        False, "Obey cmd_vel also while a goal of another client runs"
    )

    def __post_init__(self) -> None:
        for name in ("frame_prefix", "map_frame", "odom_frame", "base_frame", "scan_frame"):
            frame = getattr(self, name)
            if frame.startswith("/"):
                raise ValueError(f"{name} {frame!r} must not begin with a slash")
            if not frame and name != "frame_prefix":
                raise ValueError(f"{name} must not be empty")


PARAMETERS = tuple(
    Parameter(each.name, getattr(StandardSettings, each.name), **each.metadata)
    for each in fields(StandardSettings)
)
"""The parameters, in the order of the fields."""
