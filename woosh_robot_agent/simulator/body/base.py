"""The wheels: speeds become motion, within limits and not through walls."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from woosh_robot_agent.simulator.world.geometry import Pose, wrap

MAX_SPEED_MPS = 1.0
MAX_TURN_RADPS = 1.0
ACCELERATION_MPS2 = 1.0
ACCELERATION_RADPS2 = 2.0


@dataclass(frozen=True, slots=True)
class Velocity:
    """Speeds in the base's own frame.

    Attributes:
        forward: m/s.
        left: m/s, of a base that can move sideways.
        turn: rad/s, counter-clockwise.
    """

    forward: float = 0.0
    left: float = 0.0
    turn: float = 0.0

    @property
    def speed(self) -> float:
        """How fast the base moves along the floor, in m/s."""
        return math.hypot(self.forward, self.left)

    def limited(self) -> Velocity:
        """The same direction, no faster than the base can go."""
        scale = min(1.0, MAX_SPEED_MPS / self.speed) if self.speed else 1.0
        turn = min(MAX_TURN_RADPS, max(-MAX_TURN_RADPS, self.turn))
        return Velocity(self.forward * scale, self.left * scale, turn)


#: What rounding may leave of a speed, m/s or rad/s.
_DUST = 1e-7

STANDSTILL = Velocity()


class Base:
    """The driven base, integrated in time.

    Attributes:
        pose: Where it is in the map's frame, heading in (-pi, pi].
        odometry: Where its wheels say it is: never jumps, heading not wrapped.
        velocity: How it moves now.
        odometer: m driven since it was built.
        blocked: Something stopped it in the last step.
    """

    def __init__(self, pose: Pose, odometer: float) -> None:
        self.pose = pose
        self.odometry = Pose()
        self.velocity = STANDSTILL
        self.odometer = odometer
        self.blocked = False
        self._wanted = STANDSTILL

    @property
    def moving(self) -> bool:
        """Whether any speed is left."""
        return self.velocity != STANDSTILL

    def drive(self, velocity: Velocity) -> None:
        """Head for `velocity` during the next step; without this call the base slows down."""
        self._wanted = velocity.limited()

    def halt(self) -> None:
        """Stop at once."""
        self.velocity = self._wanted = STANDSTILL

    def place(self, pose: Pose) -> None:
        """Put the base somewhere else in the map, as localisation does."""
        self.pose = Pose(pose.x, pose.y, wrap(pose.theta))

    def tick(self, dt: float, gap: Callable[[Pose], float]) -> None:
        """Move for `dt` seconds.

        A move that would run the outline into something is not made. A base that is in something
        already, because it was placed there or the thing was, can move out of it.

        Args:
            dt: s.
            gap: How far in m the base's outline at a pose is from touching anything; negative if
                something is inside of it.
        """
        self.velocity = _accelerated(self.velocity, self._wanted, dt)
        self._wanted = STANDSTILL
        self.blocked = False
        if not self.moving:
            return
        # Where it cannot drive on, it may still turn.
        for velocity in (self.velocity, Velocity(turn=self.velocity.turn), STANDSTILL):
            moved = _displacement(velocity, dt)
            goal = self.pose.moved(*moved)
            if velocity == STANDSTILL or (there := gap(goal)) >= 0.0:
                break
            if there >= gap(self.pose) - _DUST:  # on its way out
                break
            self.blocked = True
        self.velocity = velocity
        self.place(goal)
        self.odometry = self.odometry.moved(*moved)
        self.odometer += velocity.speed * dt


def approach(distance: float, fastest: float, acceleration: float, dt: float) -> float:
    """The speed for the next step at which a stop after exactly `distance` stays possible.

    Linear or angular alike; the sign is that of `distance`.
    """
    far = abs(distance)
    if far <= acceleration * dt * dt:
        speed = far / dt
    else:
        speed = acceleration * (math.sqrt(dt * dt + 2.0 * far / acceleration) - dt)
    return math.copysign(min(speed, fastest), distance)


def _accelerated(now: Velocity, wanted: Velocity, dt: float) -> Velocity:
    forward, left = wanted.forward - now.forward, wanted.left - now.left
    change, limit = math.hypot(forward, left), ACCELERATION_MPS2 * dt
    share = limit / change if change > limit + _DUST else 1.0
    turn_limit = ACCELERATION_RADPS2 * dt
    turn = min(turn_limit, max(-turn_limit, wanted.turn - now.turn))
    return Velocity(
        now.forward + share * forward if share < 1.0 else wanted.forward,
        now.left + share * left if share < 1.0 else wanted.left,
        wanted.turn if abs(wanted.turn - now.turn) <= turn_limit + _DUST else now.turn + turn,
    )


def _displacement(velocity: Velocity, dt: float) -> tuple[float, float, float]:
    """The displacement in the frame of the start, on an exact arc."""
    turn = velocity.turn * dt
    if abs(turn) < 1e-9:
        return velocity.forward * dt, velocity.left * dt, turn
    ahead, aside = math.sin(turn) / velocity.turn, (1.0 - math.cos(turn)) / velocity.turn
    return (
        velocity.forward * ahead - velocity.left * aside,
        velocity.forward * aside + velocity.left * ahead,
        turn,
    )
