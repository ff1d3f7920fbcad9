"""Actions that the vehicle cannot perform, and the list of those that it can, on the wire."""

from __future__ import annotations

from tests.tools.waiting import aio, eventually
from tests.vda5050.chassis_events import commands
from tests.vda5050.conftest import Site
from tests.vda5050.master import START, action, error_types, node, references, result_of
from tests.vda5050.test_orders_instant import SCOPES


@aio
async def test_wrong_instant_actions_fail(site: Site) -> None:
    async with site.online() as master:
        master.instant(action("finePositioning", "no"), action("step", "far", distance=100.0))
        state = await master.status("far", "FAILED")
        assert error_types(state) == ["instantActionError"] * 2
        assert "no action finePositioning" in result_of(state, "no")
        assert "within -10 to 10" in result_of(state, "far")
        names = {"actionId": "far", "actionType": "step", "actionParameter": "distance"}
        assert references(state["errors"][1]) == names
        master.order([node("a", 0, *START)])
        state = await master.accepted()
        assert state["errors"] == state["actionStates"] == []
    assert commands(site.chassis) == []


@aio
async def test_the_factsheet_lists_exactly_the_supported_actions(site: Site) -> None:
    async with site.online() as master:
        listed = master.last("factsheet")["protocolFeatures"]["agvActions"]
        scopes = {name: sorted(scope.value for scope in of) for name, of in SCOPES.items()}
        assert {each["actionType"]: each["actionScopes"] for each in listed} == scopes
        (step,) = (each for each in listed if each["actionType"] == "step")
        parameters = {each["key"]: each["isOptional"] for each in step["actionParameters"]}
        assert parameters == {"distance": False, "speed": True, "lateral": True}
        count = len(master.received["factsheet"])
        master.instant(action("factsheetRequest", "f"))
        await master.status("f", "FINISHED")
        await eventually(lambda: len(master.received["factsheet"]) > count)
