"""Actions that pause and resume the vehicle."""

from __future__ import annotations

from woosh_robot_agent.vda5050.actions.errors import ActionFailedError
from woosh_robot_agent.vda5050.actions.performer import PlainPerformer, Report
from woosh_robot_agent.vda5050.model.factsheet import ActionType, Scope
from woosh_robot_agent.vda5050.model.order import Action

TIMEOUT = 10.0
"""Maximum time until the robot has paused or resumed everything, in seconds."""


class StartPause(PlainPerformer):
    """Pauses the drive and the actions that move something."""

    type = ActionType(
        "startPause",
        frozenset({Scope.INSTANT}),
        "stop, and pause the order and its actions",
        repeatable=True,
    )

    async def perform(self, action: Action, report: Report) -> str:
        pause, vehicle = self._context.pause, self._context.vehicle
        pause.set(True)
        if not await self._context.conditions.wait(
            lambda: (vehicle.paused and vehicle.at_rest) or not pause.wanted, TIMEOUT
        ):
            # the robot must not drive on because it was slow to obey, so the pause stays wanted
            raise ActionFailedError(
                f"the robot did not pause and stop within {TIMEOUT:g} s; it is told again until it "
                "does, or until a stopPause"
            )
        if not pause.wanted:
            raise ActionFailedError("a stopPause arrived in the meantime")
        return ""


class StopPause(PlainPerformer):
    """Resumes the drive and the paused actions, also if a button on the robot has paused them."""

    type = ActionType(
        "stopPause",
        frozenset({Scope.INSTANT}),
        "resume the order and its actions",
        repeatable=True,
    )

    async def perform(self, action: Action, report: Report) -> str:
        pause, vehicle = self._context.pause, self._context.vehicle
        if pause.wanted:
            pause.set(False)
        elif vehicle.paused:
            vehicle.resume()
        if not await self._context.conditions.wait(
            lambda: not vehicle.paused or pause.wanted, TIMEOUT
        ):
            raise ActionFailedError(f"the robot did not resume within {TIMEOUT:g} s")
        if pause.wanted:
            raise ActionFailedError("a startPause arrived in the meantime")
        return ""
