"""Actions that plan a path without driving it."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path

from woosh_robot_agent.link import FrameError, LinkError, RequestTimeoutError
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.pb.robot.robot_pack_pb2 import PlanNavPath
from woosh_robot_agent.pb.robot.robot_pb2 import NavPath
from woosh_robot_agent.robot.readiness import LOST, NOT_INITIALISED
from woosh_robot_agent.ros.nav2.action import Nav2Action
from woosh_robot_agent.ros.nav2.goals import GoalEnd, Nav2Goal, to_duration
from woosh_robot_agent.ros.nav2.navigation import chassis_pose, poses_in, transform_all
from woosh_robot_agent.ros.standard.poses import Pose2D, to_pose


class _Planning(Nav2Action):
    """An action that plans a path. A new goal replaces the running one."""

    drives = False

    @abstractmethod
    def poses(self, request: Any) -> list[PoseStamped]:
        """Return the poses to which a goal wants a path, one after the other."""

    async def check(self, request: Any) -> None:
        start = [request.start] if request.use_start else []
        await transform_all(self.context.frames, [*self.poses(request), *start])
        self.log_unused(request, "planner_id")

    async def execute(self, goal: Nav2Goal) -> None:
        poses = self.poses(goal.request)
        if not poses:
            raise GoalEnd("the goal has no poses: give at least one", "NO_VIAPOINTS_GIVEN")
        start = goal.request.start if goal.request.use_start else self._robot_pose()
        try:
            goal.result.path = await goal.run(self._path([start, *poses]), "path")
        finally:
            goal.result.planning_time = to_duration(goal.elapsed)

    def _robot_pose(self) -> PoseStamped:
        if self.context.pose.pose is None:
            raise GoalEnd("the robot's pose is not known: wait for the link to the robot")
        return self.context.pose.stamped

    async def _path(self, stops: Sequence[PoseStamped]) -> Path:
        path = Path(header=self.context.header("map"))
        for start, end in pairwise(stops):
            segment = await self._segment(start, end)
            if path.poses:  # a further segment begins with the last pose of the one before
                del segment[0]
            path.poses.extend(
                PoseStamped(header=path.header, pose=to_pose(each)) for each in segment
            )
        return path

    async def _segment(self, start: PoseStamped, end: PoseStamped) -> list[Pose2D]:
        """Return the poses of the path from one pose to another.

        Raises:
            GoalEnd: there is no path.
        """
        request = PlanNavPath(start=chassis_pose(start), end=chassis_pose(end))
        try:
            answer = await self.context.chassis.request(self.context.requests.address(request))
        except LinkError as error:
            code = "TIMEOUT" if isinstance(error, RequestTimeoutError) else "UNKNOWN"
            raise GoalEnd(str(error), code) from None
        if not answer.ok:
            for objection in self.context.objections_except_busy:
                if objection in (NOT_INITIALISED, LOST):
                    raise GoalEnd(f"{objection} (the chassis: {answer.reason})")
            here, there = (
                f"({each.pose.position.x:.2f}, {each.pose.position.y:.2f})" for each in (start, end)
            )
            text = f"no free path from {here} to {there}: choose a goal on free floor"
            raise GoalEnd(f"{text} (the chassis: {answer.reason})", "NO_VALID_PATH")
        # firmware answers with the type NavPath or PlanNavPath; the content is a NavPath
        body = answer.body
        try:
            if not isinstance(body, NavPath):
                body = answer.raw.as_type(full_name(NavPath)).message()
            poses = [Pose2D.from_message(each) for each in body.path.poses]
        except (ValueError, FrameError) as error:
            raise GoalEnd(f"the chassis has sent no usable path: {error}") from None
        if not poses:
            raise GoalEnd("the chassis has sent an empty path", "NO_VALID_PATH")
        return poses


class ComputePathToPose(_Planning):
    """Plans a path to a pose."""

    name = "compute_path_to_pose"

    def poses(self, request: Any) -> list[PoseStamped]:
        return [request.goal]


class ComputePathThroughPoses(_Planning):
    """Plans a path through poses."""

    name = "compute_path_through_poses"

    def poses(self, request: Any) -> list[PoseStamped]:
        return poses_in(request.goals)
