"""The state machine of the current order."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from woosh_robot_agent.sentences import Sentence
from woosh_robot_agent.vda5050.messages.order import Edge, Node, Order
from woosh_robot_agent.vda5050.messages.state import (
    ActionStatus,
    ErrorLevel,
    ErrorType,
    OrderStatus,
    Position,
    VehicleError,
    warning,
)
from woosh_robot_agent.vda5050.orders.actions import ActionsMemory, OrderActions
from woosh_robot_agent.vda5050.orders.legs import (
    Command,
    Control,
    Drive,
    Leg,
    need_standstill,
    needs_base,
    next_leg,
    speed_limit,
)
from woosh_robot_agent.vda5050.orders.reach import Route, distance, in_sequence
from woosh_robot_agent.vda5050.orders.structure import (
    OrderKind,
    check_action_ids,
    check_first_actions,
    check_start,
    classify,
)

_RESTARTED = Sentence("the connector was restarted while the action ran")()
_OTHER_MAP = Sentence("the vehicle waits before node {node}: it is on map {map}")
_NOT_REACHED = Sentence("the robot did not reach node {node}: {reason}")
_MOVED = Sentence("the robot was moved away from node {node}")
_LOST = Sentence("the robot lost its position, and found it elsewhere")
_FAR = Sentence("the trajectory of edge {edge} begins {distance} m away")
_NO_POSITION = "position"
"""Name of the hold of a vehicle that does not know its position."""
_MAX_COAST = 1.0
"""Maximum way on which the vehicle stops when it has lost its position, in metres."""
_MAX_APPROACH = 0.5
"""Maximum distance to the start of a trajectory from which the vehicle drives there, in metres."""


@dataclass(frozen=True)
class OrderMemory:
    """State of an order that must survive a restart of the program.

    Attributes:
        order_id: id of the order; empty without an order.
        update_id: number of the order's last update.
        last_node: the node that was reached last; None before the first node.
        nodes: nodes still to be reached.
        edges: edges still to be traversed, the current one included.
        on_edge: True if the vehicle is on the first of `edges`.
        place: last position to which the vehicle drove, e.g. to dock; None on a leg, or if unknown.
        leg_length: number of nodes of the current leg (part of the order without a stop) that are
            still to be reached; 0 without a leg.
        actions: state of the actions of the order.
        canceling: True while the order is being cancelled, i.e. until its drive and actions have
            ended, and its remaining nodes and edges are removed.
        cancelled: True once the order was cancelled; it stays True when `canceling` ends.
        holds: names of the holds, i.e. of the reasons for which the vehicle must not drive.
        error: why the order can only be cancelled; None while it can go on.
    """

    order_id: str = ""
    update_id: int = 0
    last_node: Node | None = None
    nodes: tuple[Node, ...] = ()
    edges: tuple[Edge, ...] = ()
    on_edge: bool = False
    place: Position | None = None
    leg_length: int = 0
    actions: ActionsMemory = field(default_factory=ActionsMemory)
    canceling: bool = False
    cancelled: bool = False
    holds: tuple[str, ...] = ()
    error: VehicleError | None = None

    @property
    def is_unfinished(self) -> bool:
        """True if the order was being executed or cancelled, or waited for an update."""
        actions = self.actions
        return bool(self.canceling or self.nodes or actions.running or actions.triggered)


class OrderMachine:
    """The current order: its state, and what to do next.

    Call a method for each event, and then `poll` for the commands.

    Attributes:
        route: the rest of the order, and the place of the vehicle on it.
        holds: names of the holds, i.e. of the reasons for which the vehicle must not drive, e.g. a
            pause. While there is one, the drive is paused, and no leg starts.
        error: why the order can only be cancelled; None while it can go on.
        canceling: True while the order is being cancelled, i.e. until its drive and actions have
            ended, and `empty` is called.
        is_cancelled: True once the order was cancelled; it stays True when `canceling` ends.
    """

    def __init__(self) -> None:
        self._actions = OrderActions()
        self.route = Route(self._actions)
        self.error: VehicleError | None = None
        self._order: Order | None = None
        """The order or update that was taken last."""
        self.canceling = False
        self.is_cancelled = False
        self.holds: set[str] = set()
        self._is_drive_paused: bool | None = False
        """True if the last command about the drive was a pause; None if unknown after a restart."""
        self._lost_at: Position | None = None
        """Last position when `position_lost` was called; None if unknown after a restart."""

    # Properties of the order

    @property
    def held(self) -> bool:
        """True while a hold or an interruption of the order keeps the vehicle from driving."""
        interrupted = self.error is not None and self.error.type == ErrorType.INTERRUPTED.value
        return bool(self.holds) or interrupted

    @property
    def busy(self) -> bool:
        """True if the vehicle executes or cancels an order, or waits for an update of it."""
        actions = self._actions
        return bool(self.canceling or self.route.nodes or actions.running or actions.triggered)

    @property
    def driving(self) -> bool:
        """True if the vehicle drives a leg, i.e. a part of the order without a stop."""
        return self.route.leg is not None

    @property
    def acting(self) -> bool:
        """True while an action of the order runs."""
        return bool(self._actions.running)

    @property
    def can_go_on(self) -> bool:
        """True if the order has a next step: an action to start, or a released edge."""
        return self.error is None and not self.canceling and self._has_next_step

    @property
    def _has_next_step(self) -> bool:
        edges = self.route.edges
        return bool(self._actions.triggered or (edges and edges[0].released))

    @property
    def errors(self) -> tuple[VehicleError, ...]:
        """Why the order does not go on; empty while it goes on."""
        if self.error is not None:
            return (self.error,)
        route, here = self.route, self.route.position
        node = route.nodes[0] if route.nodes and route.nodes[0].released else None
        if node is None or here is None or route.is_on_map_of(node):
            return ()
        if self._actions.need_standstill():
            return ()  # an action may bring the vehicle to the other map
        return (
            warning(
                ErrorType.DRIVING,
                _OTHER_MAP(node=node.id, map=here.map_id),
                "enable the map of the node, or cancel the order with cancelOrder",
                orderId=self.order_id,
                nodeId=node.id,
                mapId=node.position.map_id if node.position else "",
            ),
        )

    @property
    def has_ended(self) -> bool:
        """True once the drive and all actions of a cancelled order have ended."""
        return self.canceling and not self.driving and not self._actions.running

    @property
    def order_id(self) -> str:
        """Id of the current or last order; empty before the first order."""
        return self._order.id if self._order else ""

    @property
    def _update_id(self) -> int:
        return self._order.update_id if self._order else 0

    @property
    def status(self) -> OrderStatus:
        """Progress of the order."""
        route, last = self.route, self.route.last_node
        return OrderStatus(
            order_id=self.order_id,
            update_id=self._update_id,
            last_node_id=last.id if last else "",
            last_node_sequence_id=last.sequence_id if last else 0,
            nodes=tuple(route.nodes),
            edges=tuple(route.edges),
            actions=self._actions.states,
            new_base_request=self._needs_base,
            distance_since_last_node=None if last is None else route.driven,
        )

    @property
    def progress(self) -> tuple[Node | None, bool]:
        """Last node, and True if more base is needed: a change of these is published at once."""
        return self.route.last_node, self._needs_base

    @property
    def _needs_base(self) -> bool:
        return not self.canceling and needs_base(self.route.nodes, self.route.position)

    @property
    def speed_limit(self) -> float | None:
        """Maximum speed now, in m/s; infinite without a limit, None while no leg is driven."""
        if (leg := self.route.leg) is None:
            return None
        current = leg.edges.index(self.route.edges[0])
        return speed_limit(leg.edges[current:], leg.nodes[current:], self.route.position)

    @property
    def _decision_point(self) -> Node | None:
        """Last node of the base, or the last reached node if no base is left."""
        released = [node for node in self.route.nodes if node.released]
        return released[-1] if released else self.route.last_node

    def has_action(self, action_id: str) -> bool:
        """Return True if an action of the order has this id."""
        return any(each.id == action_id for each in self._actions.states)

    # Events

    def receive(
        self,
        order: Order,
        check: Callable[[Order], None] = lambda order: None,
        *,
        is_3: bool = True,
    ) -> OrderKind:
        """Take an order or an update, and return its kind.

        Args:
            check: called with an order that is not known yet; raises a RejectedError if the vehicle
                cannot perform it.
            is_3: True for the rules of version 3, see `classify`.

        Raises:
            RejectedError: the vehicle cannot take the order; nothing has changed.
        """
        kind = classify(
            order,
            self._order,
            busy=self.busy,
            cancelled=self.is_cancelled,
            is_3=is_3,
            decision_point=self._decision_point,
        )
        if kind is OrderKind.KNOWN:
            return kind
        horizon: list[Node | Edge] = []
        if kind is OrderKind.UPDATE:
            # an update replaces the horizon; its first node repeats the last one of the base
            horizon = [part for part in self.route.parts if not part.released]
            kept = self._actions.ids_without(horizon)
            check_first_actions(order, kept.__contains__)
            check_action_ids(order, kept)
        check(order)  # before check_start, which would fail with another error on an unknown map
        if kind is OrderKind.NEW:
            check_start(order, self.route.stands_on)
            self.error = None
            self.is_cancelled = False
            self._actions.clear()
            self._actions.add(in_sequence(order.nodes, order.edges))
            self.route.begin(order)
        else:
            self._actions.remove(horizon)
            self.route.append(order)
            self._actions.add(in_sequence(order.nodes[1:], order.edges))
        self._order = order
        return kind

    def set_last_node(self, node_id: str) -> None:
        """Set the node on which the vehicle stands, e.g. after its position was initialised.

        Args:
            node_id: id of the node; empty if the vehicle stands on no node.
        """
        last = self.route.last_node
        # an update of the order may have to begin with this sequence id
        number = last.sequence_id if last and self.busy else 0
        self.route.set_last_node(Node(node_id, number) if node_id else None)

    def forget_left_node(self) -> None:
        """Forget the last node if the vehicle has left it; not during an order."""
        if not self.busy and self.route.has_left_last_node:
            self.set_last_node("")

    def moved(
        self, position: Position, *, by_action: bool = False, confirmed: bool = False
    ) -> None:
        """Take a new position, and reach the nodes of the leg that the vehicle has passed.

        Args:
            position: the new position, also if it is the same as before.
            by_action: True if an action may have moved the vehicle.
            confirmed: True if the robot has confirmed, over the current link, that it drives the
                leg.
        """
        self.route.moved(
            position, by_action=by_action, confirmed=confirmed, passes=not self.canceling
        )
        if _NO_POSITION in self.holds:
            self._position_found(position)

    def position_lost(self) -> None:
        """Hold the drive until the next `moved`: the vehicle does not know its position."""
        if _NO_POSITION not in self.holds:
            self._lost_at = self.route.position
            self.holds.add(_NO_POSITION)

    def _position_found(self, position: Position) -> None:
        """Let a drive go on if the vehicle is where it lost its position; else set `error`."""
        self.holds.discard(_NO_POSITION)
        if not self.driving or self.canceling or self.error is not None:
            return
        if distance(self._lost_at, position) > _MAX_COAST:
            self.error = self._fatal_error(ErrorType.INTERRUPTED, _LOST())

    def drive_ended(self, reason: str = "") -> None:
        """Take note that the drive has ended.

        Args:
            reason: why the drive did not reach the goal of the leg; empty if it did.
        """
        route = self.route
        if route.leg is None or self.canceling:  # without a leg: a drive that began too late
            route.leg = None
        elif reason:
            route.leg = None
            node = route.nodes[0]
            self.error = self._fatal_error(
                ErrorType.DRIVING,
                _NOT_REACHED(node=node.id, reason=reason),
                ("nodeId", node.id),
                ("edgeId", route.edges[0].id),
            )
        else:
            route.arrive()

    def drive_unsent(self) -> None:
        """Take note that the last `Drive` was not sent to the robot; `poll` returns it again."""
        self.route.leg = None
        self.route.must_check_place = True  # without a link, people may move the robot

    def action_changed(self, action_id: str, status: ActionStatus, result: str = "") -> None:
        """Store the new status of an action that was started by a `Perform` command."""
        self._actions.set_status(action_id, status, result)

    def cancel(self, reason: str = "the order was cancelled") -> None:
        """Begin to cancel the order; `empty` ends the cancellation.

        Args:
            reason: result of the actions that fail because of the cancellation.
        """
        self.canceling = self.is_cancelled = True
        self.error = None
        self._actions.cancel(reason)
        if self.driving:
            self._actions.commands.append(Control.CANCEL)

    def poll(
        self, *, may_drive: bool = True, may_check: bool = True, may_empty: bool = True
    ) -> list[Command]:
        """Return the commands that follow from the events so far.

        Args:
            may_drive: True if a leg may start.
            may_check: True if nothing moves the robot, so that its position can be checked.
            may_empty: True if a cancelled order that has ended may be emptied.
        """
        if self.canceling:
            if may_empty and self.has_ended:
                self.empty()
        elif self._check_place(may_check=may_check):
            self._start_actions()
            self._pause_or_resume_drive()
            if may_drive and not self.held:
                while self._start_leg_or_reach_in_place():
                    self._start_actions()
        commands, self._actions.commands = self._actions.commands, []
        return commands

    def empty(self) -> None:
        """Remove the remaining nodes and edges of a cancelled order that has ended."""
        self.canceling = False
        self.route.empty()

    # Memory

    @property
    def memory(self) -> OrderMemory:
        """State that must survive a restart of the program."""
        route, leg = self.route, self.route.leg
        return OrderMemory(
            order_id=self.order_id,
            update_id=self._update_id,
            last_node=route.last_node,
            nodes=tuple(route.nodes),
            edges=tuple(route.edges),
            on_edge=route.on_edge,
            place=route.driven_to if leg is None else None,  # it changes often on a leg
            leg_length=0 if leg is None else route.nodes.index(leg.goal) + 1,
            actions=self._actions.memory,
            canceling=self.canceling,
            cancelled=self.is_cancelled,
            holds=tuple(sorted(self.holds)),
            error=self.error,
        )

    def restore(self, memory: OrderMemory) -> None:
        """Go on with an order after a restart. Actions that ran fail.

        If `driving` is True afterwards, call `drive_ended` at the end of the drive, as after a
        `Drive`.
        """
        if not memory.order_id:
            return
        # the nodes and edges that were passed are not saved, so `_order` is without parts
        self._order = Order(memory.order_id, memory.update_id, nodes=(), edges=())
        route = self.route
        route.restore(memory.last_node, memory.nodes, memory.edges, on_edge=memory.on_edge)
        route.driven_to = memory.place
        self._actions.restore(memory.actions)
        if length := memory.leg_length:
            route.leg = Leg(memory.edges[:length], memory.nodes[:length])
        self.is_cancelled = memory.cancelled
        self.holds = set(memory.holds)
        self.error = memory.error
        self._is_drive_paused = None if self.held else False
        for action in self._actions.interrupt(_RESTARTED):
            if need_standstill((action,)):
                self.interrupt(action.id)
        if memory.canceling:
            self.cancel()

    def interrupt(self, action_id: str, reason: str = _RESTARTED) -> None:
        """Stop the order for good, after an action that forbids driving was interrupted.

        Interrupted means cancelled at the robot, or of unknown outcome. Do nothing while the order
        is being cancelled.

        Args:
            reason: why the order must not go on.
        """
        if self.busy and not self.canceling and self.error is None:
            self.error = self._fatal_error(ErrorType.INTERRUPTED, reason, ("actionId", action_id))

    # Steps

    def _check_place(self, *, may_check: bool) -> bool:
        """If required, check that the vehicle is still at its last node; set `error` if it is not.

        Returns:
            False while the order must wait, because the position cannot be checked yet.
        """
        route = self.route
        last = route.last_node
        if not route.must_check_place or self.driving or not self._has_next_step:
            return True
        if last is not None and last.position is not None:
            if route.position is None or not may_check:  # somebody may still move the vehicle
                return False
            if not route.is_in_place and self.error is None:
                self.error = self._fatal_error(
                    ErrorType.INTERRUPTED, _MOVED(node=last.id), ("nodeId", last.id)
                )
        route.must_check_place = False
        return True

    def _fatal_error(
        self, kind: ErrorType, reason: str, *references: tuple[str, str]
    ) -> VehicleError:
        """Return the error of an order that cannot go on."""
        return VehicleError(
            kind.value,
            ErrorLevel.CRITICAL,
            reason,
            "remove the cause, then cancel the order with cancelOrder and send a new one",
            (("orderId", self.order_id), *references),
        )

    def _start_actions(self) -> None:
        if self.error is None:
            self._actions.start(driving=self.driving)

    def _pause_or_resume_drive(self) -> None:
        """Pause or resume the drive after a change of `held`."""
        if self.driving and self._is_drive_paused != self.held:
            self._is_drive_paused = self.held
            self._actions.commands.append(Control.PAUSE if self.held else Control.RESUME)

    def _start_leg_or_reach_in_place(self) -> bool:
        """Start the next leg, or reach the next node without a drive if it is at the same place.

        If the leg begins with a trajectory that is too far away, set `error` instead.

        Returns:
            True if the next node was reached, so that the leg after it may start.
        """
        route = self.route
        if self.driving or self.error is not None or self._actions.need_standstill():
            return False
        leg = next_leg(route.edges, route.nodes)
        if leg is None or not route.is_on_map_of(leg.nodes[0]):
            return False
        if not route.on_edge:
            route.enter_edge()
            self._start_actions()
            if self._actions.need_standstill():
                return False
        if leg.edges[0].trajectory is None and route.reach_in_place(leg.nodes[0]):
            return True
        if (gap := route.distance_to_trajectory(leg)) > _MAX_APPROACH:
            self.error = self._fatal_error(
                ErrorType.DRIVING,
                _FAR(edge=leg.edges[0].id, distance=f"{gap:.1f}"),
                ("nodeId", leg.nodes[0].id),
                ("edgeId", leg.edges[0].id),
            )
            return False
        route.begin_leg(leg)
        self._is_drive_paused = False
        self._actions.commands.append(Drive(leg))
        return False
