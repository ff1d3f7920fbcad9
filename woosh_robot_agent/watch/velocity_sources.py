"""Detection of several sources that command velocities at the same time.

Each source overrides the velocity of the other, so the robot stops and goes.
"""

from __future__ import annotations

import logging
import math
import time

from woosh_robot_agent.link import ChassisClient
from woosh_robot_agent.link.log_once import LogOnce
from woosh_robot_agent.motion import AnsweredCommand, MotionGate
from woosh_robot_agent.motion.requests import may_move
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Twist
from woosh_robot_agent.watch.interleaving import Interleaving

_LOG = logging.getLogger(__name__)

OVERLAP = 1.0
"""Time within which the velocities of two sources count as simultaneous, in seconds."""
SHOWN = 5.0
"""Time for which simultaneous sources are reported, in seconds."""


class VelocitySources:
    """Observes the velocities that pass the motion gate. Used in the event loop of the link.

    A source drives from its first velocity until it sends a zero, or nothing for `OVERLAP`.

    Args:
        chassis: the link.
        gate: the gate.

    Attributes:
        last: source of the last velocity, zero included; empty before the first.
        last_time: monotonic time of that velocity.
    """

    def __init__(self, chassis: ChassisClient, gate: MotionGate) -> None:
        self.last = ""
        self.last_time = -math.inf
        self._driving: dict[str, float] = {}
        """Monotonic time of the last velocity of each driving source, by name."""
        self._simultaneous: tuple[str, ...] = ()
        """The simultaneous sources that were last reported."""
        self._simultaneous_until = -math.inf
        """Monotonic time until which `simultaneous` returns them."""
        self._log = LogOnce(_LOG)
        self._callers = Interleaving()
        """Detects several clients of the service of velocities."""
        chassis.on_robot_changed(self._forget)
        gate.on_answered(self._answered)

    @property
    def simultaneous(self) -> tuple[str, ...]:
        """Names of the sources that recently commanded velocities at the same time; or empty."""
        return self._simultaneous if time.monotonic() < self._simultaneous_until else ()

    def driving(self, now: float) -> bool:
        """Return True if a velocity that is not zero was sent less than `OVERLAP` ago."""
        return any(now - sent < OVERLAP for sent in self._driving.values())

    def report(self, *sources: str) -> None:
        """Report sources that command velocities at the same time."""
        if not self.simultaneous:
            self._log.clear()
        self._simultaneous = tuple(sorted(sources))
        self._simultaneous_until = time.monotonic() + SHOWN
        self._log.warn(str(self._simultaneous), warning(self._simultaneous))

    def called(self, service: str, number: int) -> None:
        """Process a call of the service of velocities that may move the robot.

        Args:
            service: name of the service.
            number: number of the call, counted by its client.
        """
        if self._callers.notice(number, time.monotonic()):
            self.report(f"a client of {service}", f"another client of {service}")

    def _forget(self) -> None:
        self.last, self.last_time = "", -math.inf
        self._driving.clear()
        self._simultaneous, self._simultaneous_until = (), -math.inf
        self._log.clear()

    def _answered(self, command: AnsweredCommand) -> None:
        source = command.source
        # the agent itself, which has no name, only sends a zero when it closes
        if not isinstance(command.message, Twist) or not command.answer.ok or not source:
            return
        now = time.monotonic()
        self.last, self.last_time = source, now
        others = [name for name, sent in self._driving.items() if name != source]
        for name in others:
            if now - self._driving[name] < OVERLAP:
                self.report(source, name)
            else:
                del self._driving[name]
        if may_move(command.message):
            self._driving[source] = now
        else:
            self._driving.pop(source, None)


def warning(sources: tuple[str, ...]) -> str:
    """Return the warning about simultaneous sources of velocities."""
    return (
        f"{' and '.join(sources)} command velocities at the same time, so the robot stops and "
        "goes: stop all of them but one, or merge them (e.g. with twist_mux)"
    )
