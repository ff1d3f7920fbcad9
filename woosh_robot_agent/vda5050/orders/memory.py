"""State of the order that must survive a restart of the program."""

from __future__ import annotations

from dataclasses import dataclass, field

from woosh_robot_agent.vda5050.model.errors import VehicleError
from woosh_robot_agent.vda5050.model.order import Action, Edge, Node
from woosh_robot_agent.vda5050.model.state import ActionState


@dataclass(frozen=True)
class ActionMemory:
    """State of the actions of an order.

    Attributes:
        states: states of all actions.
        triggered: triggered actions that have not started.
        running: actions that have started and not ended.
        of_edge: actions of the edge that the vehicle is on.
    """

    states: tuple[ActionState, ...] = ()
    triggered: tuple[Action, ...] = ()
    running: tuple[Action, ...] = ()
    of_edge: tuple[Action, ...] = ()


@dataclass(frozen=True)
class Memory:
    """State of an order.

    Attributes:
        order_id: id of the order; empty without any.
        update_id: number of its last update.
        last_node: the node that was reached last; None if there is none.
        nodes: nodes still to be reached.
        edges: edges still to be left.
        on_edge: the vehicle is on the first of the edges.
        leg_length: number of nodes of the current leg that are still to be reached; 0 without one.
        actions: the actions.
        canceling: True while the order is being cancelled.
        cancelled: True if the order was cancelled.
        holds: names of the holds that keep the vehicle from driving.
        error: why the order does not go on; None while it does.
    """

    order_id: str = ""
    update_id: int = 0
    last_node: Node | None = None
    nodes: tuple[Node, ...] = ()
    edges: tuple[Edge, ...] = ()
    on_edge: bool = False
    leg_length: int = 0
    actions: ActionMemory = field(default_factory=ActionMemory)
    canceling: bool = False
    cancelled: bool = False
    holds: tuple[str, ...] = ()
    error: VehicleError | None = None
