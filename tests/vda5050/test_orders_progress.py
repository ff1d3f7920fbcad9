"""Execution of orders by the state machine: legs, nodes, edges, actions, cancellation."""

from __future__ import annotations

import math

import pytest

from tests.vda5050.orders import Robot, action, at, given, path, place, references
from woosh_robot_agent.vda5050.messages.order import (
    BlockingType,
    ControlPoint,
    NodePosition,
    Order,
    Trajectory,
)
from woosh_robot_agent.vda5050.messages.state import ErrorLevel, ErrorType, Position
from woosh_robot_agent.vda5050.orders.legs import Control, Drive, Perform

NONE, SINGLE, SOFT, HARD = BlockingType


def line(start: float, end: float) -> Trajectory:
    """A straight trajectory along the line of the nodes."""
    return Trajectory(1, (0.0, 0.0, 1.0, 1.0), (ControlPoint(start, 0.0), ControlPoint(end, 0.0)))


def test_nodes_and_edges_are_removed_as_they_are_passed() -> None:
    robot = given(path("abcd", "e"))
    robot.move(0.9)
    assert (robot.last, robot.nodes, robot.edges) == ("b", "cdE", ["bc", "cd", "de"])
    assert robot.machine.status.last_node_sequence_id == 2
    robot.move(1.5, 2.1)
    assert (robot.last, robot.nodes, robot.edges) == ("c", "dE", ["cd", "de"])


def test_nodes_between_two_reports_are_passed_too() -> None:
    robot = given(path("abcd", b=place(0.3), c=place(0.6)))
    robot.jump(0.9)
    assert robot.last == "c"


@pytest.mark.parametrize(("deviation", "passed"), [(0.0, "a"), (0.6, "b")])
def test_a_node_beside_the_way_is_passed_within_its_permitted_deviation(
    deviation: float, passed: str
) -> None:
    robot = given(path("abc", b=place(1.0, y=0.5, deviation_xy=deviation)))
    robot.move(0.5, 1.0, 1.5)
    assert robot.last == passed
    robot.arrive()
    assert robot.last == "c"


def test_a_node_after_one_that_was_missed_is_passed_too() -> None:
    light = action("light", NONE)
    robot = given(path("abcde", b=place(1.0, y=0.6), actions={"b": [light]}))
    robot.move(0.5, 1.0, 1.5)
    assert (robot.last, robot.nodes) == ("a", "bcde")
    assert robot.move(2.0) == [Perform(light)]
    assert (robot.last, robot.nodes, robot.edges) == ("c", "de", ["cd", "de"])
    robot.move(2.5, 3.0)
    assert robot.last == "d"


THERE_AND_BACK = {"b": place(3.0), "c": place(2.0)}
WAYS: dict[str, tuple[dict[str, NodePosition], list[tuple[float, float]], str]] = {
    "on the way there": (THERE_AND_BACK, [(1.0, 0.0), (2.0, 0.0), (2.6, 0.0)], "a"),
    "there": (THERE_AND_BACK, [(1.0, 0.0), (2.0, 0.0), (2.8, 0.0)], "b"),
    "on the way back from a node that was missed": (
        THERE_AND_BACK | {"b": place(3.0, y=0.6)},
        [(1.0, 0.0), (2.0, 0.0), (2.9, 0.0), (2.5, 0.0), (2.0, 0.0)],
        "c",
    ),
    "a loop that ends beside its start": (
        {"b": place(3.0), "c": place(3.0, y=3.0), "d": place(0.0, y=0.2)},
        [(0.5, 0.0)],
        "a",
    ),
    "a wide deviation that includes the way to another node": (
        {"b": place(2.0), "c": place(4.0, deviation_xy=3.0)},
        [(0.5, 0.5), (1.0, -0.3), (1.2, 0.3), (1.5, 0.0)],
        "a",
    ),
}


@pytest.mark.parametrize(("nodes", "way", "passed"), WAYS.values(), ids=WAYS)
def test_a_later_node_is_passed_only_after_the_way_to_it(
    nodes: dict[str, NodePosition], way: list[tuple[float, float]], passed: str
) -> None:
    robot = given(path("abcde", **nodes))
    for x, y in way:
        robot.machine.moved(at(x, y))
        robot.poll()
    assert robot.last == passed


def test_a_jump_passes_no_node() -> None:
    light, speak = action("light", NONE), action("speak", NONE)
    robot = given(path("abcde", actions={"b": [light], "c": [speak]}))
    assert robot.jump(2.5) == []
    assert robot.last == "a"
    assert robot.move(2.4) == []
    assert robot.last == "a"
    robot.machine.drive_ended("the robot does not know the task")
    assert robot.poll() == []
    assert (robot.last, robot.actions) == ("a", {"light": "WAITING", "speak": "WAITING"})


def test_without_a_link_no_node_is_passed_until_the_robot_is_known_to_drive_on() -> None:
    robot = given(path("abcde", actions={"b": [action("light", NONE)]}))
    robot.move(0.5)
    robot.machine.route.link_lost()
    assert robot.jump(2.0) == []
    assert (robot.last, robot.actions) == ("a", {"light": "WAITING"})
    robot.machine.moved(at(2.1), confirmed=True)
    assert robot.machine.status.distance_since_last_node == pytest.approx(2.1)
    assert [type(each) for each in robot.move(2.2)] == [Perform]
    assert (robot.last, robot.nodes) == ("c", "de")


def test_actions_of_a_node_that_the_robot_has_left_far_behind_without_a_link_fail() -> None:
    lift, light = action("lift", NONE), action("light", NONE)
    robot = given(path("abcdef", actions={"b": [lift], "d": [light]}))
    robot.move(0.5)
    robot.machine.route.link_lost()
    robot.machine.moved(at(2.9), confirmed=True)
    assert robot.jump(3.0) == [Perform(light)]
    assert robot.last == "d"
    assert robot.actions == {"lift": "FAILED", "light": "INITIALIZING"}


CORNER = {"b": place(2.0), "c": place(4.0), "d": place(4.0, y=2.0), "e": place(4.0, y=4.0)}
FAR_AND_BACK = {"b": place(4.0), "c": place(3.0)}


@pytest.mark.parametrize(
    ("nodes", "back", "then", "passed"),
    [
        pytest.param(CORNER, (4.0, 1.9), (4.0, 2.1), "d", id="round a corner"),
        pytest.param(
            FAR_AND_BACK | {"d": place(0.0)}, (3.2, 0.0), (3.1, 0.0), "c", id="on the way back"
        ),
    ],
)
def test_without_a_link_a_later_node_is_passed_only_if_the_way_to_it_was_driven(
    nodes: dict[str, NodePosition],
    back: tuple[float, float],
    then: tuple[float, float],
    passed: str,
) -> None:
    robot = given(path("abcdef", **nodes))
    robot.move(0.5)
    robot.machine.route.link_lost()
    robot.machine.moved(at(*back), confirmed=True)
    assert robot.last == "a"
    robot.machine.moved(at(*then), confirmed=True)
    assert robot.last == passed


def test_the_end_of_a_leg_is_reached_when_the_drive_ends() -> None:
    robot = given(path("ab"))
    robot.move(0.95, 1.0)
    assert robot.last == "a"
    assert not robot.machine.status.new_base_request
    robot.arrive()
    assert (robot.last, robot.nodes, robot.edges) == ("b", "", [])
    assert not robot.machine.busy


AB, BC = {"ab": {"trajectory": line(0, 1)}}, {"bc": {"trajectory": line(1, 2)}}
LEGS = {
    "the end of the base": (path("abcd", "e"), "bcd"),
    "a heading": (path("abc", b=place(1.0, theta=1.0)), "b"),
    "any heading": (path("abc", b=place(1.0, theta=1.0, deviation_theta=math.pi)), "bc"),
    "a hard action": (path("abc", actions={"b": [action("1", HARD)]}), "b"),
    "a soft action": (path("abc", actions={"b": [action("1", SOFT)]}), "b"),
    "an action while driving": (path("abc", actions={"b": [action("1", NONE)]}), "bc"),
    "a soft action on the edge": (path("abc", actions={"bc": [action("1", SOFT)]}), "b"),
    "the end of a trajectory": (path("abc", edges=AB), "b"),
    "the begin of a trajectory": (path("abc", edges=BC), "b"),
    "two trajectories": (path("abc", edges=AB | BC), "bc"),
}


@pytest.mark.parametrize(("order", "legs"), LEGS.values(), ids=LEGS)
def test_where_a_leg_ends(order: Order, legs: str) -> None:
    assert given(order).legs == [legs]


def test_a_long_order_is_driven_in_parts() -> None:
    names = "".join(chr(ord("a") + index) for index in range(400))
    robot = given(path(names))
    assert len(robot.drives[0].leg.nodes) == 150
    robot.arrive()
    assert len(robot.drives[1].leg.nodes) == 150


def test_the_next_leg_begins_when_the_blocking_action_has_ended() -> None:
    robot = given(path("abc", actions={"b": [action("pick")]}))
    assert robot.arrive() == [Perform(action("pick"))]
    assert robot.actions == {"pick": "INITIALIZING"}
    robot.finish("pick")
    assert robot.legs == ["b", "c"]
    assert robot.actions == {"pick": "FINISHED"}


def test_a_blocking_action_of_an_edge_ends_before_the_vehicle_drives() -> None:
    robot = given(path("ab", actions={"ab": [action("lift", SOFT)]}))
    assert (robot.legs, robot.actions) == ([], {"lift": "INITIALIZING"})
    robot.finish("lift")
    assert robot.legs == ["b"]


def test_actions_wait_for_each_other_by_their_blocking_types() -> None:
    actions = [action("1", NONE), action("2", SOFT), action("3", HARD), action("4", SINGLE)]
    robot = given(path("ab", actions={"a": actions}))
    assert robot.legs == []
    assert robot.actions == {
        "1": "INITIALIZING",
        "2": "INITIALIZING",
        "3": "WAITING",
        "4": "WAITING",
    }
    robot.finish("1")
    assert robot.actions["3"] == "WAITING"
    robot.finish("2")
    assert (robot.actions["3"], robot.actions["4"]) == ("INITIALIZING", "WAITING")
    robot.finish("3")
    assert robot.actions["4"] == "INITIALIZING"
    assert robot.legs == ["b"]


def test_an_action_of_an_edge_that_could_not_start_fails_at_its_end() -> None:
    actions = {"a": [action("long", NONE)], "ab": [action("alone", SINGLE)]}
    robot = given(path("abc", actions=actions))
    robot.move(1.0)
    assert robot.actions == {"long": "INITIALIZING", "alone": "FAILED"}


def test_a_new_base_is_requested_near_its_end_only() -> None:
    far = {name: place(5.0 * index) for index, name in enumerate("abcd")}
    robot = given(path("abc", "d", **far))
    robot.move(4.0)
    assert not robot.machine.status.new_base_request
    robot.move(5.0)
    assert robot.last == "b"
    assert robot.machine.status.new_base_request
    robot.arrive()
    assert robot.machine.status.new_base_request
    robot.give(path("cd", first=4, update=1, **far))
    assert not robot.machine.status.new_base_request


def test_a_new_base_is_requested_before_its_last_edge_if_that_is_short() -> None:
    robot = given(path("abcdef", "g"))
    assert not robot.machine.status.new_base_request
    robot.move(1.9, 2.1)
    assert (robot.last, robot.nodes) == ("c", "defG")
    assert robot.machine.status.new_base_request


def test_the_distance_since_the_last_node_is_that_of_the_way() -> None:
    robot = Robot()
    assert robot.machine.status.distance_since_last_node is None
    robot.give(path("abc"))
    assert robot.machine.status.distance_since_last_node == 0.0
    robot.machine.moved(at(0.3))
    robot.machine.moved(at(0.3, 0.4))
    assert robot.machine.status.distance_since_last_node == pytest.approx(0.7)
    robot.move(1.0)
    assert robot.machine.status.distance_since_last_node == 0.0


def test_the_speed_limit_is_that_of_the_edge_and_begins_before_a_slower_one() -> None:
    robot = given(
        path(
            "abcd",
            edges={"ab": {"max_speed": 0.8}, "bc": {"max_speed": 0.3}},
            b=place(4.0),
            c=place(8.0),
            d=place(12.0),
        )
    )
    limits: list[float | None] = []
    for x in (0.0, 2.0, 3.0, 4.5, 7.0, 8.5):
        robot.move(x)
        limits.append(robot.machine.speed_limit)
    assert limits == [0.8, 0.8, 0.3, 0.3, 0.3, math.inf]
    robot.arrive()
    assert robot.machine.speed_limit is None


@pytest.mark.parametrize(
    "order",
    [
        path("xc", order_id="next", x=place(0.5), c=place(2.0)),
        path("ac", order_id="next", a=place(0.0, deviation_xy=0.6)),
    ],
    ids=["where the vehicle stands", "at the last node with a wide deviation"],
)
def test_where_an_order_starts_after_a_cancellation(order: Order) -> None:
    robot = given(path("abc"))
    robot.move(0.5)
    robot.machine.cancel()
    robot.poll()
    robot.machine.drive_ended("cancelled")
    robot.poll()
    robot.give(order)
    assert (robot.last, robot.legs[-1]) == (order.nodes[0].id, "c")


def test_a_drive_that_fails_ends_the_order_until_it_is_cancelled() -> None:
    robot = given(path("ab", "c"))
    robot.machine.drive_ended("the task failed")
    robot.poll()
    error = robot.machine.error
    assert error is not None
    assert (error.type, error.level) == (ErrorType.DRIVING, ErrorLevel.CRITICAL)
    assert references(error) == {"orderId": "order", "nodeId": "b", "edgeId": "ab"}
    assert robot.machine.busy
    robot.give(path("bc", first=2, update=1))
    assert robot.legs == ["b"]
    assert robot.machine.error == error
    robot.machine.cancel()
    robot.poll()
    assert (robot.machine.error, robot.machine.busy) == (None, False)


def test_an_action_whose_end_is_unknown_leaves_no_error_of_a_cancelled_order() -> None:
    robot = given(path("a", actions={"a": [action("step")]}))
    robot.machine.cancel()
    robot.machine.interrupt("step")
    robot.finish("step")
    assert (robot.machine.error, robot.machine.busy) == (None, False)


@pytest.mark.parametrize(("found", "goes_on"), [(0.9, True), (4.0, False)])
def test_a_drive_that_has_lost_its_position_goes_on_only_where_it_stopped(
    found: float, goes_on: bool
) -> None:
    robot = given(path("abcdef"))
    robot.move(0.5)
    robot.machine.position_lost()
    assert robot.poll() == [Control.PAUSE]
    robot.machine.position_lost()
    assert robot.jump(found) == ([Control.RESUME] if goes_on else [])
    assert (robot.machine.error is None) == goes_on


def test_a_hold_pauses_the_drive_and_starts_none_until_all_are_released() -> None:
    robot = given(path("abc", b=place(1.0, theta=0.0)))
    robot.machine.holds.add("pause")
    robot.machine.holds.add("key")
    assert robot.poll() == [Control.PAUSE]
    robot.machine.holds.discard("pause")
    assert robot.poll() == []
    robot.machine.holds.discard("key")
    assert robot.poll() == [Control.RESUME]
    robot.machine.holds.add("pause")
    robot.poll()
    assert robot.arrive() == []
    robot.machine.holds.discard("pause")
    robot.poll()
    assert robot.legs == ["b", "c"]


def test_the_speed_limit_holds_also_after_a_node_that_was_missed() -> None:
    edges = {"bc": {"max_speed": 0.2}}
    robot = given(path("abc", b=place(1.0, y=0.6), c=place(9.0), edges=edges))
    robot.move(2.0, 4.0)
    assert robot.last == "a"
    assert robot.machine.speed_limit == 0.2


ROOF = [at(1.0, map_id="roof"), at(9.0, map_id="roof"), at(9.0)]


@pytest.mark.parametrize(
    "places",
    # it may stand a bit beside its node; and a change of the map hides no move
    [[at(1.2), at(9.0)], ROOF],
    ids=["on the same map", "by way of another map"],
)
def test_a_vehicle_that_somebody_has_moved_away_does_not_go_on(places: list[Position]) -> None:
    robot = given(path("ab", "c"))
    robot.arrive()
    for each in places:
        robot.machine.moved(each)
    robot.give(path("bc", first=2, update=1))
    assert robot.legs == ["b"]
    assert robot.machine.error is not None
    assert robot.machine.error.type == ErrorType.INTERRUPTED.value


def test_a_vehicle_that_its_own_actions_have_moved_goes_on() -> None:
    robot = given(path("ab", "c"))
    robot.arrive()
    robot.machine.moved(at(1.9), by_action=True)
    robot.machine.moved(at(1.95))
    robot.give(path("bc", first=2, update=1))
    assert robot.legs == ["b", "c"]


def test_a_trajectory_that_begins_far_away_is_not_driven() -> None:
    robot = Robot()
    robot.machine.moved(at(-3.0))
    robot.give(path("ab", a=place(0.0, deviation_xy=5.0), edges={"ab": {"trajectory": line(0, 1)}}))
    assert robot.legs == []
    assert robot.machine.error is not None
    assert "begins 3.0 m away" in robot.machine.error.description


def test_a_trajectory_that_leads_back_to_its_start_is_driven() -> None:
    square = Trajectory(
        1,
        (0.0, 0.0, 0.3, 0.6, 1.0, 1.0),
        tuple(ControlPoint(x, y) for x, y in ((0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 0.0))),
    )
    robot = given(path("ab", b=place(0.0), edges={"ab": {"trajectory": square}}))
    assert (robot.legs, robot.last) == (["b"], "a")


def test_a_drive_that_was_not_sent_is_commanded_again() -> None:
    robot = given(path("ab"))
    robot.machine.drive_unsent()
    assert robot.machine.poll(may_drive=False) == []
    assert [type(each) for each in robot.machine.poll()] == [Drive]


def test_a_lost_link_is_no_reason_to_doubt_where_an_action_has_moved_the_vehicle() -> None:
    robot = given(path("ab", actions={"a": [action("step")]}))
    robot.machine.route.must_check_place = True  # the link was lost and is back
    robot.machine.moved(at(0.5), by_action=True)
    robot.poll()
    robot.finish("step")
    assert robot.legs == ["b"]
