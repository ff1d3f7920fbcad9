"""Commands from the page to one robot, all through the gate for motion."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Mapping
from typing import Any

from woosh_robot_agent.link import LinkError
from woosh_robot_agent.motion import AnsweredCommand, MotionGate, VelocityDriver, VelocityLimits
from woosh_robot_agent.refusals import RefusalExplainer, type_of
from woosh_robot_agent.tools.dashboard.commands import CommandError, number, request_for
from woosh_robot_agent.tools.dashboard.robot import Robot
from woosh_robot_agent.tools.dashboard.viewer import Viewer

_STICK = "stick"
"""Name of the stream of velocities."""
STOP = "stop"
"""Name of the command that stops the robot, which every viewer may give."""
_STOP_TIMEOUT = 2.0
"""Timeout of each answer to a stop, in seconds."""
_CLOSE_TIMEOUT = 0.5
"""Timeout of the answer to the last zero velocity, in seconds."""
_IDLE_TIMEOUT = 60.0
"""Time without a command after which a viewer loses the control, in seconds."""
_STICK_TIMEOUT = 0.5
"""Time without a velocity from the page after which the robot is stopped, in seconds."""
_MAX_DELAY = 0.5
"""Delay on the way from the page from which a velocity is too old, in seconds."""
_MAX_PAGE_TIME = 1e13
"""Greatest time of a page's clock, in milliseconds."""
_CLOCK_DRIFT = 1e-3
"""Assumed drift between the clock of a page and this one, in seconds per second."""
_STICK_RATE = 20.0
"""Maximum rate of velocities that are sent to the robot, in Hz."""
_MAX_INPUT = 100.0
"""Greatest velocity in a message of the page, in m/s and rad/s; the limits scale it down."""


class Control:
    """Lets one viewer at a time command a robot.

    1. The first viewer to give a command gets the control. It keeps the control until it gives it
       back, hides the page, disconnects, watches another robot, or gives no command for a minute.
    2. The others are told who has the control. All of them may stop the robot.
    3. When a viewer loses the control, its stick stops the robot.
    4. The stick drives only while the page repeats the velocity; see `VelocityDriver`. A velocity
       that took long on its way is not sent: the connection was blocked, and the driver may have
       let go since.

    Args:
        robot: the robot.
        max_linear: maximum speed of the stick, in m/s.
        max_angular: maximum turning speed of the stick, in rad/s.
    """

    def __init__(self, robot: Robot, max_linear: float, max_angular: float) -> None:
        self._robot = robot
        self._gate = MotionGate(robot.chassis)
        self._limits = VelocityLimits(max_linear, max_angular, _STICK_RATE, _STICK_TIMEOUT)
        self._stick = _Stick(self._gate, robot, self._limits, self._stick_refused)
        self._gate.on_answered(self._answered)
        self._explainer = RefusalExplainer(robot.chassis, robot.view.values)
        self._owner: Viewer | None = None
        self._used_at = -math.inf
        """Loop time of the last command of the owner."""
        self._clock_offset = math.inf
        """Least difference between this clock and that of the owner's page so far, in seconds."""
        self._offset_at = -math.inf
        """Loop time at which `_clock_offset` was determined."""
        self._stick_task: asyncio.Task[None] | None = None
        robot.add_slow_part("control", self._data)

    def start(self) -> None:
        """Start sending the velocities of the stick."""
        self._stick_task = asyncio.get_running_loop().create_task(self._stick.run(), name="stick")

    async def close(self) -> str:
        """Stop the robot if the stick drives it, and refuse further motion.

        Returns:
            The reason why the robot may still be moving; empty if it was stopped.
        """
        if self._stick_task is not None:
            self._stick_task.cancel()
        try:
            await self._gate.close(_CLOSE_TIMEOUT)
        except LinkError as error:
            return str(error)
        return ""

    async def run(self, viewer: Viewer, name: str, args: Mapping[str, Any]) -> tuple[bool, str]:
        """Execute a command of a viewer; return its success and a text for the viewer."""
        if name == STOP:
            report = await self._gate.stop(_STOP_TIMEOUT)
            return report.success, report.message
        if reason := self._claim(viewer):
            return False, reason
        try:
            request = request_for(name, args, self._robot.view.info)
            answer = await self._gate.request(self._robot.requests.address(request))
        except (CommandError, LinkError) as error:
            return False, str(error)
        if answer.ok:
            return True, f"{name}: accepted"
        reason = await self._explainer.reason(type_of(request))
        return False, f"{name}: {answer.msg or 'refused'}{reason and f' ({reason})'}"

    def drive(self, viewer: Viewer, message: Mapping[str, Any]) -> None:
        """Process a velocity of a viewer's stick.

        Raises:
            CommandError: a value is not a valid number.
        """
        linear = number(message, "linear", _MAX_INPUT)
        angular = number(message, "angular", _MAX_INPUT)
        sent = number(message, "at", _MAX_PAGE_TIME) / 1000.0
        moves = bool(linear or angular)
        if not moves and viewer is not self._owner:
            return
        if reason := self._claim(viewer):
            viewer.note(part="stick", data=reason)
            return
        if moves and self._delay(sent) > _MAX_DELAY:
            viewer.note(part="stick", data="the connection is too slow to drive")
        elif moves and (owner := self._gate.owner):
            viewer.note(part="stick", data=f"{owner} is running: cancel it to drive by hand")
        else:
            self._stick.drive(linear, 0.0, angular)

    def release(self, viewer: Viewer) -> None:
        """Take the control from a viewer that has it, and stop what its stick drives."""
        if viewer is self._owner:
            self._stick.drive(0.0, 0.0, 0.0)
            self._owner = None
            self._clock_offset = math.inf
            self._robot.changed()

    def _release_idle(self) -> None:
        """Take the control from a viewer that has not used it for long."""
        if self._owner and asyncio.get_running_loop().time() > self._used_at + _IDLE_TIMEOUT:
            self.release(self._owner)

    def _claim(self, viewer: Viewer) -> str:
        """Give the control to a viewer; return the reason why not, or an empty text."""
        self._release_idle()
        if self._owner not in (None, viewer):
            return f"{self._owner.name} has control: wait until it is released"
        if not viewer.visible:
            return "the page is hidden"
        if self._owner is None:
            self._owner = viewer
            self._robot.changed()
        self._used_at = asyncio.get_running_loop().time()
        return ""

    def _delay(self, sent: float) -> float:
        """Return how much longer a message of the owner took than the quickest one, in seconds.

        Args:
            sent: time of the page's clock at which it was sent, in seconds.
        """
        now = asyncio.get_running_loop().time()
        if self._clock_offset < math.inf:
            self._clock_offset += _CLOCK_DRIFT * (now - self._offset_at)
        self._clock_offset = min(self._clock_offset, now - sent)
        self._offset_at = now
        return now - sent - self._clock_offset

    def _answered(self, command: AnsweredCommand) -> None:
        if command.source == _STICK and not command.answer.ok:
            self._stick_refused(command.answer.msg or "the robot refused the velocity")

    def _stick_refused(self, reason: str) -> None:
        if self._owner is not None:
            self._owner.note(part="stick", data=reason)

    def _data(self) -> dict[str, Any]:
        self._release_idle()
        limits = {"linear": self._limits.max_linear, "angular": self._limits.max_angular}
        return {"owner": self._owner.name if self._owner else None, "limits": limits}


class _Stick(VelocityDriver):
    """A stream of velocities that tells the viewer why it does not drive, instead of the log."""

    def __init__(
        self,
        gate: MotionGate,
        robot: Robot,
        limits: VelocityLimits,
        on_refused: Callable[[str], None],
    ) -> None:
        super().__init__(gate, robot.chassis, _STICK, lambda: limits, log_refusals=False)
        self._on_refused = on_refused

    def refuse(self, kind: str, reason: str) -> None:
        self._on_refused(reason)
