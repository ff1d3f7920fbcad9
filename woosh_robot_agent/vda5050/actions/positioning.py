"""Actions that tell the robot where it stands."""

from __future__ import annotations

from woosh_robot_agent.pb.robot.robot_pack_pb2 import InitRobot
from woosh_robot_agent.pb.util.common_pb2 import Pose2D
from woosh_robot_agent.vda5050.actions.errors import ActionFailedError
from woosh_robot_agent.vda5050.actions.map_actions import switch_map
from woosh_robot_agent.vda5050.actions.performer import PlainPerformer, Report
from woosh_robot_agent.vda5050.model.factsheet import STANDSTILL, ActionType, ParameterType, Scope
from woosh_robot_agent.vda5050.model.order import Action
from woosh_robot_agent.vda5050.model.state import Position

_TIMEOUT = 10.0
"""Maximum time until the robot reports the new position after it has accepted it, in seconds."""


def _type(name: str) -> ActionType:
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

    type = _type("initPosition")

    async def perform(self, action: Action, report: Report) -> str:
        context, given = self._context, action.parameters
        context.require_no_leg()
        await switch_map(context, given["mapId"])
        pose = Pose2D(x=given["x"], y=given["y"], theta=given["theta"])
        await context.request(InitRobot(pose=pose))
        if not await context.conditions.wait(lambda: self._is_on(given["mapId"]), _TIMEOUT):
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

    type = _type("initializePosition")
