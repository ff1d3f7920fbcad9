"""The job that drives to a pose, and the planning of its route."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

from woosh_robot_agent.pb.util import action_pb2 as util_action_pb2
from woosh_robot_agent.pb.util import navigation_pb2
from woosh_robot_agent.simulator import status_codes
from woosh_robot_agent.simulator.behaviour.jobs import Job, Progress, failed, is_clear
from woosh_robot_agent.simulator.body.base import (
    ACCELERATION,
    ANGULAR_ACCELERATION,
    Base,
    Velocity,
    approach,
)
from woosh_robot_agent.simulator.body.devices import Device
from woosh_robot_agent.simulator.refusals import RefusedError
from woosh_robot_agent.simulator.robot import Robot
from woosh_robot_agent.simulator.world.geometry import Point, Pose, Wall, outer_radius, wrap
from woosh_robot_agent.simulator.world.planner import (
    PATH_MARGIN,
    SearchBudget,
    SearchBudgetError,
    planner,
)


class NoRouteError(Exception):
    """There is no route. The text is the reason, then after a colon what to do.

    Attributes:
        code: status code of the reason.
    """

    def __init__(self, text: str, code: status_codes.Code) -> None:
        super().__init__(text)
        self.code = code


@dataclass(frozen=True, slots=True)
class Route:
    """A planned route.

    Attributes:
        legs: for each stop, the corners of the part of the route that leads to it, the stop last.
        poses: the start, and all corners, each with the direction in which the robot arrives there;
            the last one has the heading of the goal.
    """

    legs: tuple[tuple[Point, ...], ...]
    poses: tuple[Pose, ...]

    @property
    def length(self) -> float:
        """Length of the route, in metres."""
        return sum(here.distance(there.point) for here, there in pairwise(self.poses))


def plan_route(
    robot: Robot,
    start: Pose,
    stops: Iterable[Pose],
    *,
    strict: bool = False,
    obstacles: tuple[Wall, ...] = (),
) -> Route:
    """Plan a route for the robot with its current footprint.

    Args:
        stops: poses to pass, the goal last.
        strict: True to drive in straight lines from pose to pose, without regard to any walls.
        obstacles: walls to avoid in addition to the walls of the map.

    Raises:
        NoRouteError: there is no route, or the search takes too long. Never with `strict`.
    """
    routes = planner(robot.map, outer_radius(robot.outline) + PATH_MARGIN)
    budget = SearchBudget()
    here = start.point
    legs: list[tuple[Point, ...]] = []
    poses = [start]
    goal = start
    for goal in stops:
        try:
            leg = [goal.point] if strict else routes.plan(here, goal.point, obstacles, budget)
        except SearchBudgetError:
            raise NoRouteError(
                f"the way to {goal} is too long or too winding to plan: choose a nearer goal, "
                "or add poses on the way, each in sight of the next",
                status_codes.GOAL_UNREACHABLE,
            ) from None
        if leg is None:
            raise _no_path_error(robot, goal)
        for corner in leg:
            poses.append(Pose(*corner, math.atan2(corner[1] - here[1], corner[0] - here[0])))
            here = corner
        legs.append(tuple(leg))
    poses[-1] = goal  # with its own heading
    return Route(tuple(legs), tuple(poses))


def _no_path_error(robot: Robot, goal: Pose) -> NoRouteError:
    """Return the error for a goal to which no path leads."""
    grid = robot.map.grid
    if grid and grid.kept_out(*goal.point):
        text = f"{goal} is in a keep-out area: choose a goal outside of it"
        return NoRouteError(text, status_codes.GOAL_OCCUPIED)
    is_occupied = robot.map.contains(*goal.point) and not robot.can_stand(goal)
    code = status_codes.GOAL_OCCUPIED if is_occupied else status_codes.GOAL_UNREACHABLE
    return NoRouteError(f"no free path to {goal}: choose a goal on free floor", code)


DEFAULT_SPEED = 0.8
"""Maximum speed unless the navigation mode sets one, in m/s."""

TURN_SPEED = 0.8
"""Maximum turn rate, in rad/s."""

_POSITION_TOLERANCE = 1e-3
"""Distance from a point at which it counts as reached, in metres."""

_ANGLE_TOLERANCE = 1e-4
"""Angle from a heading at which it counts as reached, in radians."""

_GENTLE_BEND = 0.35
"""Angle between two parts of a path up to which the base drives on without stopping, in radians."""

_LOOKAHEAD = 0.2
"""Distance along a bending path to the point that the base steers to, in metres."""

_STEERING_TOLERANCE = 1e-3
"""Bearing of the point to steer to up to which the base drives straight on, in radians."""

_MAX_STRETCH = 2.0
"""Length of the path ahead on which the speed depends, in metres; enough to stop from 2 m/s."""

_PATH_SPACING = 0.3
"""Distance between two stops below which the base does not turn at the first one, in metres."""

_WAIT_TIMEOUT = 30.0
"""Time that a navigation waits in the modes with a timeout unless a client sets it, in seconds."""

_WAITING_MODES = (
    navigation_pb2.kNavWait,
    navigation_pb2.kNarrow,
    navigation_pb2.kMagnetic,
    navigation_pb2.kQrcode,
)
"""Modes in which the robot never leaves the path, and waits at an obstacle without a timeout."""


class _Stretch(NamedTuple):
    """The part of the path ahead that the base drives without stopping.

    Attributes:
        length: length from the base on, in metres.
        aim: the point on it that the base steers to.
        second: second corner, to tell if the first is passed; None if the base stops at the first.
    """

    length: float
    aim: Point
    second: Point | None


def _direction(here: Point, there: Point) -> float:
    """Return the direction from one point to another in the map's frame, in radians."""
    return math.atan2(there[1] - here[1], there[0] - here[0])


class Navigate(Job):
    """Drives to a goal.

    The base turns on the spot towards each corner of its path, and drives there. It stops at a
    corner, unless the path bends only gently. At the goal it turns to the goal's heading, unless
    the arrival type is vague. It stops before an obstacle that is not on the map. The navigation
    mode decides whether it then goes round the obstacle, waits or gives up.

    Args:
        via: poses to pass on the way, in the map's frame.
        strict: True to drive straight from one pose to the next, False to plan paths between them.
        one_by_one: True to turn to the heading of each pose of `via`, except if the next pose is
            less than 0.3 m away; False to ignore these headings.

    Attributes:
        goal: goal, in the map's frame.
        path: the path that was planned last, from its start on; empty before the first plan.
    """

    device = Device.WHEELS
    kind = util_action_pb2.kNav

    def __init__(
        self,
        goal: Pose,
        via: Iterable[Pose] = (),
        *,
        strict: bool = False,
        one_by_one: bool = False,
    ) -> None:
        self.goal = goal
        self.path: tuple[Pose, ...] = ()
        self._stops = deque([*via, goal])
        """Poses that are still to be passed, the goal last."""
        self._strict = strict
        self._one_by_one = one_by_one
        self._mode = navigation_pb2.ModeSetting(
            type=navigation_pb2.kAccurate, mode=navigation_pb2.kAvoid
        )
        """Arrival type, behaviour at obstacles and speed limit."""
        self._corners: deque[deque[Point]] | None = None
        """Remaining corners on the way to each of `_stops`; None before a path is planned."""
        self._announced = False
        """True if the start of the navigation has been reported."""
        self._last_corner: Point = (0.0, 0.0)
        """The last corner that the base has passed, at first the start of the path."""
        self._turning = True
        """True while the base turns on the spot towards the next corner."""
        self._waited = 0.0
        """Time for which an obstacle has been in the way, in seconds."""
        self._tried_obstacles: tuple[Wall, ...] | None = None
        """Obstacles for which a detour was last searched, None if none was searched yet.

        The search is repeated only when the obstacles have changed.
        """

    def change_path(self, robot: Robot, via: Iterable[Pose], *, strict: bool) -> None:
        """Take another way to the same goal: through `via`, and straight if `strict` is True.

        Raises:
            RefusedError: there is no such way. The job keeps its way.
        """
        before = self._stops, self._strict
        self._stops, self._strict = deque([*via, self.goal]), strict
        try:
            self._plan(robot)
        except NoRouteError as error:
            self._stops, self._strict = before
            raise RefusedError(str(error)) from None

    def change_mode(self, mode: navigation_pb2.ModeSetting) -> None:
        """Set the arrival type, the behaviour at obstacles and the speed limit."""
        self._mode.CopyFrom(mode)
        self._tried_obstacles = None  # search a detour again, if the new mode allows one

    def suspend(self, robot: Robot) -> None:
        """Drop the path: the base may be elsewhere when the job continues."""
        self.replan()

    def replan(self) -> None:
        """Plan a new path before the next move."""
        self._corners = None
        self._waited = 0.0
        self._tried_obstacles = None

    def tick(self, robot: Robot, dt: float) -> Progress:
        if self._corners is None:
            try:
                self._plan(robot)
            except NoRouteError as error:
                return failed(str(error), error.code.number)
        if not self._announced:
            self._announced = True
            robot.codes.report(status_codes.NEW_NAVIGATION, self.kind)
        base = robot.base
        free = self._clear_ahead(robot)
        progress = self._progress(base)
        if base.blocked or not free:
            self._waited += dt
            progress = self._handle_obstacle(robot)
            # With a free way ahead, e.g. if a wall beside the base blocks it, the base drives on.
            if not free or progress.done:
                return progress
        else:
            self._waited = 0.0
            self._tried_obstacles = None
        if self._drive_on(robot, dt):
            return progress
        # The job can run again: a task may list the same drive twice, with a move between.
        self._stops.append(self.goal)
        self.replan()
        return Progress(done=True, text=f"arrived at {base.pose}")

    def _drive_on(self, robot: Robot, dt: float) -> bool:
        """Drive or turn along the planned path. Return False instead at the goal."""
        assert self._corners is not None
        while self._corners:
            corners = self._corners[0]
            if corners:
                if self._drive_to(corners[0], robot, dt):
                    return True
                self._last_corner = corners.popleft()
            elif self._turn_to(self._stops[0], robot.base, dt):
                return True
            else:
                self._corners.popleft()
                self._stops.popleft()
        return False

    def _plan(self, robot: Robot, obstacles: tuple[Wall, ...] = ()) -> None:
        """Plan a path that also avoids `obstacles`; raise NoRouteError if there is none."""
        route = plan_route(
            robot, robot.base.pose, self._stops, strict=self._strict, obstacles=obstacles
        )
        self.path = route.poses
        self._corners = deque(map(deque, route.legs))
        self._last_corner = robot.base.pose.point
        self._turning = True

    def _clear_ahead(self, robot: Robot) -> bool:
        """Return True if no obstacle is in the way on this stretch, or if the base turns first."""
        if self._turning or not self._corners or not self._corners[0]:
            return True
        return is_clear(robot, 0.0, self._stretch_ahead(robot.base.pose).length)

    def _handle_obstacle(self, robot: Robot) -> Progress:
        """Plan a way round an obstacle, wait or give up, depending on the mode."""
        mode, base = self._mode.mode, robot.base
        wait_timeout = float(self._mode.wait_timeout) or _WAIT_TIMEOUT
        text = f"an obstacle stands in the way at {base.pose}"
        if mode in _WAITING_MODES:
            return Progress(text=text, impeded=True)
        if mode == navigation_pb2.kOvertime:  # never leaves the path, and gives up after the wait
            gives_up_after = wait_timeout
        else:
            detours_after = wait_timeout if mode == navigation_pb2.kTimeout else 0.0
            if self._waited > detours_after and not base.moving and self._plan_detour(robot):
                return self._progress(base)
            timeout = robot.profile.tasks.obstacle_timeout
            gives_up_after = math.inf if timeout is None else detours_after + timeout
        if self._waited > gives_up_after:
            return failed(f"{text}: remove it or choose another goal")
        return Progress(text=text, impeded=True)

    def _plan_detour(self, robot: Robot) -> bool:
        """Plan a path round the current obstacles. Return False if there is no path.

        A strict path has no detour, and obstacles for which none was found are not tried again.
        """
        obstacles = robot.obstacles.walls
        if self._strict or obstacles == self._tried_obstacles:
            return False
        self._tried_obstacles = obstacles
        try:
            self._plan(robot, obstacles)
        except NoRouteError:
            return False
        robot.codes.report(status_codes.OBSTACLE_AVOIDED, self.kind)
        return True

    def _drive_to(self, corner: Point, robot: Robot, dt: float) -> bool:
        """Drive towards the next corner. Return False instead when it is reached or passed."""
        base, stretch = robot.base, self._stretch_ahead(robot.base.pose)
        distance, bearing = base.pose.distance(corner), base.pose.bearing(corner)
        second = stretch.second
        # Inside a stretch the base cuts corners, without reaching them exactly. It has passed a
        # corner when it is nearer to the second corner than that corner is.
        if second and base.pose.distance(second) <= math.dist(corner, second):
            return False
        if distance <= _POSITION_TOLERANCE:
            self._turning = second is None  # the base stops here, and turns to the next corner
            return False
        if self._turning:
            if abs(bearing) > _ANGLE_TOLERANCE:
                base.drive(Velocity(turn=approach(bearing, TURN_SPEED, ANGULAR_ACCELERATION, dt)))
                return True
            self._turning = False
            robot.codes.report(status_codes.DRIVING_STRAIGHT, self.kind)
        # How far the base can drive: to the end of the stretch, or until the corner is beside it.
        ahead = stretch.length if second else distance * math.cos(bearing)
        if ahead <= _POSITION_TOLERANCE:  # the corner is beside the base or behind it
            self._turning = True
            return False
        speed, turn = approach(ahead, self._mode.max_speed or DEFAULT_SPEED, ACCELERATION, dt), 0.0
        to_aim = base.pose.bearing(stretch.aim)
        if abs(to_aim) > _STEERING_TOLERANCE:
            # Drive on the arc that leads to the aim.
            curvature = 2.0 * math.sin(to_aim) / base.pose.distance(stretch.aim)
            speed = min(speed, TURN_SPEED / abs(curvature))
            turn = speed * curvature
        # In the next step, turn on the spot first if the base points elsewhere, e.g. to a detour.
        self._turning = abs(to_aim) > 2.0 * _GENTLE_BEND
        base.drive(Velocity(speed, turn=turn))
        return True

    def _stretch_ahead(self, here: Pose) -> _Stretch:
        """Return the part of the path from `here` to where the base has to stop or turn."""
        corners = self._corners_of_stretch()
        # the aim is `_LOOKAHEAD` ahead, or the end of a shorter stretch
        length, aim, before = 0.0, corners[-1], here.point
        for corner in corners:
            step = math.dist(before, corner)
            if length < _LOOKAHEAD <= length + step:
                share = (_LOOKAHEAD - length) / step
                aim = (
                    before[0] + share * (corner[0] - before[0]),
                    before[1] + share * (corner[1] - before[1]),
                )
            length += step
            before = corner
        return _Stretch(length, aim, corners[1] if len(corners) > 1 else None)

    def _corners_of_stretch(self) -> list[Point]:
        """Return the next corners, up to the first at which the base has to stop.

        Corners of further legs count only until the length exceeds `_MAX_STRETCH`.
        """
        assert self._corners
        corners: list[Point] = []
        length = 0.0
        for number, leg in enumerate(self._corners):
            for corner in leg:
                if not corners:
                    corners.append(corner)
                elif corner != corners[-1]:  # a repeated corner would have no direction
                    before = corners[-2] if len(corners) > 1 else self._last_corner
                    last = corners[-1]
                    bend = wrap(_direction(last, corner) - _direction(before, last))
                    if abs(bend) > _GENTLE_BEND:
                        return corners
                    length += math.dist(last, corner)
                    corners.append(corner)
            if self._turns_at(number) or length > _MAX_STRETCH:
                break
        return corners

    def _turns_at(self, number: int) -> bool:
        """Return True if the base turns to the heading of a stop.

        Args:
            number: number of the stop, from 0 for the next one.
        """
        if number == len(self._stops) - 1:
            return True
        stop, after = self._stops[number], self._stops[number + 1]
        return self._one_by_one and stop.distance(after.point) >= _PATH_SPACING

    def _turn_to(self, stop: Pose, base: Base, dt: float) -> bool:
        """Turn to the heading of `stop`. Return False instead when no turn is needed."""
        is_goal = len(self._stops) == 1
        any_heading = is_goal and self._mode.type == navigation_pb2.kVague
        if any_heading or not self._turns_at(0):
            return False
        error = wrap(stop.theta - base.pose.theta)
        if abs(error) <= _ANGLE_TOLERANCE:
            return False
        base.drive(Velocity(turn=approach(error, TURN_SPEED, ANGULAR_ACCELERATION, dt)))
        return True

    def _progress(self, base: Base) -> Progress:
        return Progress(text=f"{base.pose.distance(self.goal.point):.2f} m from the goal")
