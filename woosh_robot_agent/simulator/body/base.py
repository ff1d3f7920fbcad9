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
"""Rounding error that is ignored, of a velocity in m/s or rad/s, or of a gap in metres."""


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
        """Return this velocity within limits of speed in m/s and turn rate in rad/s.

        The direction of the motion stays.
        """
        scale = min(1.0, max_speed / self.speed) if self.speed else 1.0
        turn = min(max_turn_rate, max(-max_turn_rate, self.turn))
        return Velocity(self.forward * scale, self.left * scale, turn)


STANDSTILL = Velocity()


class Base:
    """The driven base.

    Args:
        rolls_for: time constant of the exponential slowdown after remote control, in seconds; 0
            to slow down at a constant rate.
        stops_below: speed and turn rate at which the exponential slowdown ends, in m/s and rad/s.

    Attributes:
        pose: pose in the map's frame, with a heading in (-pi, pi].
        odometry: pose by wheel odometry, relative to the start. It never jumps, and its heading is
            not wrapped.
        odometer: total distance driven, in metres.
        max_speed: maximum speed, in m/s.
        max_turn_rate: maximum turn rate, in rad/s.
        blocked: True if the base did not make its last move, or only turned, to avoid a collision.
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
        """Velocity that `drive` has requested for the next step; zero without a request."""
        self._braking = False
        """True from the first `brake` until the base is driven again."""

    @property
    def moving(self) -> bool:
        """True if the velocity is not zero."""
        return self.velocity != STANDSTILL

    def drive(self, velocity: Velocity, *, rolls_on: bool = False) -> None:
        """Accelerate towards `velocity` in the next step. Without this call the base slows down.

        Args:
            velocity: wanted velocity, which is limited to the maximum of the base.
            rolls_on: True to slow down exponentially afterwards, as after remote control; False to
                slow down at a constant rate.
        """
        self._wanted = velocity.limited(self.max_speed, self.max_turn_rate)
        self._rolls_on = rolls_on
        self._braking = False

    def halt(self) -> None:
        """Stop at once."""
        self.velocity = self._wanted = STANDSTILL

    def brake(self) -> None:
        """Stop as robots do after a velocity of zero: at once, or by an exponential slowdown."""
        if not self._rolls_for:
            self.halt()
        elif not self._braking:
            # One more step at this velocity; only then does the exponential slowdown begin.
            self.drive(self.velocity, rolls_on=True)
            self._braking = True

    def place(self, pose: Pose) -> None:
        """Set the pose in the map, as localisation does. The odometry does not change."""
        self.pose = Pose(pose.x, pose.y, wrap(pose.theta))

    def tick(self, dt: float, gap: Callable[[Pose], float]) -> None:
        """Move for `dt` seconds.

        A move that would cause a collision is not made. A base that already overlaps an obstacle,
        because the base or the obstacle was placed there, can move out of it.

        Args:
            gap: returns the gap in metres between the base at a pose and its surroundings; it is
                negative if they overlap.
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
        """Return the velocity to aim at in the next `dt` seconds if nothing drives the base."""
        now = self.velocity
        is_fast = max(now.speed, abs(now.turn)) > self._stops_below
        if self._rolls_on and self._rolls_for and is_fast:
            share = math.exp(-dt / self._rolls_for)
            return Velocity(share * now.forward, share * now.left, share * now.turn)
        return STANDSTILL


def approach(distance: float, fastest: float, acceleration: float, dt: float) -> float:
    """Return the speed for the next step that still permits a stop after exactly `distance`.

    Args:
        distance: remaining distance in metres, or angle in radians. The speed has its sign.
        fastest: maximum speed, in m/s or rad/s.
        acceleration: maximum deceleration, in m/s² or rad/s².
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
    # A wanted value within the limits is reached exactly, without a rounding error.
    forward, left, turn = wanted.forward, wanted.left, wanted.turn
    change = math.hypot(forward - now.forward, left - now.left)
    limit = ACCELERATION * dt
    if change > limit + _TOLERANCE:
        share = limit / change
        forward = now.forward + share * (forward - now.forward)
        left = now.left + share * (left - now.left)
    turn_limit = ANGULAR_ACCELERATION * dt
    if abs(turn - now.turn) > turn_limit + _TOLERANCE:
        turn = now.turn + math.copysign(turn_limit, turn - now.turn)
    return Velocity(forward, left, turn)


def displacement(velocity: Velocity, dt: float) -> tuple[float, float, float]:
    """Return the motion in `dt` seconds along an exact arc, as arguments of `Pose.moved`."""
    turn = velocity.turn * dt
    if abs(turn) < 1e-9:
        return velocity.forward * dt, velocity.left * dt, turn
    ahead, aside = math.sin(turn) / velocity.turn, (1.0 - math.cos(turn)) / velocity.turn
    return (
        velocity.forward * ahead - velocity.left * aside,
        velocity.forward * aside + velocity.left * ahead,
        turn,
    )
