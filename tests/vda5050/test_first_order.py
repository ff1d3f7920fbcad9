"""A vehicle goes online, drives an order of two nodes, and goes offline."""

from __future__ import annotations

import pytest

from tests.tools.waiting import aio, eventually
from tests.vda5050.broker import Mosquitto, Recorder
from tests.vda5050.conftest import VehicleStarter
from tests.vda5050.master import Master, node
from woosh_robot_agent.simulator import SimulatorThread

START = (4.23276472, -6.6727581)
"""Where the simulated robot stands at first."""


@aio
async def test_an_order_of_two_nodes_is_driven(
    vehicle: VehicleStarter, broker: Mosquitto, chassis: SimulatorThread
) -> None:
    async with Master(broker.port) as master, vehicle():
        await master.online()
        assert master.state["orderId"] == ""
        assert master.state["operatingMode"] == "AUTOMATIC"
        assert master.state["agvPosition"]["x"] == pytest.approx(START[0])

        master.order([node("a", 0, *START), node("b", 2, 7.0, -7.0, theta=0.5)])
        accepted = await master.wait_state(lambda state: state["orderId"] == "order")
        assert accepted["lastNodeId"] == "a"
        await master.wait_state(lambda state: state["lastNodeId"] == "b")
        ended = await master.wait_state(lambda state: not state["driving"])

        assert ended["nodeStates"] == ended["edgeStates"] == ended["errors"] == []
        assert ended["lastNodeSequenceId"] == 2
    pose = chassis.state.pose
    assert (pose.x, pose.y, pose.theta) == pytest.approx((7.0, -7.0, 0.5), abs=0.05)


@aio
async def test_the_connection_is_reported_and_the_factsheet_kept(
    vehicle: VehicleStarter, broker: Mosquitto, recorder: Recorder
) -> None:
    async with Master(broker.port) as master:
        async with vehicle():
            await master.online()
        await eventually(lambda: master.last("connection")["connectionState"] == "OFFLINE")
    await eventually(lambda: len(recorder.sent("connection")) == 2)
    first, last = recorder.sent("connection")
    assert (first["connectionState"], last["connectionState"]) == ("ONLINE", "OFFLINE")
    async with Master(broker.port) as late:
        await eventually(lambda: late.last("factsheet"))
        assert late.last("connection")["connectionState"] == "OFFLINE"
        names = {
            each["actionType"] for each in late.last("factsheet")["protocolFeatures"]["agvActions"]
        }
        assert names >= {"cancelOrder", "factsheetRequest", "stateRequest"}
