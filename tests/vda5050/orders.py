"""Orders along a straight line, for tests of the order's state machine without I/O."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import pytest

from woosh_robot_agent.vda5050.messages.order import (
    Action,
    BlockingType,
    Edge,
    Node,
    NodePosition,
    Order,
)
from woosh_robot_agent.vda5050.messages.state import (
    ActionStatus,
    Position,
    RejectedError,
    VehicleError,
)
from woosh_robot_agent.vda5050.orders.legs import Command, Drive, Perform
from woosh_robot_agent.vda5050.orders.machine import OrderMachine

MAP = "hall"
_REPORT_EVERY = 0.5
"""Maximum distance between two reports of the position, in metres."""


def at(x: float, y: float = 0.0, theta: float = 0.0, map_id: str = MAP) -> Position:
    return Position(x, y, theta, map_id, initialised=True)


def place(x: float, **more: Any) -> NodePosition:
    """A position of a node on the line."""
    return NodePosition(x, more.pop("y", 0.0), more.pop("map_id", MAP), **more)


def action(name: str, blocking: BlockingType = BlockingType.HARD, kind: str = "pick") -> Action:
    return Action(name, kind, blocking)


def path(
    base: str,
    horizon: str = "",
    *,
    first: int = 0,
    actions: Mapping[str, Sequence[Action]] | None = None,
    edges: Mapping[str, Mapping[str, Any]] | None = None,
    update: int = 0,
    order_id: str = "order",
    **positions: NodePosition | None,
) -> Order:
    """An order whose nodes are letters.

    Node `a` is at x = 0, `b` at x = 1, and so on, unless a position is given.

    Args:
        base: released nodes.
        horizon: nodes that are not released.
        first: sequence id of the first node.
        actions: actions by the id of the node, or of the edge (`ab`).
        edges: fields of edges, by their id.
        positions: positions of nodes, by their id.
    """
    done = actions or {}
    nodes = [
        Node(
            name,
            first + 2 * index,
            released=index < len(base),
            position=positions.get(name, place(ord(name) - ord("a"))),
            actions=tuple(done.get(name, ())),
        )
        for index, name in enumerate(base + horizon)
    ]
    links = [
        Edge(
            f"{start.id}{end.id}",
            start.sequence_id + 1,
            start.id,
            end.id,
            released=end.released,
            actions=tuple(done.get(f"{start.id}{end.id}", ())),
            **(edges or {}).get(f"{start.id}{end.id}", {}),
        )
        for start, end in pairwise(nodes)
    ]
    return Order(order_id, update, tuple(nodes), tuple(links))


class Robot:
    """A machine and what it has commanded; it starts at x = 0."""

    def __init__(self) -> None:
        self.machine = OrderMachine()
        self.machine.moved(at(0.0))
        self.x = 0.0
        self.commands: list[Command] = []

    def give(self, order: Order) -> None:
        """Give an order that must be accepted."""
        self.machine.receive(order)
        self.poll()

    def refuses(self, order: Order) -> VehicleError:
        """Return the error with which an order is rejected; it must not change anything."""
        before = self.machine.status
        with pytest.raises(RejectedError) as caught:
            self.machine.receive(order)
        assert self.machine.status == before
        return caught.value.error

    def poll(self, *, may_drive: bool = True) -> list[Command]:
        new = self.machine.poll(may_drive=may_drive)
        self.commands += new
        return new

    def move(self, *xs: float) -> list[Command]:
        """Drive along the line, and report often; return what was commanded meanwhile."""
        new: list[Command] = []
        for x in xs:
            start, parts = self.x, max(1, math.ceil(abs(x - self.x) / _REPORT_EVERY))
            for part in range(1, parts + 1):
                new += self.jump(start + (x - start) * part / parts)
        return new

    def jump(self, x: float) -> list[Command]:
        """Report another position at once; return what was commanded then."""
        self.x = x
        self.machine.moved(at(x))
        return self.poll()

    def arrive(self) -> list[Command]:
        """End the current drive at its goal."""
        goal = self.drives[-1].leg.goal.position
        assert goal is not None
        self.x = goal.x
        self.machine.moved(at(goal.x, goal.y, goal.theta or 0.0, goal.map_id))
        self.machine.drive_ended()
        return self.poll()

    def finish(self, name: str) -> list[Command]:
        """Finish an action that was commanded."""
        assert name in [each.action.id for each in self.commands if isinstance(each, Perform)]
        self.machine.action_changed(name, ActionStatus.RUNNING)
        self.machine.action_changed(name, ActionStatus.FINISHED)
        return self.poll()

    @property
    def drives(self) -> list[Drive]:
        return [each for each in self.commands if isinstance(each, Drive)]

    @property
    def legs(self) -> list[str]:
        """Nodes of the legs that were commanded, the first node of each left out."""
        return ["".join(node.id for node in each.leg.nodes) for each in self.drives]

    @property
    def nodes(self) -> str:
        """Nodes still to be reached; the horizon in capitals."""
        return "".join(
            node.id if node.released else node.id.upper() for node in self.machine.status.nodes
        )

    @property
    def edges(self) -> list[str]:
        return [edge.id for edge in self.machine.status.edges]

    @property
    def last(self) -> str:
        return self.machine.status.last_node_id

    @property
    def actions(self) -> dict[str, str]:
        """Statuses of the actions, by id."""
        return {each.id: each.status.value for each in self.machine.status.actions}


def given(order: Order) -> Robot:
    """Return a robot with an order that it has accepted."""
    robot = Robot()
    robot.give(order)
    return robot


def references(error: VehicleError) -> dict[str, str]:
    return dict(error.references)
