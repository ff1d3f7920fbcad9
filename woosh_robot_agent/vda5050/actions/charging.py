"""Actions that start and end charging."""

from __future__ import annotations

import math

from woosh_robot_agent import readiness
from woosh_robot_agent.pb.map import storage_edit_pb2
from woosh_robot_agent.pb.map.mark_pb2 import Storages
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ActionOrder, ExecTask
from woosh_robot_agent.pb.ros.action_pb2 import ChargeControl
from woosh_robot_agent.pb.util import action_pb2
from woosh_robot_agent.pb.util import task_pb2 as task
from woosh_robot_agent.vda5050.actions.errors import ActionFailedError
from woosh_robot_agent.vda5050.actions.performer import REACH, Context, PlainPerformer, Report
from woosh_robot_agent.vda5050.model.factsheet import STANDSTILL, ActionType, ParameterType, Scope
from woosh_robot_agent.vda5050.model.order import Action

_SCOPES = frozenset({Scope.INSTANT, Scope.NODE})
_STATION = "stationName"
_TIMEOUT = 30.0
"""Maximum time until the robot reports that it does not charge any more, in seconds."""


class StartCharging(PlainPerformer):
    """Docks at a charger and charges, by a task of the robot."""

    type = ActionType(
        "startCharging",
        _SCOPES,
        "dock at a charger and charge; the action ends when the battery is being charged",
        (
            ParameterType(
                _STATION,
                "STRING",
                f"number of the charger's mark, within {REACH:g} m; without it, the nearest one",
                True,
            ),
        ),
        blocking=STANDSTILL,
        pausable=True,
    )

    async def perform(self, action: Action, report: Report) -> str:
        context = self._context
        if _is_charging(context):
            return ""
        context.require_no_leg()
        mark = action.parameters.get(_STATION) or await self._nearest()
        context.require_near(mark)
        request = ExecTask(type=task.kCharge, mark_no=mark)
        await context.tasks.perform(request, report, lambda: _is_charging(context))
        return ""

    async def _nearest(self) -> str:
        """Return the number of the nearest charger.

        Raises:
            ActionFailedError: there is none within reach.
        """
        status = self._context.facts.status
        answer = await self._context.request(storage_edit_pb2.Storages())
        chargers = answer.body.chargers if isinstance(answer.body, Storages) else ()
        here = status.position if status is not None else None
        distances = []
        for charger in chargers:
            pose = charger.pose.dock if charger.pose.HasField("dock") else charger.pose.real
            if here is not None:
                distance = math.hypot(pose.x - here.x, pose.y - here.y)
                distances.append((distance, charger.identity.no))
        if not distances or min(distances)[0] > REACH:
            raise ActionFailedError(
                f"there is no charger within {REACH:g} m: drive to one, or name one as {_STATION}"
            )
        return min(distances)[1]


class StopCharging(PlainPerformer):
    """Ends charging: cancels the charging task, or backs out of the charger if it has ended."""

    type = ActionType(
        "stopCharging",
        _SCOPES,
        "end charging; the robot may back out of the charger",
        blocking=STANDSTILL,
        pausable=True,
    )

    async def perform(self, action: Action, report: Report) -> str:
        context = self._context
        info = context.facts.info
        if info is None:
            raise ActionFailedError("the robot has not reported its state yet")
        if info.task_proc.type == task.kCharge and readiness.is_running(info.task_proc):
            request = context.requests.address(ActionOrder(order=action_pb2.kCancel))
            answer = await context.gate.request(request)
            if not answer.ok:
                raise ActionFailedError(f"the robot refused to end its task: {answer.msg}")
        elif _is_charging(context):
            await context.calls.perform(ChargeControl(execute_mode=ChargeControl.kExit), report)
        if not await context.conditions.wait(lambda: not _is_charging(context), _TIMEOUT):
            raise ActionFailedError(f"the robot still charges after {_TIMEOUT:g} s")
        return ""


def _is_charging(context: Context) -> bool:
    status = context.facts.status
    return status is not None and status.battery.charging
