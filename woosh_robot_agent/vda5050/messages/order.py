"""Orders: nodes, edges, actions and trajectories, with limits of what master control may send."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

MAX_MESSAGE_SIZE = 2 * 2**20
"""Maximum length of a message, in bytes."""
MAX_TEXT = 10_000
"""Maximum length of a text in a message, in characters."""
MAX_INSTANT_ACTIONS = 100
"""Maximum number of actions in a message with instant actions."""
MAX_NODES = 1000
"""Maximum number of nodes of an order."""
MAX_DEGREE = 5
"""Maximum degree of a trajectory."""
MAX_CONTROL_POINTS = 500
"""Maximum number of control points of a trajectory."""
MAX_KNOTS = MAX_CONTROL_POINTS + MAX_DEGREE + 1
"""Maximum number of knots of a trajectory."""


class BlockingType(Enum):
    """Blocking type of an action: what else is permitted while it runs."""

    NONE = "NONE"
    """Driving and other actions."""
    SINGLE = "SINGLE"
    """Driving, but no other action."""
    SOFT = "SOFT"
    """Other actions, but no driving."""
    HARD = "HARD"
    """Nothing."""

    @property
    def forbids_driving(self) -> bool:
        """True if the vehicle must not drive while the action runs."""
        return self in (BlockingType.SOFT, BlockingType.HARD)

    @property
    def excludes_actions(self) -> bool:
        """True if no other action may run at the same time."""
        return self in (BlockingType.SINGLE, BlockingType.HARD)


@dataclass(frozen=True)
class Action:
    """An action of a node, of an edge or of an instantActions message.

    Attributes:
        type: name of the action, e.g. `pick`.
        parameters: values by key.
    """

    id: str
    type: str
    blocking: BlockingType = BlockingType.HARD
    parameters: Mapping[str, Any] = field(default_factory=dict)
    description: str = ""


@dataclass(frozen=True)
class Ellipse:
    """Shape of the permitted deviation from a node.

    Attributes:
        a: semi-axis in the direction `theta`, in metres.
        b: the other semi-axis, in metres.
        theta: angle in the map frame, in radians.
    """

    a: float
    b: float
    theta: float


@dataclass(frozen=True)
class NodePosition:
    """Position of a node.

    Attributes:
        x: position in the map frame, in metres.
        y: position in the map frame, in metres.
        theta: heading that the vehicle must have on the node, in radians; None for any.
        deviation_xy: distance from the position at which the node counts as traversed, in metres. A
            value below 0.25 m, e.g. 0, counts as 0.25 m.
        deviation_theta: permitted deviation from `theta`, in radians; at least 0.1 rad counts.
        ellipse: permitted deviation, if it is an ellipse; `deviation_xy` is then its smaller
            semi-axis. None for a circle.
    """

    x: float
    y: float
    map_id: str
    theta: float | None = None
    deviation_xy: float = 0.0
    deviation_theta: float = 0.0
    ellipse: Ellipse | None = None

    @property
    def point(self) -> tuple[float, float]:
        """The place without the heading, in metres."""
        return self.x, self.y


@dataclass(frozen=True)
class Node:
    """A node of an order.

    Attributes:
        id: id of the node; several nodes of an order may have the same id.
        sequence_id: position among the nodes and edges of the order.
        released: True if the node belongs to the base, False if to the horizon.
        position: position; None if neither the order nor a mark gives it.
        mark: number of the mark by which the robot drives to the node; empty if it drives to the
            position.
    """

    id: str
    sequence_id: int
    released: bool = True
    position: NodePosition | None = None
    actions: tuple[Action, ...] = ()
    description: str = ""
    mark: str = ""


@dataclass(frozen=True)
class ControlPoint:
    """A control point of a trajectory: position in metres, and weight."""

    x: float
    y: float
    weight: float = 1.0


@dataclass(frozen=True)
class Trajectory:
    """A curve as a NURBS.

    Attributes:
        degree: degree of the curve; 1 for straight lines between the control points.
        knots: knot vector; it does not decrease.
    """

    degree: int
    knots: tuple[float, ...]
    points: tuple[ControlPoint, ...]


@dataclass(frozen=True)
class Edge:
    """An edge of an order.

    Attributes:
        sequence_id: position among the nodes and edges of the order.
        released: True if the edge belongs to the base, False if to the horizon.
        max_speed: maximum speed on the edge, in m/s; None without a limit.
        trajectory: curve to drive along; None if the robot plans its path.
        unsupported: names of the fields of the edge in the message that the robot cannot obey.
    """

    id: str
    sequence_id: int
    start_node_id: str
    end_node_id: str
    released: bool = True
    max_speed: float | None = None
    trajectory: Trajectory | None = None
    actions: tuple[Action, ...] = ()
    description: str = ""
    unsupported: tuple[str, ...] = ()


@dataclass(frozen=True)
class Order:
    """An order or an update of an order.

    Attributes:
        unsupported: names of the fields in the message that the robot cannot obey, except those of
            edges.
    """

    id: str
    update_id: int
    nodes: tuple[Node, ...]
    edges: tuple[Edge, ...]
    unsupported: tuple[str, ...] = ()

    @property
    def parts(self) -> tuple[Node | Edge, ...]:
        """All nodes, then all edges."""
        return (*self.nodes, *self.edges)
