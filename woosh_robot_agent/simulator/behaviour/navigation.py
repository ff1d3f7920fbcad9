"""Navigation: driving to a pose along free floor, or along a path that is given."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from typing import TYPE_CHECKING

from woosh_robot_agent.pb.robot import robot_count_pb2
from woosh_robot_agent.pb.util import action_pb2 as util_action_pb2
from woosh_robot_agent.pb.util import navigation_pb2
from woosh_robot_agent.simulator.behaviour.forward_clearance import way_is_free
from woosh_robot_agent.simulator.behaviour.jobs import Device, Progress, failed
from woosh_robot_agent.simulator.body.base import (
    ACCELERATION_MPS2,
    ACCELERATION_RADPS2,
    Base,
    Velocity,
    approach,
)
from woosh_robot_agent.simulator.body.codes import AVOIDED, DRIVING_STRAIGHT, NEW_NAVIGATION
from woosh_robot_agent.simulator.errors import Refused
from woosh_robot_agent.simulator.world.footprints import FOOTPRINTS, outer_radius
from woosh_robot_agent.simulator.world.geometry import Point, Pose, Wall, wrap
from woosh_robot_agent.simulator.world.planner import Effort, TooMuchEffortError, planner

if TYPE_CHECKING:
    from woosh_robot_agent.simulator.chassis import Chassis

USUAL_SPEED_MPS = 0.8
TURN_SPEED_RADPS = 0.8
MARGIN_M = 0.05
_NEAR_M = 1e-3
_STRAIGHT_RAD = 1e-4
_PATIENCE_S = 30.0

#: The modes that keep to their way, and wait for it to become free however long that takes.
_WAITING = (
    navigation_pb2.kNavWait,
    navigation_pb2.kNarrow,
    navigation_pb2.kMagnetic,
    navigation_pb2.kQrcode,
)

_Level = robot_count_pb2.StatusCode


class Navigate:
    """Driving to a goal.

    The base turns on the spot towards each corner of its path, drives there and stops, and at last
    turns to the goal's heading. Before an obstacle that is not on the map it stops, and goes round
    it, waits or gives up, as its mode says.

    Args:
        goal: Where to arrive, in the map's frame.
        via: Poses to pass on the way.
        strict: Drive straight from one to the next whatever stands there; else plan between them.
        one_by_one: Take on the heading of each pose of `via` too.
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
        self._stops = deque([*via, goal])
        self._strict = strict
        self._one_by_one = one_by_one
        self._mode = navigation_pb2.ModeSetting(
            type=navigation_pb2.kAccurate, mode=navigation_pb2.kAvoid
        )
        self._corners: deque[deque[Point]] | None = None
        self._announced = False
        self._turning = True
        self._waited = 0.0
        self._tried: tuple[Wall, ...] | None = None
        self.path: tuple[Pose, ...] = ()

    @property
    def stops(self) -> tuple[Pose, ...]:
        """The poses that are still to be passed, the goal last."""
        return tuple(self._stops)

    def change_path(self, chassis: Chassis, via: Iterable[Pose], *, strict: bool) -> None:
        """Go another way to the same goal.

        Raises:
            Refused: There is none.
        """
        before = self._stops, self._strict
        self._stops, self._strict = deque([*via, self.goal]), strict
        objection = self._plan(chassis)
        if objection:
            self._stops, self._strict = before
            raise Refused(objection)

    def change_mode(self, mode: navigation_pb2.ModeSetting) -> None:
        """Obey another arrival type, behaviour at obstacles and speed limit from now on."""
        self._mode.CopyFrom(mode)
        self._tried = None

    def hold(self, chassis: Chassis) -> None:
        """See `Job.hold`: the way is planned anew afterwards."""
        self.replan()

    def replan(self) -> None:
        """Plan the way anew before the next move."""
        self._corners = None
        self._waited = 0.0
        self._tried = None

    def tick(self, chassis: Chassis, dt: float) -> Progress:
        """See `Job.tick`."""
        if self._corners is None:
            objection = self._plan(chassis)
            if objection:
                return failed(objection)
        if not self._announced:
            self._announced = True
            chassis.codes.report(NEW_NAVIGATION, _Level.kNormal, self.kind)
        base = chassis.base
        free = self._way_is_free(chassis)
        held_up: Progress | None = None
        if base.blocked or not free:
            self._waited += dt
            held_up = self._deal_with_obstacle(chassis)
            if not free or held_up.done:
                return held_up
        else:
            self._waited = 0.0
            self._tried = None
        # What it touches without having seen it, a wall beside its way, it goes on trying to pass.
        while self._corners:
            corners, stop = self._corners[0], self._stops[0]
            if corners:
                if self._drive_to(corners[0], chassis, dt):
                    return held_up or self._progress(base)
                corners.popleft()
                self._turning = True
            elif self._turn_to(stop, base, dt):
                return held_up or self._progress(base)
            else:
                self._corners.popleft()
                self._stops.popleft()
        self._stops.append(self.goal)
        return Progress(done=True, text=f"arrived at {base.pose}")

    def _plan(self, chassis: Chassis, obstacles: tuple[Wall, ...] = ()) -> str:
        """Find the corners of the way, round `obstacles` too.

        Returns:
            Why there is none and what to do about it, empty if there is.
        """
        radius = outer_radius(FOOTPRINTS[chassis.footprint]) + MARGIN_M
        routes = planner(chassis.map, radius)
        here = chassis.base.pose.point
        legs: deque[deque[Point]] = deque()
        path = [chassis.base.pose]
        effort = Effort()
        for stop in self._stops:
            try:
                leg = (
                    [stop.point]
                    if self._strict
                    else routes.plan(here, stop.point, obstacles, effort)
                )
            except TooMuchEffortError:
                return (
                    f"the way to {stop} is too long or too winding to plan at once: choose a "
                    "nearer goal, or poses on the way that see one another"
                )
            if leg is None:
                return f"no free path to {stop}: choose a goal on free floor"
            for corner in leg:
                path.append(Pose(*corner, math.atan2(corner[1] - here[1], corner[0] - here[0])))
                here = corner
            legs.append(deque(leg))
        path[-1] = self.goal
        self.path = tuple(path)
        self._corners = legs
        self._turning = True
        return ""

    def _way_is_free(self, chassis: Chassis) -> bool:
        """Whether the base can go on to the next corner as far as it sees."""
        if self._turning or not self._corners or not self._corners[0]:
            return True
        return way_is_free(chassis, 0.0, chassis.base.pose.distance(self._corners[0][0]))

    def _deal_with_obstacle(self, chassis: Chassis) -> Progress:
        """Wait before an obstacle, find a way round it or give up, by the mode."""
        mode, base = self._mode.mode, chassis.base
        limit = float(self._mode.wait_timeout) or _PATIENCE_S
        text = f"an obstacle stands in the way at {base.pose}"
        if mode in _WAITING:
            return Progress(text=text, impeded=True)
        patience = limit
        if mode != navigation_pb2.kOvertime:
            wait = limit if mode == navigation_pb2.kTimeout else 0.0
            if self._waited > wait and not base.moving and self._detour(chassis):
                return self._progress(base)
            patience = wait + _PATIENCE_S
        if self._waited > patience:
            return failed(f"{text}: remove it or choose another goal")
        return Progress(text=text, impeded=True)

    def _detour(self, chassis: Chassis) -> bool:
        """Find a way round what stands there now; False if there is none."""
        obstacles = chassis.obstacles.walls
        if self._strict or obstacles == self._tried:
            return False
        self._tried = obstacles
        if self._plan(chassis, obstacles):
            return False
        chassis.codes.report(AVOIDED, _Level.kTips, self.kind)
        return True

    def _drive_to(self, corner: Point, chassis: Chassis, dt: float) -> bool:
        """Command the next piece of the way to `corner`; False when it is reached."""
        base = chassis.base
        distance, bearing = base.pose.distance(corner), base.pose.bearing(corner)
        if distance <= _NEAR_M:
            return False
        if self._turning:
            if abs(bearing) > _STRAIGHT_RAD:
                base.drive(
                    Velocity(turn=approach(bearing, TURN_SPEED_RADPS, ACCELERATION_RADPS2, dt))
                )
                return True
            self._turning = False
            chassis.codes.report(DRIVING_STRAIGHT, _Level.kTips, self.kind)
        ahead = distance * math.cos(bearing)
        if ahead <= _NEAR_M:
            return False
        base.drive(Velocity(approach(ahead, self._speed(), ACCELERATION_MPS2, dt)))
        return True

    def _turn_to(self, stop: Pose, base: Base, dt: float) -> bool:
        """Command the turn at `stop`; False when the base stands as it should."""
        last = len(self._stops) == 1
        if not (self._one_by_one or last) or (last and self._mode.type == navigation_pb2.kVague):
            return False
        error = wrap(stop.theta - base.pose.theta)
        if abs(error) <= _STRAIGHT_RAD:
            return False
        base.drive(Velocity(turn=approach(error, TURN_SPEED_RADPS, ACCELERATION_RADPS2, dt)))
        return True

    def _speed(self) -> float:
        return self._mode.max_speed or USUAL_SPEED_MPS

    def _progress(self, base: Base) -> Progress:
        return Progress(text=f"{base.pose.distance(self.goal.point):.2f} m from the goal")
