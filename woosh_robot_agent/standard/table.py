"""The table of the standard layer's topics and services. All else derives from it.

Names are relative to the agent's namespace unless they begin with a slash.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Kind(Enum):
    """What an endpoint is, and for a topic its quality of service (REP 2003)."""

    STREAM = "topic, reliable"
    LATCHED = "topic, reliable and transient local"
    INPUT = "subscribed"
    SERVICE = "service"


@dataclass(frozen=True)
class Standard:
    """One topic or service.

    Attributes:
        name: its name.
        type: its ROS type, `package/Name`.
        kind: what it is.
        switch: the parameter that switches it.
        meaning: for people.
        depth: messages that are queued.
    """

    name: str
    type: str
    kind: Kind
    switch: str
    meaning: str
    depth: int = 1

    @property
    def is_output(self) -> bool:
        """Whether it is a topic that the agent publishes."""
        return self.kind in (Kind.STREAM, Kind.LATCHED)


STANDARD = (
    Standard(
        "odom",
        "nav_msgs/Odometry",
        Kind.STREAM,
        "enable_odom",
        "pose in `odom`, speed in `base_link`",
        10,
    ),
    Standard(
        "/tf",
        "tf2_msgs/TFMessage",
        Kind.STREAM,
        "publish_tf",
        "`map` -> `odom` -> `base_link`, with each odom",
        100,
    ),
    Standard(
        "/tf_static", "tf2_msgs/TFMessage", Kind.LATCHED, "publish_tf", "`base_link` -> `laser`"
    ),
    Standard(
        "scan", "sensor_msgs/LaserScan", Kind.STREAM, "enable_scan", "asked for while subscribed", 5
    ),
    Standard(
        "battery_state",
        "sensor_msgs/BatteryState",
        Kind.LATCHED,
        "enable_battery_state",
        "charge and whether it charges",
    ),
    Standard("map", "nav_msgs/OccupancyGrid", Kind.LATCHED, "enable_map", "the map in use"),
    Standard("plan", "nav_msgs/Path", Kind.LATCHED, "enable_plan", "the path being driven"),
    Standard(
        "footprint",
        "geometry_msgs/PolygonStamped",
        Kind.LATCHED,
        "enable_footprint",
        "the outline in use",
    ),
    Standard(
        "cmd_vel",
        "geometry_msgs/Twist",
        Kind.INPUT,
        "enable_cmd_vel",
        "drives, while it is repeated",
        1,
    ),
    Standard(
        "initialpose",
        "geometry_msgs/PoseWithCovarianceStamped",
        Kind.INPUT,
        "enable_initialpose",
        "tells the robot where it is",
        10,
    ),
    Standard(
        "goal_pose",
        "geometry_msgs/PoseStamped",
        Kind.INPUT,
        "enable_goal_pose",
        "navigates there",
        10,
    ),
    Standard(
        "cancel", "std_srvs/Trigger", Kind.SERVICE, "enable_goal_pose", "cancels the goal_pose"
    ),
    Standard(
        "stop", "std_srvs/Trigger", Kind.SERVICE, "enable_stop", "stops and cancels everything"
    ),
    Standard(
        "connected",
        "std_msgs/Bool",
        Kind.LATCHED,
        "enable_connected",
        "whether the chassis is there",
    ),
    Standard(
        "/diagnostics",
        "diagnostic_msgs/DiagnosticArray",
        Kind.STREAM,
        "enable_diagnostics",
        "link, chassis, battery, hardware and abnormal codes, at 1 Hz",
        10,
    ),
)
BY_NAME = {each.name: each for each in STANDARD}


def markdown() -> str:
    """The table in Markdown, as the README shows it."""
    rows = ["| Name | Type | Kind | Meaning |", "| --- | --- | --- | --- |"]
    rows += [f"| `{e.name}` | `{e.type}` | {e.kind.value} | {e.meaning} |" for e in STANDARD]
    return "\n".join(rows)


if __name__ == "__main__":
    print(markdown())
