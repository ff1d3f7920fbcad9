"""The factsheet of a vehicle from the reports of its robot."""

from __future__ import annotations

from dataclasses import dataclass

from woosh_robot_agent.pb.robot.robot_pb2 import General, RobotInfo
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.vda5050.model.factsheet import (
    ActionType,
    Factsheet,
    Kinematics,
    OptionalParameter,
    VehicleClass,
)
from woosh_robot_agent.vda5050.robot.status import points

_MM = 0.001
"""Metres in a millimetre."""
_CLASSES = {
    robot.kTractorRobot_500: VehicleClass.TUGGER,
    robot.kRollerRobot_500: VehicleClass.CONVEYOR,
}
"""Classes of robots, by type; all others are carriers."""
_DIFFERENTIAL = 0
"""Value of `General.driver_method` for a differential drive."""
OPTIONAL_PARAMETERS = (
    OptionalParameter("order.nodes.nodePosition", description="or nodeId is the number of a mark"),
    OptionalParameter("order.nodes.nodePosition.theta"),
    OptionalParameter("order.nodes.nodePosition.allowedDeviationXY"),
    OptionalParameter("order.nodes.nodePosition.allowedDeviationTheta"),
    OptionalParameter("order.edges.maxSpeed"),
    OptionalParameter("order.edges.orientation", description="only TANGENTIAL 0: forwards"),
    OptionalParameter("order.edges.rotationAllowed", description="only true"),
    OptionalParameter("order.edges.trajectory", description="also several edges without a stop"),
)
"""Optional fields of the standard that the connector obeys."""


@dataclass(frozen=True)
class Limits:
    """Limits of the robot that it does not report, and options of the state.

    Attributes:
        max_speed: maximum speed, in m/s.
        max_acceleration: maximum acceleration, in m/s².
        min_state_interval: minimum time between two states, in seconds.
        state_interval: maximum time between two states, in seconds.
        visualization_interval: time between two visualizations while it moves, in seconds.
        driving_state_interval: maximum time between two states while it moves, in seconds; 0 for
            `state_interval`.
        maps_in_state: True if the state lists the maps on the robot.
    """

    max_speed: float = 1.0
    max_acceleration: float = 0.5
    min_state_interval: float = 0.1
    state_interval: float = 30.0
    visualization_interval: float = 1.0
    driving_state_interval: float = 0.0
    maps_in_state: bool = True


def factsheet(info: RobotInfo, limits: Limits, actions: tuple[ActionType, ...]) -> Factsheet:
    """Return the factsheet of a robot."""
    general: General = info.genral
    size = general.model_data
    version = general.version
    versions = (("robot system", version.system), ("robot application", version.rc))
    return Factsheet(
        series=general.display_model or general.urdf_name,
        description=general.urdf_name,
        kinematics=Kinematics.DIFFERENTIAL
        if general.driver_method == _DIFFERENTIAL
        else Kinematics.OMNIDIRECTIONAL,
        vehicle_class=_CLASSES.get(general.type, VehicleClass.CARRIER),
        max_load=float(size.load),
        length=size.length * _MM,
        width=size.width * _MM,
        height=size.height * _MM,
        max_speed=limits.max_speed,
        max_acceleration=limits.max_acceleration,
        outline=points(info.model.model),
        actions=actions,
        optional_parameters=OPTIONAL_PARAMETERS,
        min_state_interval=limits.min_state_interval,
        state_interval=limits.state_interval,
        visualization_interval=limits.visualization_interval,
        versions=tuple((key, value) for key, value in versions if value),
    )
