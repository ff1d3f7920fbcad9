"""The driven base: integrates its velocity, within limits and without passing through walls."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from woosh_robot_agent.simulator.world.geometry import Pose, wrap

ACCELERATION = 1.0
"""Maximum acceleration, in m/s²."""

ANGULAR_ACCELERATION = 2.0
"""Maximum angular acceleration, in rad/s²."""

_TOLERANCE = 1e-7
"""Maximum rounding error of a velocity or of a gap, in m/s, rad/s or m."""


@dataclass(frozen=True, slots=True)
class Velocity:
    """A velocity in the frame of the base.

    Attributes:
        forward: forward speed, in m/s.
        left: sideways speed of an omnidirectional base, in m/s.
        turn: turn rate, counter-clockwise, in rad/s.
    """

    forward: float = 0.0
    left: float = 0.0
    turn: float = 0.0

    @property
    def speed(self) -> float:
        """Speed along the floor, in m/s."""
        return math.hypot(self.forward, self.left)

    def limited(self, max_speed: float, max_turn_rate: float) -> Velocity:
        """Return this velocity, scaled to limits in m/s and rad/s."""
        scale = min(1.0, max_speed / self.speed) if self.speed else 1.0
        turn = min(max_turn_rate, max(-max_turn_rate, self.turn))
        return Velocity(self.forward * scale, self.left * scale, turn)


STANDSTILL = Velocity()


class Base:
    """The driven base.

    Args:
        pose: pose at the start.
        odometer: total distance driven so far, in metres.
        rolls_for: time constant of the exponential slowdown after remote control, in seconds; 0
            to slow down at a constant rate.
        stops_below: speed at which the exponential slowdown ends, in m/s or rad/s.
        max_speed: maximum speed, in m/s.
        max_turn_rate: maximum turn rate, in rad/s.

    Attributes:
        pose: pose in the map's frame, with a heading in (-pi, pi].
        odometry: pose by wheel odometry, which never jumps. Its heading is not wrapped.
        velocity: current velocity.
        odometer: total distance driven, in metres.
        max_speed: maximum speed, in m/s.
        max_turn_rate: maximum turn rate, in rad/s.
        blocked: True if a collision stopped the base in the last step.
    """

    def __init__(
        self,
        pose: Pose,
        *,
        odometer: float,
        rolls_for: float = 0.0,
        stops_below: float = 0.0,
        max_speed: float,
        max_turn_rate: float,
    ) -> None:
        self.pose = pose
        self.odometry = Pose()
        self.velocity = STANDSTILL
        self.odometer = odometer
        self.blocked = False
        self.max_speed = max_speed
        self.max_turn_rate = max_turn_rate
        self._rolls_for = rolls_for
        self._stops_below = stops_below
        self._rolls_on = False
        """True if the base slows down exponentially when it is not driven."""
        self._wanted = STANDSTILL
        """Velocity that `drive` has requested for the next step."""

    @property
    def moving(self) -> bool:
        """True if the velocity is not zero."""
        return self.velocity != STANDSTILL

    def drive(self, velocity: Velocity, *, rolls_on: bool = False) -> None:
        """Accelerate towards `velocity` in the next step. Without this call the base slows down.

        Args:
            velocity: wanted velocity.
            rolls_on: True to slow down exponentially afterwards, as after remote control; False to
                slow down at a constant rate.
        """
        self._wanted = velocity.limited(self.max_speed, self.max_turn_rate)
        self._rolls_on = rolls_on

    def halt(self) -> None:
        """Stop at once."""
        self.velocity = self._wanted = STANDSTILL

    def brake(self) -> None:
        """Stop as robots do after a velocity of zero: at once, or by an exponential slowdown."""
        if self._rolls_for:
            # One more step at this velocity; then the exponential slowdown begins.
            self.drive(self.velocity, rolls_on=True)
        else:
            self.halt()

    def place(self, pose: Pose) -> None:
        """Set the pose in the map, as localisation does. The odometry does not change."""
        self.pose = Pose(pose.x, pose.y, wrap(pose.theta))

    def tick(self, dt: float, gap: Callable[[Pose], float]) -> None:
        """Move for `dt` seconds.

        A move that would cause a collision is not made. A base that already overlaps an obstacle,
        because the base or the obstacle was placed there, can move out of it.

        Args:
            dt: duration of the step, in seconds.
            gap: returns the gap in metres between the base at a pose and its surroundings.
        """
        wanted = self._wanted if self._wanted != STANDSTILL else self._slowed(dt)
        self.velocity = _accelerated(self.velocity, wanted, dt)
        self._wanted = STANDSTILL
        self.blocked = False
        if not self.moving:
            return

        def is_free(pose: Pose) -> bool:
            there = gap(pose)
            # A base on its way out of a collision still overlaps, but less than before.
            return there >= 0.0 or there >= gap(self.pose) - _TOLERANCE

        # A base that cannot drive on may still be able to turn.
        for velocity in (self.velocity, Velocity(turn=self.velocity.turn), STANDSTILL):
            moved = displacement(velocity, dt)
            goal = self.pose.moved(*moved)
            if velocity == STANDSTILL or is_free(goal):
                break
            self.blocked = True
        self.velocity = velocity
        self.place(goal)
        self.odometry = self.odometry.moved(*moved)
        self.odometer += velocity.speed * dt

    def _slowed(self, dt: float) -> Velocity:
        """Return the wanted velocity of a base that is not driven: slower, or zero."""
        now = self.velocity
        is_fast = max(now.speed, abs(now.turn)) > self._stops_below
        if self._rolls_on and self._rolls_for and is_fast:
            share = math.exp(-dt / self._rolls_for)
            return Velocity(share * now.forward, share * now.left, share * now.turn)
        return STANDSTILL


def approach(distance: float, fastest: float, acceleration: float, dt: float) -> float:
    """Return the speed for the next step that still permits a stop after exactly `distance`.

    Args:
        distance: remaining distance or angle. The speed has its sign.
        fastest: maximum speed.
        acceleration: maximum deceleration.
        dt: duration of the step, in seconds.
    """
    far = abs(distance)
    if far <= acceleration * dt * dt:
        speed = far / dt  # arrives with this step, slow enough to stop in the next one
    else:
        # Solves far = speed * dt + speed**2 / (2 * acceleration): this step, then the braking.
        speed = acceleration * (math.sqrt(dt * dt + 2.0 * far / acceleration) - dt)
    return math.copysign(min(speed, fastest), distance)


def _accelerated(now: Velocity, wanted: Velocity, dt: float) -> Velocity:
    """Return the velocity after accelerating towards `wanted` for `dt` seconds."""
    forward, left = wanted.forward - now.forward, wanted.left - now.left
    change, limit = math.hypot(forward, left), ACCELERATION * dt
    share = limit / change if change > limit + _TOLERANCE else 1.0
    turn_limit = ANGULAR_ACCELERATION * dt
    turn = min(turn_limit, max(-turn_limit, wanted.turn - now.turn))
    # A wanted value within the limit is reached exactly, without a rounding error.
    return Velocity(
        now.forward + share * forward if share < 1.0 else wanted.forward,
        now.left + share * left if share < 1.0 else wanted.left,
        wanted.turn if abs(wanted.turn - now.turn) <= turn_limit + _TOLERANCE else now.turn + turn,
    )


def displacement(velocity: Velocity, dt: float) -> tuple[float, float, float]:
    """Return the motion in `dt` seconds along an exact arc: forward, left and turn.

    It is a displacement in the frame of the pose at its start, as for `Pose.moved`.
    """
    turn = velocity.turn * dt
    if abs(turn) < 1e-9:
        return velocity.forward * dt, velocity.left * dt, turn
    ahead, aside = math.sin(turn) / velocity.turn, (1.0 - math.cos(turn)) / velocity.turn
    return (
        velocity.forward * ahead - velocity.left * aside,
        velocity.forward * aside + velocity.left * ahead,
        turn,
    )
