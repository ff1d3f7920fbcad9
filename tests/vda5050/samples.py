"""Values of the model in which every part is present."""

from __future__ import annotations

from woosh_robot_agent.vda5050.messages.factsheet import (
    ActionType,
    Factsheet,
    Limits,
    ParameterType,
    Scope,
)
from woosh_robot_agent.vda5050.messages.order import (
    ControlPoint,
    Edge,
    Node,
    NodePosition,
    Trajectory,
)
from woosh_robot_agent.vda5050.messages.state import (
    ActionState,
    ActionStatus,
    Battery,
    ErrorType,
    Map,
    OperatingMode,
    OrderStatus,
    Position,
    RobotStatus,
    VehicleState,
    Velocity,
    warning,
)

LINE = Trajectory(1, (0.0, 0.0, 1.0, 1.0), (ControlPoint(0.0, 0.0), ControlPoint(1.0, 0.0)))
NODE = Node("b", 2, True, NodePosition(1.0, 0.0, "hall", 0.5), description="a node")
EDGE = Edge("ab", 1, "a", "b", trajectory=LINE, description="an edge")
ROBOT = RobotStatus(
    driving=True,
    mode=OperatingMode.AUTOMATIC,
    battery=Battery(80.0, charging=False, health=97.0),
    emergency_stop=False,
    field_violation=False,
    position=Position(0.1, 0.0, 0.0, "hall", initialised=True),
    velocity=Velocity(0.5, 0.1),
    loaded=True,
    maps=(Map("hall", "3", enabled=True),),
    path=((0.0, 0.0), (0.5, 0.0), (1.0, 0.0)),
)
ORDER = OrderStatus(
    order_id="order",
    update_id=1,
    last_node_id="a",
    last_node_sequence_id=0,
    nodes=(NODE,),
    edges=(EDGE,),
    actions=(ActionState("1", "pick", ActionStatus.PAUSED, "a result", "an action"),),
    new_base_request=True,
    distance_since_last_node=0.1,
)
STATE = VehicleState(
    ORDER,
    ROBOT,
    instant_actions=(ActionState("2", "stateRequest", ActionStatus.FINISHED, "done", "ask"),),
    paused=True,
    errors=(warning(ErrorType.ORDER, "a reason", "a hint", nodeId="b"),),
)
FACTSHEET = Factsheet(
    series="TR-300",
    description="a robot",
    kinematics="DIFF",
    vehicle_class="CARRIER",
    max_load=300.0,
    length=1.0,
    width=0.7,
    height=0.3,
    limits=Limits(),
    outline=((0.5, 0.3), (-0.5, 0.3), (-0.5, -0.3)),
    actions=(
        ActionType(
            "pick",
            frozenset(Scope),
            "pick a load",
            (ParameterType("height", "FLOAT", "height, in m", optional=True),),
            "what was picked",
        ),
    ),
    versions=(("robot system", "1.2"),),
)
