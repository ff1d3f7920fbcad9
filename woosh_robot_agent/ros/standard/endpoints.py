"""The table of the standard layer's topics and services.

Publishers, policies, documentation and tests derive from it. Names are relative to the agent's
namespace unless they begin with a slash.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Kind(Enum):
    """Kind of an endpoint; for a published topic also its quality of service (REP 2003)."""

    STREAM = "published, reliable"
    LATCHED = "published, reliable and transient local"
    INPUT = "subscribed"
    SERVICE = "service"


@dataclass(frozen=True)
class StandardEndpoint:
    """A topic or service of the standard layer.

    Attributes:
        name: name of the topic or service.
        type: ROS type, `package/Name`.
        kind: kind of the endpoint.
        part: the endpoint's part of the standard layer, as in `parameters.PARTS`, or `tf`.
        meaning: description for the documentation.
        depth: queue size of the publisher or subscription.
    """

    name: str
    type: str
    kind: Kind
    part: str
    meaning: str
    depth: int = 1

    @property
    def is_output(self) -> bool:
        """True for a topic that the agent publishes."""
        return self.kind in (Kind.STREAM, Kind.LATCHED)


STANDARD = (
    StandardEndpoint(
        "odom",
        "nav_msgs/Odometry",
        Kind.STREAM,
        "odom",
        "pose in `odom`, velocity in `base_link`",
        10,
    ),
    StandardEndpoint(
        "/tf",
        "tf2_msgs/TFMessage",
        Kind.STREAM,
        "tf",
        "`map` -> `odom` -> `base_link`, with each message on `odom`",
        100,
    ),
    StandardEndpoint(
        "/tf_static", "tf2_msgs/TFMessage", Kind.LATCHED, "tf", "`base_link` -> `laser`"
    ),
    StandardEndpoint(
        "scan",
        "sensor_msgs/LaserScan",
        Kind.STREAM,
        "scan",
        "laser scan, requested only while there are subscribers",
        5,
    ),
    StandardEndpoint(
        "battery_state",
        "sensor_msgs/BatteryState",
        Kind.LATCHED,
        "battery_state",
        "state of charge, and whether the battery is charging",
    ),
    StandardEndpoint(
        "map",
        "nav_msgs/OccupancyGrid",
        Kind.LATCHED,
        "map",
        "current map, or the map that the robot is making",
    ),
    StandardEndpoint(
        "keepout_mask",
        "nav_msgs/OccupancyGrid",
        Kind.LATCHED,
        "map",
        "keep-out areas of the current map, as a mask for Nav2's KeepoutFilter",
    ),
    StandardEndpoint(
        "plan", "nav_msgs/Path", Kind.LATCHED, "plan", "path that the robot is following"
    ),
    StandardEndpoint(
        "footprint",
        "geometry_msgs/PolygonStamped",
        Kind.LATCHED,
        "footprint",
        "current outline of the robot",
    ),
    StandardEndpoint(
        "cmd_vel",
        "geometry_msgs/Twist",
        Kind.INPUT,
        "cmd_vel",
        "velocity command; repeat it to keep driving",
        1,
    ),
    StandardEndpoint(
        "initialpose",
        "geometry_msgs/PoseWithCovarianceStamped",
        Kind.INPUT,
        "initialpose",
        "sets the pose of the robot in the map",
        10,
    ),
    StandardEndpoint(
        "goal_pose",
        "geometry_msgs/PoseStamped",
        Kind.INPUT,
        "goal_pose",
        "navigates to a pose",
        10,
    ),
    StandardEndpoint(
        "cancel",
        "std_srvs/Trigger",
        Kind.SERVICE,
        "goal_pose",
        "cancels the navigation to `goal_pose`",
    ),
    StandardEndpoint(
        "stop",
        "std_srvs/Trigger",
        Kind.SERVICE,
        "stop",
        "stops the robot, and cancels its task and actions",
    ),
    StandardEndpoint(
        "connected",
        "std_msgs/Bool",
        Kind.LATCHED,
        "connected",
        "true while the link to the chassis is ready",
    ),
    StandardEndpoint(
        "/diagnostics",
        "diagnostic_msgs/DiagnosticArray",
        Kind.STREAM,
        "diagnostics",
        "link, chassis, battery, hardware, abnormal codes, motion, clock and agents, at 1 Hz",
        10,
    ),
)
"""All endpoints of the standard layer."""

BY_NAME = {each.name: each for each in STANDARD}
"""The endpoints by name."""


def markdown() -> str:
    """Return the table in Markdown."""
    rows = ["| Name | Type | Kind | Meaning |", "| --- | --- | --- | --- |"]
    rows += [f"| `{e.name}` | `{e.type}` | {e.kind.value} | {e.meaning} |" for e in STANDARD]
    return "\n".join(rows)
