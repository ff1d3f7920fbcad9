"""The tables of topics, services and actions of standard ROS types, Nav2's among them.

Servers, publishers, policies, documentation and tests derive from them. Names are relative to the
agent's namespace unless they begin with a slash.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from functools import partial


class Kind(Enum):
    """Kind of an endpoint; for a published topic also its quality of service (REP 2003)."""

    STREAM = "published, reliable"
    LATCHED = "published, reliable and transient local"
    INPUT = "subscribed"
    SERVICE = "service"
    READING_SERVICE = "service that changes nothing"
    ACTION = "action"


@dataclass(frozen=True)
class StandardEndpoint:
    """A topic, service or action of a standard ROS type.

    Attributes:
        type: ROS type, `package/Name`.
        meaning: what it contains or does, for the documentation.
        depth: queue size of the publisher or subscription.
    """

    kind: Kind
    name: str
    type: str
    meaning: str
    depth: int = 1


_stream = partial(StandardEndpoint, Kind.STREAM)
_latched = partial(StandardEndpoint, Kind.LATCHED)
_input = partial(StandardEndpoint, Kind.INPUT)
_service = partial(StandardEndpoint, Kind.SERVICE)
_reading = partial(StandardEndpoint, Kind.READING_SERVICE)
_action = partial(StandardEndpoint, Kind.ACTION)

STANDARD = (
    _stream("odom", "nav_msgs/Odometry", "pose in `odom`, velocity in `base_link`", 10),
    _stream(
        "/tf",
        "tf2_msgs/TFMessage",
        "`map` -> `odom` -> `base_link`, with each message on `odom`",
        100,
    ),
    _latched("/tf_static", "tf2_msgs/TFMessage", "`base_link` -> `laser`"),
    _stream(
        "scan", "sensor_msgs/LaserScan", "laser scan, requested only while there are subscribers", 5
    ),
    _latched(
        "battery_state",
        "sensor_msgs/BatteryState",
        "state of charge, and whether the battery is charging",
    ),
    _latched("map", "nav_msgs/OccupancyGrid", "current map, or the map that the robot is making"),
    _latched(
        "keepout_mask",
        "nav_msgs/OccupancyGrid",
        "keep-out areas of the current map, as a mask for Nav2's KeepoutFilter",
    ),
    _latched("plan", "nav_msgs/Path", "path that the robot is following"),
    _latched("footprint", "geometry_msgs/PolygonStamped", "current outline of the robot"),
    _input("cmd_vel", "geometry_msgs/Twist", "velocity command; repeat it to keep driving"),
    _input(
        "initialpose",
        "geometry_msgs/PoseWithCovarianceStamped",
        "sets the pose of the robot in the map",
        10,
    ),
    _input("goal_pose", "geometry_msgs/PoseStamped", "navigates to a pose", 10),
    _service("cancel", "std_srvs/Trigger", "cancels the navigation to `goal_pose`"),
    _service("stop", "std_srvs/Trigger", "stops the robot, and cancels its task and actions"),
    _latched("connected", "std_msgs/Bool", "true while the link to the chassis is ready"),
    _stream(
        "/diagnostics",
        "diagnostic_msgs/DiagnosticArray",
        "link, chassis, battery, hardware, abnormal codes, motion, clock and agents, at 1 Hz",
        10,
    ),
)
"""All endpoints of the standard layer (`ros/standard/`)."""


MANAGERS = ("lifecycle_manager_navigation", "lifecycle_manager_localization")
"""Managers of Nav2's nodes: the first one manages bt_navigator, the second one amcl."""

CLEARING = {
    "global_costmap/clear_entirely_global_costmap": "ClearEntireCostmap",
    "local_costmap/clear_entirely_local_costmap": "ClearEntireCostmap",
    "local_costmap/clear_costmap_except_region": "ClearCostmapExceptRegion",
    "local_costmap/clear_costmap_around_robot": "ClearCostmapAroundRobot",
    "local_costmap/clear_costmap_around_pose": "ClearCostmapAroundPose",
}
"""Services that clear costmaps, as nav2_simple_commander names them, and their types."""

NAV2 = (
    _action("navigate_to_pose", "nav2_msgs/NavigateToPose", "`MoveBase` to the pose"),
    _action(
        "navigate_through_poses",
        "nav2_msgs/NavigateThroughPoses",
        "one `MoveBase` through all poses, in their order",
    ),
    _action(
        "follow_waypoints",
        "nav2_msgs/FollowWaypoints",
        "a `MoveBase` for each pose; a pose without a path to it is missed, and the next one is "
        "tried",
    ),
    _action("compute_path_to_pose", "nav2_msgs/ComputePathToPose", "`PlanNavPath`"),
    _action(
        "compute_path_through_poses",
        "nav2_msgs/ComputePathThroughPoses",
        "`PlanNavPath` from each pose to the next",
    ),
    _action("spin", "nav2_msgs/Spin", "`StepControl`: a turn, at 0.8 rad/s at most"),
    _action(
        "drive_on_heading",
        "nav2_msgs/DriveOnHeading",
        "`StepControl`: straight ahead, or back if target and speed are negative",
    ),
    _action("backup", "nav2_msgs/BackUp", "`StepControl`: straight back"),
    _action("wait", "nav2_msgs/Wait", "waits; the chassis gets nothing"),
    _action(
        "assisted_teleop",
        "nav2_msgs/AssistedTeleop",
        "drives the robot by the velocities on `cmd_vel_teleop` until it is cancelled",
    ),
    _action(
        "dock_robot",
        "nav2_msgs/DockRobot",
        "a charging task at the charger with the mark `dock_id` or near `dock_pose`; with an empty "
        "id, at the nearest charger; succeeds when the robot charges",
    ),
    _action(
        "undock_robot",
        "nav2_msgs/UndockRobot",
        "cancels a charging task, and backs out of the charger by `ChargeControl`; fails if the "
        "robot is in no charger",
    ),
    _service(
        "map_server/load_map",
        "nav2_msgs/LoadMap",
        "`SwitchMap` to the robot's map with the name of the file, without folder and suffix: in "
        "the current scene, or else in another scene",
    ),
    _reading("map_server/map", "nav_msgs/GetMap", "the map that the robot uses"),
    _reading(
        "bt_navigator/get_state",
        "lifecycle_msgs/GetState",
        "active while there is a link and the robot accepts tasks",
    ),
    _reading("amcl/get_state", "lifecycle_msgs/GetState", "active while there is a link"),
    *(
        _reading(f"{manager}/is_active", "std_srvs/Trigger", "true while its node is active")
        for manager in MANAGERS
    ),
    *(
        _reading(
            f"{manager}/manage_nodes",
            "nav2_msgs/ManageLifecycleNodes",
            "start and resume succeed while active; other commands fail, because the robot's own "
            "navigation cannot be switched off",
        )
        for manager in MANAGERS
    ),
    *(
        _reading(name, f"nav2_msgs/{type_name}", "nothing: the robot keeps no costmap for clients")
        for name, type_name in CLEARING.items()
    ),
    _latched(
        "amcl_pose",
        "geometry_msgs/PoseWithCovarianceStamped",
        "the robot's pose in the map: after it was set, and every 0.25 m or 0.2 rad",
    ),
    _input(
        "speed_limit",
        "nav2_msgs/SpeedLimit",
        "limits the speed of each navigation; a percentage refers to `cmd_vel_max_linear`, and "
        "100 % is no limit",
    ),
    _input(
        "cmd_vel_teleop",
        "geometry_msgs/Twist",
        "velocities of `assisted_teleop`, by the rules of `cmd_vel`",
    ),
    _input("preempt_teleop", "std_msgs/Empty", "ends `assisted_teleop` with success"),
)
"""The endpoints of Nav2, which the agent has with the parameter `nav2` (`ros/nav2/`)."""

BY_NAME = {each.name: each for each in (*STANDARD, *NAV2)}
"""All endpoints by name."""


def markdown(table: Iterable[StandardEndpoint]) -> str:
    """Return a table in Markdown."""
    rows = ["| Name | Type | Kind | Meaning |", "| --- | --- | --- | --- |"]
    rows += [f"| `{e.name}` | `{e.type}` | {e.kind.value} | {e.meaning} |" for e in table]
    return "\n".join(rows)
