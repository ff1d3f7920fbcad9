"""The other actions: charging, loads, pause, position, requests of the state, and log reports."""

from __future__ import annotations

import asyncio
import json
import math
import time
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from google.protobuf.json_format import MessageToDict
from google.protobuf.message import Message

from woosh_robot_agent.link import LinkError
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.motion.wheel_owner import is_running
from woosh_robot_agent.pb.map import storage_edit_pb2
from woosh_robot_agent.pb.map.mark_pb2 import Storages
from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCodes
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ActionOrder, ExecTask, InitRobot
from woosh_robot_agent.pb.robot.robot_pb2 import TaskHistory
from woosh_robot_agent.pb.ros.action_pb2 import ChargeControl, LiftControl
from woosh_robot_agent.pb.util import action_pb2
from woosh_robot_agent.pb.util import task_pb2 as task
from woosh_robot_agent.pb.util.common_pb2 import Pose2D
from woosh_robot_agent.vda5050.actions.map_actions import switch_map
from woosh_robot_agent.vda5050.actions.performer import REACH, Context, PlainPerformer, Report
from woosh_robot_agent.vda5050.actions.robot_calls import ActionFailedError, Objection
from woosh_robot_agent.vda5050.messages.factsheet import (
    STANDSTILL,
    ActionType,
    ParameterType,
    Scope,
)
from woosh_robot_agent.vda5050.messages.order import Action
from woosh_robot_agent.vda5050.messages.state import Position

_SCOPES = frozenset({Scope.INSTANT, Scope.NODE})
_STATION = "stationName"
_CHARGE_TIMEOUT = 30.0
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
        if info.task_proc.type == task.kCharge and is_running(info.task_proc):
            request = context.requests.address(ActionOrder(order=action_pb2.kCancel))
            answer = await context.gate.request(request)
            if not answer.ok:
                raise ActionFailedError(f"the robot refused to end its task: {answer.msg}")
        elif _is_charging(context):
            await context.calls.perform(ChargeControl(execute_mode=ChargeControl.kExit), report)
        if not await context.conditions.wait(lambda: not _is_charging(context), _CHARGE_TIMEOUT):
            raise ActionFailedError(f"the robot still charges after {_CHARGE_TIMEOUT:g} s")
        return ""


def _is_charging(context: Context) -> bool:
    status = context.facts.status
    return status is not None and status.battery.charging


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


def _load_action(name: str, description: str) -> ActionType:
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
            _load_action("pick", "take up a load by raising the lift"),
            LiftControl.kUp,
            task.kFeeding,
        )


class Drop(_Carry):
    """Puts down a load."""

    def __init__(self, context: Context) -> None:
        super().__init__(
            context,
            _load_action("drop", "put down the load by lowering the lift"),
            LiftControl.kDown,
            task.kCutting,
        )


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


_POSITION_TIMEOUT = 10.0
"""Maximum time until the robot reports the new position after it has accepted it, in seconds."""


def _position_action(name: str) -> ActionType:
    return ActionType(
        name,
        frozenset({Scope.INSTANT, Scope.NODE}),
        "set the map and the position of the vehicle",
        (
            ParameterType("x", "FLOAT", "position in the map, in m"),
            ParameterType("y", "FLOAT", "position in the map, in m"),
            ParameterType("theta", "FLOAT", "heading, in rad"),
            ParameterType("mapId", "STRING", "name of the map"),
            ParameterType("lastNodeId", "STRING", "node on which the vehicle stands", True),
        ),
        blocking=STANDSTILL,
    )


class InitPosition(PlainPerformer):
    """Initialises the robot at a pose; changes the map first if necessary."""

    type = _position_action("initPosition")

    async def perform(self, action: Action, report: Report) -> str:
        context, given = self._context, action.parameters
        context.require_no_leg()
        await switch_map(context, given["mapId"])
        pose = Pose2D(x=given["x"], y=given["y"], theta=given["theta"])
        await context.request(InitRobot(pose=pose))
        if not await context.conditions.wait(
            lambda: self._is_on(given["mapId"]), _POSITION_TIMEOUT
        ):
            raise ActionFailedError("the robot has not found its position: see its errors")
        if "lastNodeId" in given:
            context.vehicle.set_last_node(given["lastNodeId"])
        return ""

    def _is_on(self, map_id: str) -> bool:
        status = self._context.facts.status
        position: Position | None = status.position if status is not None else None
        return position is not None and position.initialised and position.map_id == map_id


class InitializePosition(InitPosition):
    """Initialises the robot, under the name of version 3 of the standard."""

    type = _position_action("initializePosition")


_INSTANT = frozenset({Scope.INSTANT})


class StateRequest(PlainPerformer):
    """Publishes the state."""

    type = ActionType("stateRequest", _INSTANT, "publish the state", repeatable=True)

    async def perform(self, action: Action, report: Report) -> str:
        self._context.vehicle.publish_state()
        return ""


class FactsheetRequest(PlainPerformer):
    """Publishes the factsheet."""

    type = ActionType("factsheetRequest", _INSTANT, "publish the factsheet", repeatable=True)

    async def perform(self, action: Action, report: Report) -> str:
        self._context.vehicle.publish_factsheet()
        return ""


class CancelOrder(PlainPerformer):
    """Cancels the order."""

    type = ActionType(
        "cancelOrder",
        _INSTANT,
        "stop, and cancel the order",
        (ParameterType("orderId", "STRING", "order to cancel; any order if missing", True),),
        repeatable=True,
    )

    async def perform(self, action: Action, report: Report) -> str:
        await self._context.vehicle.cancel_order(action.parameters.get("orderId", ""))
        return ""


class ClearInstantActions(PlainPerformer):
    """Forgets the instant actions that have ended."""

    type = ActionType(
        "clearInstantActions",
        frozenset({Scope.INSTANT, Scope.NODE}),
        "remove the instant actions that have ended from the state",
        repeatable=True,
    )

    async def perform(self, action: Action, report: Report) -> str:
        self._context.vehicle.clear_instant_actions()
        return ""


_MAX_REPORTS = 100
"""Maximum number of reports of a robot; the oldest ones are deleted."""
_PREFIX = "log_report_"


class LogReport(PlainPerformer):
    """Stores what the robot reports, its last tasks and its last status codes as a JSON file.

    Args:
        context: objects that all actions share.
        folder: folder of the reports, with a subfolder for each robot.
    """

    type = ActionType(
        "logReport",
        frozenset({Scope.INSTANT}),
        "store the state of the robot, its last tasks and status codes in a file",
        (ParameterType("reason", "STRING", "reason, which the report repeats"),),
        "path of the file in the folder of the reports",
        repeatable=True,
    )

    def __init__(self, context: Context, folder: Path) -> None:
        super().__init__(context)
        self._folder = folder

    async def perform(self, action: Action, report: Report) -> str:
        requests, info = self._context.requests, self._context.facts.info
        if info is None:
            raise ActionFailedError("the robot has not reported its state yet")
        now = datetime.fromtimestamp(time.time(), timezone.utc)
        content = {
            "time": now.isoformat(),
            "reason": action.parameters["reason"],
            "robot": _as_dict(info),
            "taskHistory": await self._asked(requests.empty(TaskHistory)),
            "statusCodes": await self._asked(requests.empty(StatusCodes)),
        }
        folder = self._folder / str(info.genral.serial_number or info.robot_id)
        path = folder / f"{_PREFIX}{now:%Y%m%dT%H%M%S_%f}.json"
        try:
            await asyncio.to_thread(_store, path, json.dumps(content, indent=1, ensure_ascii=False))
        except OSError as error:
            raise ActionFailedError(f"the report cannot be stored: {error}") from None
        return str(path.relative_to(self._folder))

    async def _asked(self, query: Message) -> dict[str, Any] | str:
        """Return what the robot answers, or the reason why it does not."""
        try:
            answer = await self._context.chassis.request(query)
        except LinkError as error:
            return str(error)
        if not answer.ok or answer.body is None:
            return f"the robot refused {full_name(query)}: {answer.msg or answer.defect}"
        return _as_dict(answer.body)


def _as_dict(message: Message) -> dict[str, Any]:
    return MessageToDict(message, preserving_proto_field_name=True)


def _store(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, "utf-8")
    for old in sorted(path.parent.glob(f"{_PREFIX}*.json"))[:-_MAX_REPORTS]:
        old.unlink(missing_ok=True)
