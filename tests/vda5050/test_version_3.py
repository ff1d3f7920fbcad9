"""Version 3.0: its messages, and a vehicle that speaks it."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import pytest

from tests.asynchronous import eventually
from tests.quick_chassis import set_speed
from tests.vda5050.conftest import EXEC, Site, task_to
from tests.vda5050.master import (
    START,
    Message,
    action,
    error_types,
    header,
    node,
    plain_edges,
    references,
)
from tests.vda5050.samples import FACTSHEET, LINE, ORDER, ROBOT, STATE
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ActionOrder
from woosh_robot_agent.pb.util import action_pb2
from woosh_robot_agent.simulator import SimulatedChassis
from woosh_robot_agent.simulator.world.geometry import Pose
from woosh_robot_agent.vda5050.messages.geometry import curve_defect, path_ahead
from woosh_robot_agent.vda5050.messages.order import Ellipse, NodePosition, Order
from woosh_robot_agent.vda5050.messages.reading import defect, read_order, refusal_of_zone_set
from woosh_robot_agent.vda5050.messages.state import (
    Battery,
    ConnectionState,
    ErrorLevel,
    ErrorType,
    OperatingMode,
    Position,
    RejectedError,
    VehicleError,
    warning,
)
from woosh_robot_agent.vda5050.messages.versions import V3_0 as V3
from woosh_robot_agent.vda5050.messages.versions import (
    VERSIONS,
    Identity,
    Version,
)
from woosh_robot_agent.vda5050.messages.writing import (
    connection_message,
    factsheet_message,
    state_message,
    visualization_message,
)
from woosh_robot_agent.vda5050.orders.reach import is_reached

VEHICLE = Identity("Woosh", "30001")
BOTH = pytest.mark.parametrize("version", list(VERSIONS.values()), ids=list(VERSIONS))


def _edges(nodes: list[Message]) -> list[Message]:
    """Edges between the nodes, as version 3.0 has them."""
    names = ("startNodeId", "endNodeId")
    return [{key: edge[key] for key in edge if key not in names} for edge in plain_edges(nodes)]


def _full(version: Version, content: Message) -> Message:
    return header(version.number) | content


def _order(*, order: dict[str, Any] | None = None, edge: dict[str, Any] | None = None) -> Message:
    """An order of two nodes."""
    nodes = [node("a", 0, 0.0, 0.0), node("b", 2, 1.0, 0.0)]
    edges = [each | (edge or {}) for each in _edges(nodes)]
    content = {"orderId": "order", "orderUpdateId": 0, "nodes": nodes, "edges": edges}
    return _full(V3, content | (order or {}))


def _one_node(deviation: object) -> Message:
    """An order of a node with a permitted deviation."""
    nodes = [node("a", 0, 0.0, 0.0, allowedDeviationXY=deviation)]
    return _order(order={"nodes": nodes, "edges": []})


def _read(message: Message) -> Order:
    return read_order(json.dumps(message).encode(), V3, VEHICLE)


# Messages


@BOTH
def test_complete_messages_fit_the_schemas(version: Version) -> None:
    robots = [replace(ROBOT, mode=mode) for mode in OperatingMode]
    states = [state_message(version, replace(STATE, robot=robot)) for robot in robots]
    contents = [
        *(("state", each) for each in states),
        ("visualization", visualization_message(version, ROBOT, 3)),
        ("factsheet", factsheet_message(version, FACTSHEET)),
        *(("connection", connection_message(version, each)) for each in ConnectionState),
    ]
    for topic, content in contents:
        assert defect(version.number, topic, _full(version, content)) is None


def test_instant_actions_have_a_list_of_their_own() -> None:
    content = state_message(V3, STATE)
    assert [each["actionId"] for each in content["actionStates"]] == ["1"]
    assert [each["actionId"] for each in content["instantActionStates"]] == ["2"]
    assert content["actionStates"][0]["actionStatus"] == "PAUSED"


@pytest.mark.parametrize(
    ("kind", "name", "level"),
    [
        (ErrorType.VALIDATION, "VALIDATION_FAILURE", "WARNING"),
        (ErrorType.UNSUPPORTED_PARAMETER, "UNSUPPORTED_PARAMETER", "CRITICAL"),
        (ErrorType.ORDER_ACTION, "INVALID_ORDER_ACTION", "WARNING"),
        (ErrorType.OUTDATED_UPDATE, "OUTDATED_ORDER_UPDATE", "WARNING"),
        (ErrorType.CHANGED_UPDATE, "SAME_ORDER_UPDATE_ID", "WARNING"),
        (ErrorType.UPDATE_AFTER_CANCEL, "ORDER_UPDATE_FOLLOWING_CANCEL", "WARNING"),
        (ErrorType.OTHER_ORDER_ACTIVE, "OTHER_ORDER_ACTIVE", "WARNING"),
        (ErrorType.NO_ROUTE, "START_NODE_OUT_OF_RANGE", "WARNING"),
        (ErrorType.UNKNOWN_MAP, "UNKNOWN_MAP_ID", "WARNING"),
        (ErrorType.NO_ORDER_TO_CANCEL, "NO_ORDER_TO_CANCEL", "WARNING"),
        (ErrorType.INSTANT_ACTION, "INVALID_INSTANT_ACTION", "WARNING"),
        (ErrorType.DRIVING, "NODE_UNREACHABLE", "CRITICAL"),
    ],
)
def test_errors_have_the_predefined_types_and_levels(
    kind: ErrorType, name: str, level: str
) -> None:
    text, hint = "slower than maxSpeed", "place it with initPosition"
    state = replace(STATE, errors=(warning(kind, text, hint, parameter="maxSpeed"),))
    (error,) = state_message(V3, state)["errors"]
    assert error["errorDescription"] == "slower than maximumSpeed"
    assert error["errorHint"] == "place it with initializePosition"
    assert (error["errorType"], error["errorLevel"]) == (name, level)
    assert error["errorReferences"] == [
        {"referenceKey": "parameter", "referenceValue": "maximumSpeed"}
    ]


def test_the_rejection_for_the_operating_mode_ends_with_the_mode() -> None:
    errors = (warning(ErrorType.NOT_AVAILABLE, "not automatic"),)
    manual = replace(STATE, errors=errors, robot=replace(ROBOT, mode=OperatingMode.MANUAL))
    assert error_types(state_message(V3, manual)) == ["MOBILE_ROBOT_NOT_AVAILABLE"]
    assert error_types(state_message(V3, replace(manual, robot=ROBOT))) == []
    lost = replace(ROBOT, position=Position(0.0, 0.0, 0.0, "hall", initialised=False))
    assert error_types(state_message(V3, replace(manual, robot=lost))) == [
        "MOBILE_ROBOT_NOT_AVAILABLE",
        "LOCALIZATION_ERROR",
    ]


def test_a_robot_without_position_is_a_fatal_error() -> None:
    place = Position(0.0, 0.0, math.pi, "hall", initialised=False)
    content = state_message(V3, replace(STATE, errors=(), robot=replace(ROBOT, position=place)))
    (error,) = content["errors"]
    assert (error["errorType"], error["errorLevel"]) == ("LOCALIZATION_ERROR", "FATAL")
    assert content["mobileRobotPosition"]["localized"] is False
    nowhere = replace(STATE, errors=(), robot=replace(ROBOT, position=None))  # on no map
    assert error_types(state_message(V3, nowhere)) == ["LOCALIZATION_ERROR"]


@pytest.mark.parametrize("version", VERSIONS)
def test_an_interrupted_order_forbids_no_other_order(version: str) -> None:
    error = VehicleError("interruptedError", ErrorLevel.CRITICAL, "the robot was moved")
    (written,) = state_message(VERSIONS[version], replace(STATE, errors=(error,)))["errors"]
    assert written["errorLevel"] == {"2.1": "FATAL", "3.0": "CRITICAL"}[version]


@BOTH
def test_the_health_of_the_battery_is_an_integer(version: Version) -> None:
    battery = Battery(50.0, charging=False, health=96.6)
    content = state_message(version, replace(STATE, robot=replace(ROBOT, battery=battery)))
    health = content[version.name("batteryState")]["batteryHealth"]
    assert (health, type(health)) == (97, int)


@BOTH
def test_the_factsheet_tells_the_minimum_height(version: Version) -> None:
    parameters = factsheet_message(version, FACTSHEET)["physicalParameters"]
    assert parameters[version.name("heightMin")] == FACTSHEET.height


@BOTH
def test_a_rounded_heading_stays_within_the_schema(version: Version) -> None:
    for theta in (3.141593, -3.141593):
        place = Position(0.0, 0.0, theta, "hall", initialised=True)
        state = replace(STATE, robot=replace(ROBOT, position=place))
        message = _full(version, state_message(version, state))
        assert defect(version.number, "state", message) is None


def test_the_planned_path_begins_at_the_robot() -> None:
    points = state_message(V3, STATE)["plannedPath"]["trajectory"]["controlPoints"]
    assert points == [{"x": 0.1, "y": 0.0}, {"x": 1.0, "y": 0.0}]
    idle = replace(STATE, order=replace(ORDER, nodes=(), edges=()))
    assert "plannedPath" not in state_message(V3, idle)
    assert "plannedPath" not in state_message(V3, replace(STATE, robot=replace(ROBOT, path=())))


# The path ahead


def test_the_path_ahead_leaves_out_what_is_behind_and_what_is_straight() -> None:
    bend = [(0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (3.0, 0.0), (3.0, 1.0), (3.0, 2.0)]
    assert path_ahead(bend, (1.2, 0.01)) == [(1.2, 0.01), (3.0, 0.0), (3.0, 2.0)]
    assert path_ahead(bend, (3.0, 2.0)) == []
    assert path_ahead(bend, (0.0, 5.0)) == []
    assert path_ahead([], (0.0, 0.0)) == []


# Orders


def test_an_edge_has_a_speed_and_a_trajectory_with_defaults() -> None:
    points = [{"x": 0.0, "y": 0.0}, {"x": 1.0, "y": 0.0}]
    given = {"maximumSpeed": 0.4, "trajectory": {"controlPoints": points}}
    (edge,) = _read(_order(edge=given)).edges
    assert (edge.start_node_id, edge.end_node_id) == ("a", "b")
    assert (edge.max_speed, edge.trajectory, edge.unsupported) == (0.4, LINE, ())
    three = {"degree": 1, "controlPoints": [*points, {"x": 2.0, "y": 0.0}]}
    trajectory = _read(_order(edge={"trajectory": three})).edges[0].trajectory
    assert trajectory is not None
    assert trajectory.knots == (0.0, 0.0, 0.5, 1.0, 1.0)


def test_a_huge_degree_without_knots_is_refused() -> None:
    points = [{"x": 0.0, "y": 0.0}, {"x": 1.0, "y": 0.0}]
    huge = {"degree": 2**53, "controlPoints": points}
    trajectory = _read(_order(edge={"trajectory": huge})).edges[0].trajectory
    assert trajectory is not None
    assert "its degree is above 5" in curve_defect(trajectory)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("corridor", {"leftWidth": 1.0, "rightWidth": 1.0}),
        ("direction", "left"),
        ("maximumMobileRobotHeight", 2.0),
        ("minimumLoadHandlingDeviceHeight", 0.1),
        ("maximumRotationSpeed", 1.0),
        ("orientation", 1.0),
        ("reachOrientationBeforeEntering", True),
    ],
)
def test_what_the_robot_cannot_obey_is_refused(field: str, value: Any) -> None:
    assert _read(_order(edge={field: value})).edges[0].unsupported == (field,)


def test_actions_that_must_be_retriable_are_refused() -> None:
    retriable = action("pick") | {"retriable": True}
    assert _read(_order(edge={"actions": [retriable]})).unsupported == ("retriable",)
    final = action("pick") | {"retriable": False}
    assert _read(_order(edge={"actions": [final]})).unsupported == ()


def test_a_deviation_is_an_ellipse_that_turns_by_a_quarter_turn_at_most() -> None:
    with pytest.raises(RejectedError, match=r"nodes\.0\.nodePosition\.allowedDeviationXY"):
        _read(_one_node(0.5))  # a number, as in version 2
    for theta, fits in ((-1.5707963, True), (1.571, False)):
        found = defect(V3.number, "order", _one_node({"a": 2.0, "b": 1.0, "theta": theta}))
        assert (found is None) == fits
        assert fits or "allowedDeviationXY.theta" in str(found)


def test_the_blocking_type_of_instant_actions_is_none() -> None:
    for blocking in ("NONE", "HARD"):
        message = _full(V3, {"actions": [action("stateRequest", blocking=blocking)]})
        found = defect(V3.number, "instantActions", message)
        assert (found is None) == (blocking == "NONE")
        assert blocking == "NONE" or "actions.0.blockingType" in str(found)


def test_the_kinematics_are_required_by_the_name_of_the_text_and_that_of_the_schema() -> None:
    for name in ("mobileRobotKinematics", "mobileRobotKinematic"):
        message = _full(V3, factsheet_message(V3, FACTSHEET))
        assert defect(V3.number, "factsheet", message) is None
        del message["typeSpecification"][name]
        assert name in str(defect(V3.number, "factsheet", message))


def test_the_deviation_is_an_ellipse() -> None:
    order = _one_node({"a": 2.0, "b": 0.5, "theta": math.pi / 2})
    place = _read(order).nodes[0].position
    assert place is not None
    assert place.ellipse == Ellipse(2.0, 0.5, math.pi / 2)

    def reaches(x: float, y: float) -> bool:
        here = Position(x, y, 0.0, "wooshmap", initialised=True)
        return is_reached(place, None, here)

    assert reaches(0.0, 1.9)
    assert not reaches(0.0, 2.1)
    assert reaches(0.4, 0.0)
    assert not reaches(0.6, 0.0)
    assert not reaches(0.4, 1.9)


def test_a_way_through_an_ellipse_reaches_the_node() -> None:
    place = NodePosition(5.0, 5.0, "hall", deviation_xy=0.5, ellipse=Ellipse(1.0, 0.5, 0.0))
    before = Position(4.2, 3.0, 0.0, "hall", initialised=True)
    after = Position(4.2, 7.0, 0.0, "hall", initialised=True)
    assert is_reached(place, before, after)
    assert not is_reached(place, before, before)


# Zone sets


def _zone_set() -> Message:
    corners = [{"x": 0.0, "y": 0.0}, {"x": 1.0, "y": 0.0}, {"x": 1.0, "y": 1.0}]
    zones = [{"zoneId": "door", "zoneType": "BLOCKED", "vertices": corners}]
    return {"zoneSet": {"mapId": "wooshmap", "zoneSetId": "night", "zones": zones}}


def test_a_zone_set_is_refused() -> None:
    error = refusal_of_zone_set(json.dumps(_full(V3, _zone_set())).encode(), V3, VEHICLE)
    assert error.type == ErrorType.UNSUPPORTED_PARAMETER
    assert dict(error.references)["zoneSetId"] == "night"
    assert refusal_of_zone_set(b"{", V3, VEHICLE).type == ErrorType.VALIDATION


# A vehicle


async def test_an_order_of_three_nodes_is_driven(site: Site) -> None:
    async with site.online(version=V3) as master:
        assert master.state["version"] == "3.0.0"
        assert master.state["operatingMode"] == "AUTOMATIC"
        assert master.state["powerSupply"]["charging"] is False
        assert master.state["mobileRobotPosition"]["localized"] is True
        assert "batteryState" not in master.state

        nodes = [
            node("a", 0, *START),
            node("b", 2, 6.0, -7.0),
            node("c", 4, 7.0, -7.0, theta=0.5, allowedDeviationTheta=0.0),
        ]
        set_speed(site.chassis, 1.0)  # so that no state is missed
        master.order(nodes, _edges(nodes))
        accepted = await master.accepted("order")
        assert accepted["lastNodeId"] == "a"
        await master.wait_state(lambda state: "plannedPath" in state, "a planned path")
        set_speed(site.chassis, 20.0)
        await master.reached("c")
        ended = await master.wait_state(lambda state: not state["driving"])

        assert ended["nodeStates"] == ended["edgeStates"] == ended["errors"] == []
        assert "plannedPath" not in ended
    pose = site.chassis.state.pose
    assert (pose.x, pose.y, pose.theta) == pytest.approx((7.0, -7.0, 0.5), abs=0.05)

    sent = {each["headerId"] for each in site.recorder.sent("state")}
    seen = {each["referenceStateHeaderId"] for each in site.recorder.sent("visualization")}
    assert seen
    assert seen <= sent
    assert {name.split("/")[1] for name, _ in site.recorder.messages} == {"v3"}


async def test_rejections_have_the_predefined_errors(site: Site) -> None:
    async with site.online(version=V3) as master:
        nodes = [node("a", 0, *START), node("b", 2, 6.0, -7.0, released=False)]
        corridor = {"leftWidth": 1.0, "rightWidth": 1.0}
        master.order(nodes, [each | {"corridor": corridor} for each in _edges(nodes)])
        state = await master.error("UNSUPPORTED_PARAMETER")
        (error,) = state["errors"]
        assert error["errorLevel"] == "CRITICAL"
        assert references(error)["parameter"] == "corridor"
        master.order(nodes, _edges(nodes), update=1)  # an update without its order
        await master.error("INVALID_ORDER")
        master.send("zoneSet", _zone_set())
        state = await master.error("UNSUPPORTED_PARAMETER")
        assert state["orderId"] == ""

        master.order(nodes, _edges(nodes))
        await master.wait_state(lambda state: state["orderId"] == "order" and not state["errors"])
        master.order([node("a", 0, *START)], [], order_id="other")
        await master.error("OTHER_ORDER_ACTIVE")


async def test_instant_actions_stay_in_the_state_after_a_new_order(site: Site) -> None:
    async with site.online(version=V3) as master:
        master.instant(action("stateRequest", "ask"), action("fly", "no"))
        state = await master.wait_state(lambda state: len(state["instantActionStates"]) == 2)
        state = await master.wait_state(
            lambda state: state["instantActionStates"][0]["actionStatus"] == "FINISHED"
        )
        assert state["actionStates"] == []
        assert state["instantActionStates"][1]["actionStatus"] == "FAILED"
        assert error_types(state) == ["INVALID_INSTANT_ACTION"]

        master.order([node("a", 0, *START)], [])
        state = await master.accepted("order")
        assert [each["actionId"] for each in state["instantActionStates"]] == ["ask", "no"]
        assert state["errors"] == []


@BOTH
def test_whole_numbers_with_a_decimal_point_are_integers(version: Version) -> None:
    nodes = [node("a", 0.0, 0.0, 0.0), node("b", 2.0, 1.0, 0.0)]  # type: ignore[arg-type]
    points = [{"x": 0.0, "y": 0.0}, {"x": 1.0, "y": 0.0}]
    line = {"degree": 1.0, "knotVector": [0, 0, 1, 1], "controlPoints": points}
    edges = _edges(nodes) if version.number == V3.number else plain_edges(nodes)
    edges[0]["trajectory"] = line
    content = {"orderId": "order", "orderUpdateId": 1.0, "nodes": nodes, "edges": edges}
    order = read_order(json.dumps(_full(version, content)).encode(), version, VEHICLE)
    assert order.edges[0].trajectory is not None
    numbers = [order.update_id, order.edges[0].trajectory.degree]
    numbers += [each.sequence_id for each in (*order.nodes, *order.edges)]
    assert [type(each) for each in numbers] == [int] * 5


@pytest.mark.parametrize("away", [0.0, 3.0], ids=["the same place", "elsewhere"])
async def test_a_drive_waits_while_the_robot_does_not_know_its_position(
    site: Site, away: float
) -> None:
    """It goes on only if the robot is found where it stopped."""

    def find(simulator: SimulatedChassis) -> None:
        pose = simulator.chassis.pose
        simulator.chassis.localise(Pose(pose.x + away, pose.y, pose.theta))

    async with site.online(version=V3) as master:
        nodes = [node("a", 0, *START), node("b", 2, 9.0, -7.0)]
        set_speed(site.chassis, 1.0)
        master.order(nodes, _edges(nodes))
        await eventually(lambda: site.chassis.state.pose.x > START[0] + 0.3)
        site.chassis.call(lambda simulator: setattr(simulator.chassis.readiness, "located", False))
        await master.error("LOCALIZATION_ERROR")
        await eventually(lambda: site.chassis.state.velocity.speed == 0.0)
        lost = await master.wait_state(lambda state: not state["driving"])
        assert [each["nodeId"] for each in lost["nodeStates"]] == ["b"]
        site.chassis.call(find)
        if away:
            found = await master.error("INTERRUPTED_ERROR")
            assert found["nodeStates"]
            assert site.chassis.state.velocity.speed == 0.0
        else:
            set_speed(site.chassis, 20.0)
            await master.wait_state(lambda state: not state["errors"])
            master.instant(action("stopPause", "r"))  # the robot has paused its task itself
            await master.reached("b")
    assert site.chassis.counts[EXEC] == 1


async def test_a_planned_path_is_that_of_the_order(site: Site) -> None:
    async with site.online(version=V3) as master, site.other_client() as gate:
        set_speed(site.chassis, 1.0)
        assert (await gate.request(task_to(9.0, -7.0))).ok
        await master.wait_state(lambda state: state["driving"])
        wide = {"a": 9.0, "b": 9.0, "theta": 0.0}
        nodes = [node("a", 0, *START, allowedDeviationXY=wide), node("b", 2, 4.0, -8.0)]
        master.order(nodes, _edges(nodes))
        await master.error("ROBOT_BUSY_ERROR")
        await eventually(lambda: site.chassis.state.pose.x > START[0] + 1.0)
        master.instant(action("stateRequest"))
        await master.wait_state(lambda state: state["instantActionStates"])
    assert not [each for each in site.recorder.sent("state") if "plannedPath" in each]


async def test_errors_last_as_long_as_the_standard_says(site: Site) -> None:
    async with site.online(version=V3) as master:
        master.instant(action("fly"), action("stateRequest"))
        await master.error("INVALID_INSTANT_ACTION")
        master.instant(action("cancelOrder"))
        await master.error("NO_ORDER_TO_CANCEL")
        assert error_types(master.state) == ["NO_ORDER_TO_CANCEL"]

        await master.wait_state(lambda state: state.get("maps"))
        link = "http://127.0.0.1:1/x.zip"
        for name, version in (("same", "12"), ("other", "99")):
            given = {"mapId": "scenex", "mapVersion": version, "mapDownloadLink": link}
            master.instant(action("downloadMap", name, **given))
        state = await master.error("ACTION_ERROR")
        (error,) = [each for each in state["errors"] if each["errorType"] == "DUPLICATE_MAP"]
        assert references(error) == {
            "actionId": "same",
            "actionType": "downloadMap",
            "mapId": "scenex",
            "mapVersion": "12",
        }
        master.instant(action("enableMap", mapId="nowhere", mapVersion="1"))
        await master.wait_state(lambda state: "DUPLICATE_MAP" not in error_types(state))
        master.instant(action("clearInstantActions"))
        await master.wait_state(lambda state: "ACTION_ERROR" not in error_types(state))
        assert error_types(master.state) == ["NO_ORDER_TO_CANCEL"]

        nodes = [node("a", 0, *START), node("b", 2, 8.0, -7.5)]
        set_speed(site.chassis, 1.0)
        master.order(nodes, _edges(nodes))
        await master.wait_state(lambda state: state["driving"] and not state["errors"])
        async with site.other_client() as gate:
            assert (await gate.request(ActionOrder(order=action_pb2.kCancel))).ok
        await master.error("NODE_UNREACHABLE")
        master.instant(action("cancelOrder"))
        state = await master.wait_state(lambda state: not state["nodeStates"])
        assert error_types(state) == ["NODE_UNREACHABLE"]
        master.order(nodes, _edges(nodes))  # the cancelled order again
        await master.error("ORDER_UPDATE_FOLLOWING_CANCEL")
