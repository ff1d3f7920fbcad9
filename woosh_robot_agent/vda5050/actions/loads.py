"""Actions that take up and put down a load with the lift."""

from __future__ import annotations

from woosh_robot_agent.pb.robot.robot_pack_pb2 import ExecTask
from woosh_robot_agent.pb.ros.action_pb2 import LiftControl
from woosh_robot_agent.pb.util import task_pb2 as task
from woosh_robot_agent.vda5050.actions.errors import Objection
from woosh_robot_agent.vda5050.actions.performer import REACH, Context, Report
from woosh_robot_agent.vda5050.model.factsheet import (
    STANDSTILL,
    ActionType,
    ParameterType,
    Scope,
)
from woosh_robot_agent.vda5050.model.order import Action

_STATION = "stationName"
_PARAMETERS = (
    ParameterType(
        _STATION,
        "STRING",
        f"number of the mark at which the robot docks, at most {REACH:g} m away; without it, the "
        "lift moves where the robot stands",
        True,
    ),
    ParameterType("stationType", "STRING", "accepted, but not used", True),
    ParameterType("loadType", "STRING", "accepted, but not used", True),
    ParameterType("loadId", "STRING", "accepted, but not used", True),
)


def _type(name: str, description: str) -> ActionType:
    return ActionType(
        name,
        frozenset({Scope.NODE}),
        description,
        _PARAMETERS,
        blocking=STANDSTILL,
        pausable=True,
    )


class _Carry:
    """Moves the lift to one end.

    Args:
        context: objects that all actions share.
        kind: name and parameters of the action.
        lift: end of the lift.
        direction: direction of the task at a mark.
    """

    def __init__(
        self,
        context: Context,
        kind: ActionType,
        lift: LiftControl.ExecuteMode,
        direction: task.Direction,
    ) -> None:
        self.type = kind
        self._context = context
        self._lift = lift
        self._direction = direction

    def check(self, action: Action) -> Objection | None:
        return None

    async def perform(self, action: Action, report: Report) -> str:
        context = self._context
        if _STATION not in action.parameters:
            return await context.calls.perform(LiftControl(execute_mode=self._lift), report)
        context.require_no_leg()
        context.require_near(action.parameters[_STATION])
        request = ExecTask(
            type=task.kCarry, direction=self._direction, mark_no=action.parameters[_STATION]
        )
        await context.tasks.perform(request, report)
        return ""


class Pick(_Carry):
    """Takes up a load."""

    def __init__(self, context: Context) -> None:
        super().__init__(
            context,
            _type("pick", "take up a load by raising the lift"),
            LiftControl.kUp,
            task.kFeeding,
        )


class Drop(_Carry):
    """Puts down a load."""

    def __init__(self, context: Context) -> None:
        super().__init__(
            context,
            _type("drop", "put down the load by lowering the lift"),
            LiftControl.kDown,
            task.kCutting,
        )
