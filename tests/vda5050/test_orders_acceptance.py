"""Acceptance of orders and updates, decision by decision of the standard's diagram."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.vda5050.orders import Robot, action, at, given, path, place, references
from woosh_robot_agent.vda5050.messages.order import BlockingType, Edge, NodePosition, Order
from woosh_robot_agent.vda5050.messages.state import ActionStatus, ErrorLevel, ErrorType, Position
from woosh_robot_agent.vda5050.orders.structure import OrderKind

ORDER = path("abc", "d")
MALFORMED = {
    "no id": replace(ORDER, id=""),
    "no node": replace(ORDER, nodes=()),
    "an edge too few": replace(ORDER, edges=ORDER.edges[:-1]),
    "an edge too many": replace(ORDER, edges=(*ORDER.edges, Edge("x", 7, "d", "e"))),
    "the first node is not released": replace(
        ORDER, nodes=(replace(ORDER.nodes[0], released=False), *ORDER.nodes[1:])
    ),
    "a gap in the sequence": replace(
        ORDER, nodes=(*ORDER.nodes[:3], replace(ORDER.nodes[3], sequence_id=8))
    ),
    "an edge between other nodes": replace(
        ORDER, edges=(replace(ORDER.edges[0], start_node_id="x"), *ORDER.edges[1:])
    ),
    "a released edge to a node that is not": replace(
        ORDER, edges=(*ORDER.edges[:2], replace(ORDER.edges[2], released=True))
    ),
    "a released node after the horizon": replace(
        path("ab", "cd"), nodes=(*path("ab", "cd").nodes[:3], path("abcd").nodes[3])
    ),
    "two actions with one id": path("ab", actions={"a": [action("1")], "b": [action("1")]}),
    "an action of an edge with the id of one of a node": path(
        "ab", actions={"a": [action("1")], "ab": [action("1")]}
    ),
}


@pytest.mark.parametrize("order", MALFORMED.values(), ids=MALFORMED.keys())
def test_a_malformed_order_is_rejected(order: Order) -> None:
    error = Robot().refuses(order)
    assert (error.type, error.level) == (ErrorType.VALIDATION, ErrorLevel.WARNING)
    assert references(error)["orderId"] == order.id
    assert references(error)["orderUpdateId"] == "0"


def test_another_order_is_rejected_until_the_one_before_has_ended() -> None:
    """While it is driven, waits for an update, or an action runs."""
    robot = given(path("ab", "c"))
    error = robot.refuses(path("a", order_id="other"))
    assert error.type == ErrorType.OTHER_ORDER_ACTIVE
    assert references(error)["orderId"] == "other"
    robot.arrive()
    assert robot.refuses(path("b", order_id="other")).type == ErrorType.OTHER_ORDER_ACTIVE

    robot = given(path("a", actions={"a": [action("pick")]}))
    assert robot.refuses(path("a", order_id="other")).type == ErrorType.OTHER_ORDER_ACTIVE
    robot.finish("pick")
    robot.give(path("ab", order_id="other", actions={"b": [action("new")]}))
    assert robot.machine.status.order_id == "other"
    assert robot.actions == {"new": "WAITING"}


def test_another_order_is_rejected_until_the_vehicle_stands_after_a_cancellation() -> None:
    robot = given(path("a", actions={"a": [action("pick")]}))
    robot.machine.cancel()
    robot.machine.action_changed("pick", ActionStatus.FAILED)
    robot.machine.poll(may_empty=False)  # it still rolls
    assert robot.refuses(path("ab", order_id="other")).type == ErrorType.OTHER_ORDER_ACTIVE
    robot.machine.poll()
    robot.give(path("ab", order_id="other"))


@pytest.mark.parametrize(
    ("here", "start", "accepted"),
    [
        (at(0.2), place(0.0), True),
        (at(0.3), place(0.0), False),
        (at(0.9), place(0.0, deviation_xy=1.0), True),
        (at(1.1), place(0.0, deviation_xy=1.0), False),
        (at(0.0), place(0.0, theta=0.05), True),
        (at(0.0), place(0.0, theta=0.2), False),
        (at(0.0), place(0.0, theta=0.2, deviation_theta=0.3), True),
        (at(0.0), place(0.0, theta=-3.1, deviation_theta=0.3), False),
        (at(0.0), place(0.0, map_id="roof"), False),
        (at(0.0), None, False),
    ],
)
def test_the_first_node_must_be_in_reach(
    here: Position, start: NodePosition | None, accepted: bool
) -> None:
    robot = Robot()
    robot.machine.moved(here)
    order = path("ab", a=start)
    if accepted:
        robot.give(order)
        return
    error = robot.refuses(order)
    assert error.type == ErrorType.NO_ROUTE
    assert references(error) == {"orderId": "order", "orderUpdateId": "0", "nodeId": "a"}


def test_an_old_update_is_rejected_and_the_order_goes_on() -> None:
    robot = given(path("ab", "c", update=3))
    error = robot.refuses(path("bc", first=2, update=2))
    assert error.type == ErrorType.OUTDATED_UPDATE
    assert references(error)["orderUpdateId"] == "2"
    assert robot.machine.status.update_id == 3
    robot.arrive()
    assert robot.last == "b"


def test_a_repeated_order_changes_nothing() -> None:
    order = path("ab", "c")
    robot = given(order)
    robot.give(order)
    assert (robot.legs, robot.nodes) == (["b"], "bC")
    robot.arrive()
    robot.give(order)
    assert (robot.legs, robot.nodes) == (["b"], "C")


def test_a_repeated_update_with_another_content_is_rejected() -> None:
    """In version 2.1, it is ignored."""
    robot = given(path("ab", "c"))
    robot.give(path("bc", first=2, update=1))
    changed = path("bd", first=2, update=1)
    error = robot.refuses(changed)
    assert error.type == ErrorType.CHANGED_UPDATE
    assert robot.machine.receive(changed, is_3=False) is OrderKind.KNOWN
    assert robot.nodes == "bc"


def test_an_update_extends_the_base_at_its_last_node() -> None:
    robot = given(path("abc", "de"))
    robot.give(path("cde", "f", first=4, update=7))  # numbers may be skipped
    assert (robot.nodes, robot.edges) == ("bcdeF", ["ab", "bc", "cd", "de", "ef"])
    assert robot.machine.status.update_id == 7


def test_an_update_replaces_or_deletes_the_horizon_and_its_actions() -> None:
    robot = given(path("ab", "cd", actions={"c": [action("gone")], "b": [action("stays")]}))
    robot.give(path("b", "e", first=2, update=1, actions={"e": [action("new")]}))
    assert (robot.nodes, robot.edges) == ("bE", ["ab", "be"])
    assert list(robot.actions) == ["stays", "new"]
    robot.give(path("b", first=2, update=2))
    assert (robot.nodes, robot.edges) == ("b", ["ab"])
    assert list(robot.actions) == ["stays"]
    robot.arrive()
    robot.finish("stays")
    assert not robot.machine.busy


def test_the_content_of_the_stitching_node_is_that_of_the_first_order() -> None:
    robot = given(path("ab", "c", actions={"b": [action("first")]}))
    added = path("bc", first=2, update=1, actions={"b": [action("first"), action("second")]})
    error = robot.refuses(added)
    assert error.type == ErrorType.ORDER_UPDATE
    assert references(error)["actionId"] == "second"
    robot.give(path("bc", first=2, update=1, b=place(9.0)))
    assert robot.actions == {"first": "WAITING"}
    position = robot.machine.status.nodes[0].position
    assert position is not None
    assert position.x == 1.0


def test_an_action_of_the_horizon_cannot_move_to_the_stitching_node() -> None:
    robot = given(path("ab", "c", actions={"c": [action("pick")]}))
    error = robot.refuses(path("bc", first=2, update=1, actions={"b": [action("pick")]}))
    assert error.type == ErrorType.ORDER_UPDATE
    assert references(error)["actionId"] == "pick"
    assert robot.actions == {"pick": "WAITING"}


UPDATES = {
    "from the horizon": path("cd", first=4, update=1),
    "from the start": path("abc", update=1),
    "other sequenceId": path("bc", first=4, update=1),
    "other node": path("xc", first=2, update=1),
}


@pytest.mark.parametrize("update", UPDATES.values(), ids=UPDATES)
def test_an_update_that_does_not_begin_at_the_end_of_the_base_is_rejected(update: Order) -> None:
    robot = given(path("ab", "cd"))
    error = robot.refuses(update)
    assert error.type == ErrorType.ORDER_UPDATE
    assert references(error)["nodeId"] == update.nodes[0].id
    assert references(error)["orderUpdateId"] == "1"


@pytest.mark.parametrize("horizon", ["c", ""], ids=["that waits", "that has ended"])
def test_an_update_continues_an_order(horizon: str) -> None:
    robot = given(path("ab", horizon))
    robot.arrive()
    assert robot.machine.busy == bool(horizon)
    robot.give(path("bc", first=2, update=1))
    assert robot.legs == ["b", "c"]


def test_an_update_of_an_order_that_has_ended_must_begin_with_the_last_node() -> None:
    robot = given(path("ab"))
    robot.arrive()
    assert robot.refuses(path("ab", update=1)).type == ErrorType.ORDER_UPDATE


def test_an_update_with_a_used_id_of_an_action_is_rejected() -> None:
    robot = given(path("ab", "c", actions={"a": [action("1", BlockingType.NONE)]}))
    update = path("bc", first=2, update=1, actions={"c": [action("1")]})
    error = robot.refuses(update)
    assert error.type == ErrorType.VALIDATION
    assert references(error)["actionId"] == "1"


def test_a_cancelled_order_and_an_update_of_it_are_rejected() -> None:
    """In version 2.1, the order is known, and ignored."""
    order = path("a", "b")
    robot = given(order)
    robot.machine.cancel()
    robot.poll()
    for again in (order, path("ab", update=1)):
        assert robot.refuses(again).type == ErrorType.UPDATE_AFTER_CANCEL
    assert robot.machine.receive(order, is_3=False) is OrderKind.KNOWN
    robot.give(path("ab", order_id="next"))


def test_an_order_may_visit_a_node_twice() -> None:
    robot = given(path("aba"))
    robot.move(0.5, 1.0, 0.5)
    robot.arrive()
    assert (robot.last, robot.machine.status.last_node_sequence_id) == ("a", 4)


def test_a_node_at_the_place_of_the_last_one_is_reached_without_driving() -> None:
    robot = given(path("ab"))
    robot.arrive()
    update = path("bc", first=2, update=1, c=place(1.0), actions={"c": [action("pick")]})
    robot.give(update)
    assert robot.legs == ["b"]
    assert (robot.last, robot.actions) == ("c", {"pick": "INITIALIZING"})
