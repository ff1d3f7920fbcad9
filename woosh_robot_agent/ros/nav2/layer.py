"""Create all of Nav2's interfaces."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from nav2_msgs import action as nav2_actions

from woosh_robot_agent.ros.actions.actions import Actions
from woosh_robot_agent.ros.nav2.action import Nav2Action
from woosh_robot_agent.ros.nav2.behaviors import AssistedTeleop, BackUp, DriveOnHeading, Spin, Wait
from woosh_robot_agent.ros.nav2.cancels import CancelLog
from woosh_robot_agent.ros.nav2.docking import DockRobot, UndockRobot
from woosh_robot_agent.ros.nav2.frames import Frames
from woosh_robot_agent.ros.nav2.goals import Nav2Context
from woosh_robot_agent.ros.nav2.navigation import (
    FollowWaypoints,
    NavigateThroughPoses,
    NavigateToPose,
    SpeedLimit,
)
from woosh_robot_agent.ros.nav2.planning import ComputePathThroughPoses, ComputePathToPose
from woosh_robot_agent.ros.nav2.pose import RobotPose
from woosh_robot_agent.ros.nav2.servers import Costmaps, Lifecycle, MapServer
from woosh_robot_agent.ros.nav2.slots import DrivingSlot
from woosh_robot_agent.ros.standard.layer import keep_running
from woosh_robot_agent.ros.standard.part import PartContext
from woosh_robot_agent.ros.standard.poses import Pose2D
from woosh_robot_agent.ros.standard_endpoints import BY_NAME

_ACTIONS: tuple[type[Nav2Action], ...] = (
    NavigateToPose,
    NavigateThroughPoses,
    FollowWaypoints,
    ComputePathToPose,
    ComputePathThroughPoses,
    Spin,
    DriveOnHeading,
    BackUp,
    Wait,
    DockRobot,
    UndockRobot,
)
"""All actions, except for AssistedTeleop, which must be created before the link starts."""


class Nav2Layer:
    """Nav2's actions, services and topics. Actions that the release's nav2_msgs lacks are left out.

    Create it before the link starts, because some of its objects listen to the link. Call `start`
    after that, so that most servers are created while the link connects.

    Args:
        map_to_odom: returns the pose of the odometry's frame in the map; None if it is unknown.
        result_timeout: time for which the results of goals are kept, in seconds.

    Attributes:
        speed_limit: the topic speed_limit.
    """

    def __init__(
        self,
        standard: PartContext,
        actions: Actions,
        map_to_odom: Callable[[], Pose2D | None],
        result_timeout: float,
    ) -> None:
        pose = RobotPose(standard)
        frames = Frames(standard, lambda: pose.pose, map_to_odom)
        self._driving = DrivingSlot(standard.chassis, standard.gate, standard.last_known)
        self._context = Nav2Context(
            **vars(standard),
            actions=actions,
            frames=frames,
            pose=pose,
            cancels=CancelLog(standard.gate),
            result_timeout=result_timeout,
        )
        self._teleop = AssistedTeleop(self._context, self._driving)
        self._actions: list[Nav2Action] = [self._teleop]
        self.speed_limit = SpeedLimit(standard, self._driving)

    def start(self) -> None:
        """Create the other actions and the services, and start AssistedTeleop."""
        context = self._context
        for action in _ACTIONS:
            if hasattr(nav2_actions, BY_NAME[action.name].type.partition("/")[2]):
                self._actions.append(action(context, self._driving))
        Lifecycle(context)
        MapServer(context)
        Costmaps(context)
        context.thread.spawn(partial(keep_running, self._teleop.run, self._teleop.name))

    @property
    def open_goals(self) -> int:
        """Number of goals that have not ended."""
        return sum(action.server.open_goals for action in self._actions)

    @property
    def driving_goals(self) -> int:
        """Number of goals that move the robot and have not ended. Use it in the link thread."""
        return len(self._driving.running)

    async def stop(self) -> None:
        """Abort the goals that have not ended. Call it in the link thread."""
        for action in self._actions:
            await action.stop()
