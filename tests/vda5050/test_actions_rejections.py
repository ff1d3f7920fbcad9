"""Actions that the vehicle cannot perform, and the list of those that it can."""

from __future__ import annotations

import pytest

from tests.tools.waiting import aio, eventually
from tests.vda5050.chassis_events import commands
from tests.vda5050.conftest import Online
from tests.vda5050.master import (
    START,
    Message,
    action,
    edge,
    error_types,
    node,
    references,
    result_of,
    status_of,
)
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.vda5050.actions.runner import action_types
from woosh_robot_agent.vda5050.messages.factsheet import Scope, objection
from woosh_robot_agent.vda5050.messages.order import Action, BlockingType
from woosh_robot_agent.vda5050.messages.versions import V2_1, V3_0

POSE = {"x": 0.0, "y": 0.0, "theta": 0.0, "mapId": "wooshmap", "lastNodeId": "a"}
MAP = {"mapId": "m", "mapVersion": "1", "mapDownloadLink": "http://localhost/m.zip"}
HASH = "mapHash"
WRONG = [
    (action("finePositioning"), "no action finePositioning", ""),
    (action("startPause"), "not possible as node action", ""),
    (action("step"), "needs the parameter distance", "distance"),
    (action("step", distance="1"), "must be a finite number", "distance"),
    (action("step", distance=True), "must be a finite number", "distance"),
    (action("step", distance=100.0), "within -10 to 10", "distance"),
    (action("step", distance=1.0, lateral="yes"), "must be true or false", "lateral"),
    (action("step", blocking="NONE", distance=1.0), "needs blockingType HARD or SOFT", ""),
    (action("rotate", angle=7.0), "within -6.28319 to 6.28319", "angle"),
    (action("liftTo", height=-0.1), "within 0 to 2", "height"),
    (action("liftTo", height=99.0), "within 0 to 2", "height"),
    (action("liftTo", height=0.1, speed=0.0), "at least 0.001", "speed"),
    (action("speak", text=""), "must be a text", "text"),
    (action("speak", text=1), "must be a text", "text"),
    (action("switchFootprint", footprint="HUGE"), "one of ORIGINAL", "footprint"),
    (action("pick", side="left"), "has no parameter side", "side"),
    (action("initPosition", **POSE | {"theta": None}), "must be a finite number", "theta"),
]
"""Wrong actions on a node, a part of the reason, and the parameter that is named."""
WRONG_INSTANT = [
    (action("finePositioning"), "no action finePositioning", ""),
    (action("pick"), "not possible as instant action, only as node action", ""),
    (action("step", distance=100.0), "within -10 to 10", "distance"),
    (action("liftTo", height=99.0), "within 0 to 2", "height"),
    (action("stateRequest", all=True), "has no parameter all", "all"),
    (action("downloadMap", **MAP | {"mapDownloadLink": "file:///m"}), "URL", "mapDownloadLink"),
    (action("downloadMap", **MAP | {HASH: "123"}), "hash of sha256, sha1, md5", HASH),
    (action("logReport", reason="none"), "no action logReport", ""),
]
EVERYWHERE = {Scope.INSTANT, Scope.NODE, Scope.EDGE}
SCOPES: dict[str, set[Scope]] = {
    **{key: {Scope.INSTANT} for key in ("startPause", "stopPause", "cancelOrder")},
    **{key: {Scope.INSTANT} for key in ("stateRequest", "factsheetRequest")},
    **{key: {Scope.INSTANT} for key in ("downloadMap", "deleteMap")},
    **{key: {Scope.INSTANT, Scope.NODE} for key in ("startCharging", "stopCharging")},
    **{key: {Scope.INSTANT, Scope.NODE} for key in ("initPosition", "enableMap")},
    **{key: {Scope.INSTANT, Scope.NODE} for key in ("step", "rotate", "switchFootprint")},
    **{key: {Scope.NODE} for key in ("pick", "drop")},
    **dict.fromkeys(("liftTo", "speak"), EVERYWHERE),
}
"""All actions in version 2.1, and where they may be requested."""


def valid(given: Message) -> bool:
    """Return True unless an action has a value that its schema does not permit."""
    return all(each["value"] is not None for each in given["actionParameters"])


@aio
async def test_orders_with_wrong_actions_are_rejected(
    online: Online, chassis: SimulatorThread
) -> None:
    async with online() as master:
        for number, (wrong, reason, parameter) in enumerate(WRONG):
            if not valid(wrong):
                continue
            wanted = str(number)
            master.order([node("a", 0, *START, actions=[wrong])], order_id=wanted)

            def is_rejected(state: Message, wanted: str = wanted) -> bool:
                return any(references(each).get("orderId") == wanted for each in state["errors"])

            state = await master.wait_state(is_rejected, wanted)
            assert state["orderId"] == ""
            assert state["actionStates"] == []
            (error,) = state["errors"]
            assert error["errorType"] == "orderError"
            assert error["errorLevel"] == "WARNING"
            assert reason in error["errorDescription"]
            named = references(error)
            assert named["actionId"] == wrong["actionId"]
            assert named["nodeId"] == "a"
            assert named.get("actionParameter", "") == parameter

        a, b = node("a", 0, *START), node("b", 2, 7.0, -7.0)
        master.order([a, b], [edge(a, b, actions=[action("pick", "p")])], order_id="edge")
        state = await master.wait_state(
            lambda state: any("edgeId" in references(each) for each in state["errors"])
        )
        assert "only as node action" in state["errors"][0]["errorDescription"]
        assert references(state["errors"][0])["edgeId"] == "a-b"
    assert commands(chassis) == []


@aio
async def test_wrong_instant_actions_fail(online: Online, chassis: SimulatorThread) -> None:
    async with online() as master:
        master.instant(*(wrong for wrong, _, _ in WRONG_INSTANT))
        last = WRONG_INSTANT[-1][0]["actionId"]
        state = await master.status(last, "FAILED")
        assert error_types(state) == ["instantActionError"] * len(WRONG_INSTANT)
        for error, (wrong, reason, parameter) in zip(state["errors"], WRONG_INSTANT, strict=True):
            assert status_of(state, wrong["actionId"]) == "FAILED"
            assert reason in result_of(state, wrong["actionId"])
            assert references(error)["actionId"] == wrong["actionId"]
            assert references(error).get("actionParameter", "") == parameter
        master.order([node("a", 0, *START)])
        state = await master.accepted("order")
        assert state["errors"] == state["actionStates"] == []
    assert commands(chassis) == []


@aio
async def test_the_factsheet_lists_exactly_the_supported_actions(online: Online) -> None:
    async with online() as master:
        listed = master.last("factsheet")["protocolFeatures"]["agvActions"]
        found = {
            each["actionType"]: {Scope(scope) for scope in each["actionScopes"]} for each in listed
        }
        assert found == SCOPES
        (step,) = (each for each in listed if each["actionType"] == "step")
        assert [each["key"] for each in step["actionParameters"]] == [
            "distance",
            "speed",
            "lateral",
        ]
        assert [each["isOptional"] for each in step["actionParameters"]] == [False, True, True]
        count = len(master.received["factsheet"])
        master.instant(action("factsheetRequest", "f"))
        await master.status("f", "FINISHED")
        await eventually(lambda: len(master.received["factsheet"]) > count)


@pytest.mark.parametrize("name", [*SCOPES, "clearInstantActions", "finePositioning"])
def test_each_scope_is_checked(name: str) -> None:
    types = action_types(V2_1)
    for scope in Scope:
        given = Action("id", name, BlockingType.HARD)
        wrong = objection(types, given, scope)
        refuses = wrong is not None and (
            "not possible as" in wrong.reason or "has no action" in wrong.reason
        )
        assert refuses == (scope not in SCOPES.get(name, set()))


def test_version_3_has_further_names() -> None:
    second, third = action_types(V2_1).keys(), action_types(V3_0).keys()
    assert second - third == {"initPosition"}
    assert third - second == {"initializePosition", "clearInstantActions"}
