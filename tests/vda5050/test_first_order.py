"""A vehicle goes online, drives an order of two nodes, and goes offline."""

from __future__ import annotations

import pytest

from tests.tools.waiting import aio, eventually
from tests.vda5050.conftest import Site
from tests.vda5050.master import START, Master, node


@aio
async def test_an_order_of_two_nodes_is_driven(site: Site) -> None:
    async with site.online() as master:
        assert master.state["orderId"] == ""
        assert master.state["operatingMode"] == "AUTOMATIC"
        assert "distanceSinceLastNode" not in master.state
        assert master.state["agvPosition"]["x"] == pytest.approx(START[0])

        master.order([node("a", 0, *START), node("b", 2, 7.0, -7.0, theta=0.5)])
        accepted = await master.accepted("order")
        assert accepted["lastNodeId"] == "a"
        await master.reached("b")
        ended = await master.wait_state(lambda state: not state["driving"])

        assert ended["nodeStates"] == ended["edgeStates"] == ended["errors"] == []
        assert ended["lastNodeSequenceId"] == 2
    pose = site.chassis.state.pose
    assert (pose.x, pose.y, pose.theta) == pytest.approx((7.0, -7.0, 0.5), abs=0.05)


@aio
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
