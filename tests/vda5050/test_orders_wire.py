"""Orders through a real broker to a vehicle of a simulated chassis."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import pytest

from tests.asynchronous import eventually
from tests.quick_chassis import edit_bodies, set_speed
from tests.vda5050.chassis_events import received
from tests.vda5050.conftest import Site
from tests.vda5050.master import (
    START,
    Master,
    Message,
    action,
    edge,
    node,
    nodes_left,
    references,
)
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.pb.map.map_pack_pb2 import SceneData
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ChangeNavMode, ExecTask
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed
from woosh_robot_agent.simulator.world.geometry import Pose

X, Y = START
STEP = 0.8


async def seen(master: Master, condition: Callable[[Message], Any]) -> Message:
    """Wait for a state that fulfils a condition, which the last state need not do any more."""

    def found() -> Message | None:
        return next(filter(condition, master.received["state"]), None)

    state: Message = await eventually(found)
    return state


def line(names: str, *, released: int, first: int = 0) -> list[Message]:
    """Nodes along a straight line from the start; the place follows from the sequence id."""
    return [
        node(name, 2 * (first + index), X + (first + index) * STEP, Y, released=index < released)
        for index, name in enumerate(names)
    ]


async def test_the_connection_is_reported_and_the_factsheet_kept(site: Site) -> None:
    async with Master(site.broker.port) as master:
        async with site.vehicle():
            await master.online()
        await eventually(lambda: master.last("connection")["connectionState"] == "OFFLINE")
    await eventually(lambda: len(site.recorder.sent("connection")) == 2)
    first, last = site.recorder.sent("connection")
    assert (first["connectionState"], last["connectionState"]) == ("ONLINE", "OFFLINE")
    assert (first["headerId"], last["headerId"]) == (0, 1)  # the one of the last will is free again
    async with Master(site.broker.port) as late:
        await eventually(lambda: late.last("factsheet"))
        assert late.last("connection")["connectionState"] == "OFFLINE"


async def test_the_example_of_the_standard_is_extended_while_it_is_driven(site: Site) -> None:
    """The order of figures 4 and 5 and its update, with the loop of six nodes laid on a line."""
    async with site.online() as master:
        usual = site.chassis.call(lambda sim: sim.speed)
        set_speed(site.chassis, 0.05)  # the first state is reported before the robot passes a node
        master.order(line("fdgbh", released=3), order_id="1234")
        first = await seen(master, lambda state: state["orderId"] == "1234")
        assert first["lastNodeId"] == "f"
        assert nodes_left(first) == "dgbh"
        assert [each["released"] for each in first["nodeStates"]] == [True, True, False, False]
        assert [each["released"] for each in first["edgeStates"]] == [True, True, False, False]
        set_speed(site.chassis, usual)
        await master.wait_state(lambda state: state["lastNodeId"] in ("d", "g"))

        master.order(line("gbhi", released=3, first=2), order_id="1234", update=1)
        second = await seen(master, lambda state: state["orderUpdateId"] == 1)
        left = nodes_left(second)
        assert "dgbhi".endswith(second["lastNodeId"] + left), "every node is either passed or left"
        assert left.endswith("i"), "the horizon is not driven to"
        ended = await master.wait_state(
            lambda state: state["lastNodeId"] == "h" and not state["driving"]
        )
        assert nodes_left(ended) == "i"
        assert ended["lastNodeSequenceId"] == 8
        assert ended["newBaseRequest"]
        assert ended["errors"] == []
        visited = [state["lastNodeId"] for state in master.received["state"] if state["orderId"]]
        passed = [a for a, b in pairwise([*visited, ""]) if a != b]
        # the robot may pass two nodes between two reports
        assert passed == [name for name in "fdgbh" if name in passed]
    assert site.chassis.state.pose.x == pytest.approx(X + 4 * STEP, abs=0.05)
    assert len(received(site.chassis, ExecTask)) == 2


def order_with(end: Message | None = None, **fields: Any) -> Message:
    """An order from the start to a node, with fields of its edge."""
    nodes = [node("a", 0, *START), end or node("b", 2, X + STEP, Y)]
    return {"nodes": nodes, "edges": [edge(*nodes, **fields)]}


def curve(*points: tuple[float, float]) -> Message:
    """A straight trajectory."""
    return {
        "degree": 1,
        "knotVector": [0, 0, 1, 1],
        "controlPoints": [{"x": x, "y": y} for x, y in points],
    }


REJECTED: dict[str, tuple[Message, str, dict[str, str]]] = {
    "the start is too far": (
        {"nodes": [node("a", 0, 0.0, 0.0)], "edges": []},
        "noRouteError",
        {"nodeId": "a"},
    ),
    "a field is missing": ({"nodes": []}, "validationError", {"topic": "order"}),
    "a zone set": (order_with() | {"zoneSetId": "z"}, "orderError", {"parameter": "zoneSetId"}),
    "a corridor": (
        order_with(corridor={"leftWidth": 1.0, "rightWidth": 1.0}),
        "orderError",
        {"edgeId": "a-b", "parameter": "corridor"},
    ),
    "another map": (
        order_with(node("b", 2, X, Y, map_id="roof")),
        "orderError",
        {"nodeId": "b", "mapId": "roof"},
    ),
    "no such mark": (
        order_with({"nodeId": "b", "sequenceId": 2, "released": True, "actions": []}),
        "orderError",
        {"nodeId": "b", "parameter": "nodePosition"},
    ),
    "an action with a wrong parameter": (
        order_with(node("b", 2, X, Y, actions=[action("step", "1", distance=100.0)])),
        "orderError",
        {"nodeId": "b", "actionType": "step", "actionParameter": "distance"},
    ),
    "too slow": (order_with(maxSpeed=0.0), "orderError", {"parameter": "maxSpeed"}),
    "a trajectory that ends elsewhere": (
        order_with(trajectory=curve(START, (X, Y + 1.0))),
        "orderError",
        {"edgeId": "a-b", "parameter": "trajectory"},
    ),
}


async def test_what_the_vehicle_cannot_do_is_rejected_with_references(site: Site) -> None:
    async with site.online() as master:
        await eventually(lambda: master.last("factsheet"))
        features = master.last("factsheet")["protocolFeatures"]["optionalParameters"]
        supported = {each["parameter"] for each in features}
        assert supported >= {"order.edges.trajectory", "order.edges.maxSpeed"}
        assert not supported & {"order.edges.corridor", "order.zoneSetId"}

        for number, (what, (content, kind, expected)) in enumerate(REJECTED.items()):
            name = f"bad {number}."
            master.send("order", {"orderId": name, "orderUpdateId": 0} | content)
            state = await master.wait_state(
                lambda state, name=name: name in str(state["errors"]), what
            )
            error = state["errors"][-1]
            assert (error["errorType"], error["errorLevel"]) == (kind, "WARNING"), what
            expected = {"orderId": name, "orderUpdateId": "0"} | expected
            assert references(error).items() >= expected.items(), what
            assert (state["orderId"], state["actionStates"]) == ("", [])

        master.send("order", {"orderId": "good", "orderUpdateId": 0} | order_with())
        accepted = await master.accepted("good")
        assert accepted["errors"] == []
        await master.reached("b")
    assert len(received(site.chassis, ExecTask)) == 1


async def test_an_order_goes_no_further_while_the_robot_is_on_no_map(site: Site) -> None:
    async with site.online() as master:
        first, second = node("a", 0, *START), node("b", 2, 6.0, -7.0)
        later = node("c", 4, 7.0, -7.0)
        master.instant(action("startPause", "p"))
        master.order([first, second, later | {"released": False}])
        await master.accepted()
        on_map_again = edit_bodies(site.chassis, PoseSpeed, lambda pose: setattr(pose, "map_id", 0))
        site.chassis.call(lambda simulator: simulator.chassis.localise(Pose(*START, 0.1)))
        await eventually(
            lambda: (last := master.last("visualization")) and "agvPosition" not in last
        )
        master.order([second, later], update=1)
        state = await master.error("orderError")
        assert "initPosition" in str(state["errors"])
        master.instant(action("stopPause", "s"))
        await master.status("s", "FINISHED")
        waits = "the order waits, because the robot does not know its position"
        await master.wait_state(lambda state: waits in str(state["errors"]))
        assert received(site.chassis, ExecTask) == []
        on_map_again()
        site.chassis.call(lambda simulator: simulator.chassis.localise(Pose(*START, 0.2)))
        await master.reached("b")


async def test_a_node_without_position_is_driven_to_by_the_mark_of_its_name(site: Site) -> None:
    site.chassis.delay(full_name(SceneData), 0.5)  # the vehicle is not online before
    async with site.online() as master:
        mark = {"nodeId": "K10", "sequenceId": 2, "released": True, "actions": []}
        master.order([node("a", 0, *START), mark])
        await master.reached("K10")
    (task,) = received(site.chassis, ExecTask)
    assert task.mark_no == "K10"
    assert not task.HasField("plan_path")
    pose = site.chassis.state.pose
    assert (pose.x, pose.y) == pytest.approx((8.0, -4.0), abs=0.05)


async def test_speed_limits_are_sent_on_entering_an_edge(site: Site) -> None:
    async with site.online() as master:
        nodes = [node("a", 0, *START), node("b", 2, X + 3, Y), node("c", 4, X + 6, Y)]
        master.order(
            nodes, [edge(nodes[0], nodes[1], maxSpeed=0.3), edge(nodes[1], nodes[2], maxSpeed=1.2)]
        )
        await master.reached("c")
    modes = [each.nav_mode for each in received(site.chassis, ChangeNavMode)]
    assert [mode.max_speed for mode in modes] == pytest.approx([0.3, 1.2])


async def test_a_refused_speed_limit_ends_the_drive(site: Site) -> None:
    site.chassis.refuse("woosh.robot.ChangeNavMode", "not now")
    set_speed(site.chassis, 1.0)
    async with site.online() as master:
        nodes = [node("a", 0, *START)]
        for number, name in enumerate("bcdefg", start=1):
            nodes.append(node(name, 2 * number, 10.0 if number % 2 else X, -7.5))
        master.order(nodes, [edge(*pair, maxSpeed=0.2) for pair in pairwise(nodes)])
        state = await master.wait_state(lambda state: state["errors"])
        error = state["errors"][-1]
        assert (error["errorType"], error["errorLevel"]) == ("drivingError", "FATAL")
        assert "not now" in error["errorDescription"]
        assert references(error)["orderId"] == "order"
        state = await master.wait_state(lambda state: not state["driving"])
        assert state["nodeStates"]
    assert len(received(site.chassis, ChangeNavMode)) == 1
