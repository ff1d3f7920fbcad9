"""Accept or reject the messages of the master control, e.g. orders that the robot cannot drive."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Sequence, Set
from dataclasses import dataclass

from woosh_robot_agent.link.reports import LogOnce, one_line
from woosh_robot_agent.sentences import Sentence
from woosh_robot_agent.vda5050.execution import Execution
from woosh_robot_agent.vda5050.messages.factsheet import ActionTypes, Scope, find_objection
from woosh_robot_agent.vda5050.messages.geometry import Point, curve_defect, curve_points
from woosh_robot_agent.vda5050.messages.order import MAX_NODES, Action, Edge, Node, Order
from woosh_robot_agent.vda5050.messages.reading import (
    read_instant_actions,
    read_order,
    refusal_of_zone_set,
)
from woosh_robot_agent.vda5050.messages.state import (
    NO_POSITION,
    NOT_AUTOMATIC,
    NOT_READ,
    ErrorType,
    OperatingMode,
    RejectedError,
    RobotStatus,
    VehicleError,
    rejection,
)
from woosh_robot_agent.vda5050.messages.versions import Identity
from woosh_robot_agent.vda5050.orders.instant import CANCEL_ORDER, START_PAUSE
from woosh_robot_agent.vda5050.orders.structure import OrderKind, check_instant_ids, with_marks

_MANY_NODES = Sentence("the order has {count} nodes, more than {most}")
_MANY_POINTS = Sentence("the trajectories have {count} control points, more than {most}")
_TOO_SLOW = Sentence("the robot cannot drive as slowly as maxSpeed: {speed}")
_NO_MARK = Sentence("node {node} has no position, and the robot has no mark of that name")
_NO_MAP = Sentence("the robot has no map {map}")
_TRAJECTORY = Sentence("the robot cannot drive the trajectory: {reason}")
_UNSUPPORTED = Sentence("the robot cannot obey {fields} of {place}")
_LOST_BEGINNING = Sentence("it is an update of an order that the vehicle does not have")
_ORDER = Sentence("the order")
_EDGE = Sentence("an edge")
_AWAY = Sentence("it begins or ends {distance} m away from node {node}")
_MIN_SPEED_LIMIT = 0.05
"""Lowest speed limit that the robot obeys, in m/s."""
_MAX_CONTROL_POINTS = 2000
"""Maximum number of control points of all trajectories of an order."""
_TOLERANCE = 0.25
"""Maximum distance of the ends of a trajectory from their nodes, in metres."""


@dataclass(frozen=True)
class OrderCheck:
    """Check of an order against what a vehicle can do.

    Attributes:
        knows_marks: True if the marks of the robot are known.
    """

    order: Order
    types: ActionTypes
    knows_marks: bool

    def check(self, status: RobotStatus | None) -> None:
        """Check the order.

        Args:
            status: state of the robot; None if unknown.

        Raises:
            RejectedError: the vehicle cannot perform the order.
        """
        if status is None or status.mode is not OperatingMode.AUTOMATIC:
            raise self._error(
                ErrorType.NOT_AVAILABLE,
                NOT_AUTOMATIC(),
                "switch the robot to automatic control and task mode",
            )
        if status.position is None or not status.position.initialised:
            raise self._error(
                ErrorType.NOT_AVAILABLE, NO_POSITION(), "place it on the map with initPosition"
            )
        if self.order.unsupported:
            raise self._unsupported(self.order.unsupported, _ORDER())
        self._check_size()
        for edge in self.order.edges:
            self._check_edge(edge)
        maps = {status.position.map_id, *(each.id for each in status.maps or ())}
        for node in self.order.nodes:
            self._check_node(node, maps, knows_maps=status.maps is not None)
        for start, edge, end in zip(
            self.order.nodes, self.order.edges, self.order.nodes[1:], strict=False
        ):
            self._check_trajectory(start, edge, end)

    def _check_size(self) -> None:
        """Raise RejectedError if the order has too many nodes or control points."""
        if (number := len(self.order.nodes)) > MAX_NODES:
            raise self._error(
                ErrorType.ORDER,
                _MANY_NODES(count=number, most=MAX_NODES),
                "send a shorter order, and extend it by updates",
                parameter="nodes",
            )
        trajectories = (edge.trajectory for edge in self.order.edges)
        count = sum(len(each.points) for each in trajectories if each is not None)
        if count > _MAX_CONTROL_POINTS:
            raise self._error(
                ErrorType.ORDER,
                _MANY_POINTS(count=count, most=_MAX_CONTROL_POINTS),
                "send simpler trajectories, or fewer of them at a time",
                parameter="trajectory",
            )

    def _check_edge(self, edge: Edge) -> None:
        """Raise RejectedError if the robot cannot obey a field or perform an action of an edge."""
        if edge.unsupported:
            raise self._unsupported(edge.unsupported, _EDGE(), edgeId=edge.id)
        if edge.max_speed is not None and edge.max_speed < _MIN_SPEED_LIMIT:
            raise self._error(
                ErrorType.ORDER,
                _TOO_SLOW(speed=str(edge.max_speed)),
                f"permit at least {_MIN_SPEED_LIMIT} m/s",
                edgeId=edge.id,
                parameter="maxSpeed",
            )
        self._check_actions(edge.actions, Scope.EDGE, edgeId=edge.id)

    def _check_node(self, node: Node, maps: Set[str], *, knows_maps: bool) -> None:
        """Raise RejectedError if a node has no position, is on no known map, or has a bad action.

        Args:
            maps: ids of the maps on the robot.
            knows_maps: False if it may have more maps.
        """
        position = node.position
        if position is None:
            is_unread = not self.knows_marks  # the robot may have a mark of this number
        else:
            is_unread = position.map_id not in maps and not knows_maps
        if is_unread:
            raise self._error(
                ErrorType.ORDER, NOT_READ(), "send the order again later", nodeId=node.id
            )
        if position is None:
            raise self._error(
                ErrorType.ORDER,
                _NO_MARK(node=node.id),
                "give the node a nodePosition, or use the number of a mark as nodeId",
                nodeId=node.id,
                parameter="nodePosition",
            )
        if position.map_id not in maps:
            raise self._error(
                ErrorType.UNKNOWN_MAP,
                _NO_MAP(map=position.map_id),
                f"use one of its maps: {', '.join(sorted(maps))}",
                nodeId=node.id,
                mapId=position.map_id,
            )
        self._check_actions(node.actions, Scope.NODE, nodeId=node.id)

    def _check_trajectory(self, start: Node, edge: Edge, end: Node) -> None:
        """Raise RejectedError if an edge has a trajectory that is invalid, or leads elsewhere."""
        if edge.trajectory is None:
            return
        reason = curve_defect(edge.trajectory)
        if not reason:
            points = curve_points(edge.trajectory)
            reason = _gap_objection(start, points[0]) or _gap_objection(end, points[-1])
        if reason:
            raise self._error(
                ErrorType.ORDER,
                _TRAJECTORY(reason=reason),
                "send a NURBS from the start node to the end node, or no trajectory",
                edgeId=edge.id,
                parameter="trajectory",
            )

    def _check_actions(self, actions: Iterable[Action], scope: Scope, **place: str) -> None:
        """Raise RejectedError if an action is impossible; `place` refers to its node or edge."""
        for action in actions:
            if objection := find_objection(self.types, action, scope):
                raise self._error(
                    ErrorType.ORDER_ACTION,
                    objection.reason,
                    "see the factsheet for the actions of the vehicle",
                    **place,
                    actionId=action.id,
                    actionType=action.type,
                    **objection.references,
                )

    def _unsupported(self, fields: Sequence[str], place: str, **references: str) -> RejectedError:
        """Return the rejection of an order with fields that the robot cannot obey."""
        return self._error(
            ErrorType.UNSUPPORTED_PARAMETER,
            _UNSUPPORTED(fields=", ".join(fields), place=place),
            "leave them out; the factsheet lists the optional fields that the robot obeys",
            **references,
            parameter=list(fields),
        )

    def _error(
        self, kind: ErrorType, reason: str, hint: str, **references: object
    ) -> RejectedError:
        return rejection(kind, self.order, reason, hint, **references)


def _gap_objection(node: Node, point: Point) -> str:
    """Return why a trajectory with this end point does not meet its node; empty if it does."""
    place = node.position
    if place is None:
        return ""
    distance = math.dist(place.point, point)
    if distance <= max(place.deviation_xy, _TOLERANCE):
        return ""
    return _AWAY(distance=f"{distance:.2f}", node=node.id)


_LOG = logging.getLogger(__name__)


class Intake:
    """Accepts or rejects the messages of the master control, and hands them to the execution.

    Attributes:
        identity: manufacturer and serial number of the vehicle; set it before the first message.
        message_error: why the last message with instant actions or zones was rejected; None if it
            was accepted, and after a new order.
    """

    def __init__(self, execution: Execution) -> None:
        self.identity = Identity("", "")
        self._version = execution.version
        self._execution = execution
        self._log = LogOnce(_LOG)
        self._payload = b""
        """The last message with an order that was accepted; empty before the first."""
        self._order: Order | None = None
        """The order in `_payload` as it was sent: without the positions of marks, which may change.
        None before the first."""
        self.message_error: VehicleError | None = None

    def take_order(self, payload: bytes) -> None:
        """Accept or reject an order; ignore one that the vehicle has already."""
        execution, is_3 = self._execution, self._version.is_3
        # in version 3, a cancelled order that is sent again is an error
        may_repeat = not (is_3 and execution.order.is_cancelled)
        # not parsed: a master control may repeat a large order often
        if may_repeat and payload == self._payload:
            return
        try:
            received = read_order(payload, self._version, self.identity)
            if may_repeat and received == self._order:
                return
            here = execution.robot.position
            map_id = "" if here is None else here.map_id
            order = with_marks(received, map_id, execution.maps.find_mark)
            kind = execution.order.receive(order, self._check, is_3=is_3)
        except RejectedError as rejected:
            self._log.warn(f"order: {rejected}", f"an order was rejected: {rejected}")
            execution.report_order_error(rejected.error)
            return
        if kind is OrderKind.KNOWN:
            key = f"{order.id}, update {order.update_id}"
            self._log.warn(key, f"order {one_line(key)} was received again, and ignored")
            return
        _LOG.info("order %s, update %d accepted", one_line(order.id), order.update_id)
        self._log.clear()
        execution.order_errors.clear()
        self._payload, self._order = payload, received
        if kind is OrderKind.NEW:
            self.message_error = None
            if not is_3:  # in version 3, ended instant actions stay until clearInstantActions
                execution.instant.forget_ended()
            execution.instant.errors.clear()

    def take_stops(self, payload: bytes) -> None:
        """Accept or reject instant actions, but ignore those that do not stop."""
        self.take_instant_actions(payload, {START_PAUSE, CANCEL_ORDER})

    def take_instant_actions(self, payload: bytes, only: Set[str] | None = None) -> None:
        """Accept or reject instant actions.

        Args:
            payload: the message.
            only: types to accept, ignoring others; None to accept all.
        """
        try:
            actions = read_instant_actions(payload, self._version, self.identity)
        except RejectedError as rejected:
            self._log.warn(f"actions: {rejected}", f"instant actions were rejected: {rejected}")
            self.message_error = rejected.error
        else:
            self.message_error = None
            kept = [each for each in actions if only is None or each.type in only]
            instant = self._execution.instant
            former = tuple(instant.errors)
            accepted = instant.receive(kept)
            if self._version.is_3:
                instant.end_errors(former, accepted)

    def refuse_zone_set(self, payload: bytes) -> None:
        """Refuse a zone set, because the robot takes no zones."""
        error = refusal_of_zone_set(payload, self._version, self.identity)
        reason = error.description
        self._log.warn(f"zones: {reason}", f"a zone set was refused: {reason}")
        self.message_error = error

    def _check(self, order: Order) -> None:
        """Check an order against what the vehicle can do now.

        Raises:
            RejectedError: the vehicle cannot perform the order.
        """
        is_new = order.id != self._execution.order.order_id
        if is_new and order.update_id and self._version.is_3:
            raise rejection(
                ErrorType.ORDER,
                order,
                _LOST_BEGINNING(),
                "send a new order, with another orderId and orderUpdateId 0",
            )
        # in version 2.1, a new order removes the ended instant actions from the state
        keeps_ended = self._version.is_3 or not is_new
        check_instant_ids(order, self._execution.instant.ids_in_state(ended=keeps_ended))
        execution = self._execution
        check = OrderCheck(order, execution.types, execution.maps.knows_marks)
        check.check(execution.robot_status)
