"""The table of Nav2's actions, services and topics that the agent has with the parameter `nav2`.

Servers, policies, documentation and tests derive from it. Names are relative to the agent's
namespace.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Kind(Enum):
    """Kind of an endpoint."""

    ACTION = "action"
    SERVICE = "service"
    READING_SERVICE = "service that changes nothing"
    LATCHED = "published, reliable and transient local"
    INPUT = "subscribed"


@dataclass(frozen=True)
class Nav2Endpoint:
    """An action, service or topic of Nav2.

    Attributes:
        name: name of the endpoint.
        type: ROS type, `package/Name`.
        kind: kind of the endpoint.
        meaning: what the agent does for this endpoint, for the documentation.
    """

    name: str
    type: str
    kind: Kind
    meaning: str


def _action(name: str, type_name: str, meaning: str) -> Nav2Endpoint:
    return Nav2Endpoint(name, f"nav2_msgs/{type_name}", Kind.ACTION, meaning)


def _reading(name: str, type_name: str, meaning: str) -> Nav2Endpoint:
    return Nav2Endpoint(name, type_name, Kind.READING_SERVICE, meaning)


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
    _action("navigate_to_pose", "NavigateToPose", "`MoveBase` to the pose"),
    _action(
        "navigate_through_poses",
        "NavigateThroughPoses",
        "one `MoveBase` through all poses, one by one",
    ),
    _action(
        "follow_waypoints",
        "FollowWaypoints",
        "a `MoveBase` for each pose; a pose without a path to it is missed, and the next one is "
        "tried",
    ),
    _action("compute_path_to_pose", "ComputePathToPose", "`PlanNavPath`"),
    _action(
        "compute_path_through_poses",
        "ComputePathThroughPoses",
        "`PlanNavPath` from each pose to the next",
    ),
    _action("spin", "Spin", "`StepControl`: a turn, at 0.8 rad/s at most"),
    _action(
        "drive_on_heading",
        "DriveOnHeading",
        "`StepControl`: straight ahead, or back if target and speed are negative",
    ),
    _action("backup", "BackUp", "`StepControl`: straight back"),
    _action("wait", "Wait", "waits; the chassis gets nothing"),
    _action(
        "assisted_teleop",
        "AssistedTeleop",
        "drives the robot by the velocities on `cmd_vel_teleop` until it is cancelled",
    ),
    _action(
        "dock_robot",
        "DockRobot",
        "a charging task at the charger with the mark `dock_id` or near `dock_pose`; with an empty "
        "id, at the nearest charger; succeeds when the robot charges",
    ),
    _action(
        "undock_robot",
        "UndockRobot",
        "cancels a charging task, and backs out of the charger by `ChargeControl`; fails if the "
        "robot is in no charger",
    ),
    Nav2Endpoint(
        "map_server/load_map",
        "nav2_msgs/LoadMap",
        Kind.SERVICE,
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
    Nav2Endpoint(
        "amcl_pose",
        "geometry_msgs/PoseWithCovarianceStamped",
        Kind.LATCHED,
        "the robot's pose in the map: after it was set, and every 0.25 m or 0.2 rad",
    ),
    Nav2Endpoint(
        "speed_limit",
        "nav2_msgs/SpeedLimit",
        Kind.INPUT,
        "limits the speed of each navigation; a percentage refers to `cmd_vel_max_linear`, and "
        "100 % is no limit",
    ),
    Nav2Endpoint(
        "cmd_vel_teleop",
        "geometry_msgs/Twist",
        Kind.INPUT,
        "velocities of `assisted_teleop`, by the rules of `cmd_vel`",
    ),
    Nav2Endpoint(
        "preempt_teleop", "std_msgs/Empty", Kind.INPUT, "ends `assisted_teleop` with success"
    ),
)
"""All endpoints of Nav2."""

BY_NAME = {each.name: each for each in NAV2}
"""The endpoints by name."""


def markdown() -> str:
    """Return the table in Markdown."""
    rows = ["| Name | Type | Kind | What it does |", "| --- | --- | --- | --- |"]
    rows += [f"| `{e.name}` | `{e.type}` | {e.kind.value} | {e.meaning} |" for e in NAV2]
    return "\n".join(rows)
