"""What `cancelOrder` does with the actions that run or wait."""

from __future__ import annotations

import pytest

from tests.asynchronous import eventually
from tests.quick_chassis import set_speed
from tests.vda5050.chassis_events import commands
from tests.vda5050.conftest import Site
from tests.vda5050.master import START, Message, action, error_types, node, status_of
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.pb.robot.robot_pack_pb2 import InitRobot, SwitchMap

WAITS = [node("a", 0, *START), node("b", 2, 8.0, -7.5, released=False)]
"""An order that waits for an update."""
PLACE: Message = {"x": 6.0, "y": -7.0, "theta": 0.0, "mapId": "wooshmap"}


@pytest.mark.parametrize("has_order", [True, False])
async def test_cancelling_an_order_stops_an_instant_action_that_moves_the_robot(
    site: Site, has_order: bool
) -> None:
    """Even if there is no order, although `cancelOrder` fails then."""
    async with site.online() as master:
        if has_order:
            master.order(WAITS)
            await master.accepted()
        set_speed(site.chassis, 1.0)
        master.instant(action("step", "step", distance=5.0, speed=0.1))
        await eventually(lambda: site.chassis.state.velocity.speed > 0.0)
        master.instant(action("cancelOrder", "c"))
        cancelled = await master.status("c", "FINISHED" if has_order else "FAILED")
        assert status_of(cancelled, "step") == "FAILED"
        assert site.chassis.state.velocity.speed == 0.0
        assert ("noOrderToCancel" in error_types(cancelled)) is not has_order
    assert commands(site.chassis) == ["step_control execute", "step_control cancel"]


async def test_a_cancelled_instant_action_does_not_begin_after_a_pause(site: Site) -> None:
    """One that follows `cancelOrder` does."""
    async with site.online() as master:
        master.order(WAITS)
        await master.accepted()
        master.instant(action("startPause", "p"))
        await master.status("p", "FINISHED")
        master.instant(
            action("step", "before", distance=2.0),
            action("cancelOrder", "c"),
            action("rotate", "after", angle=0.1),
        )
        cancelled = await master.status("c", "FINISHED")
        assert status_of(cancelled, "before") == "FAILED"
        assert status_of(cancelled, "after") == "WAITING"
        where = site.chassis.state.pose
        master.instant(action("stopPause", "r"))
        await master.status("after", "FINISHED")
        assert site.chassis.state.pose.distance((where.x, where.y)) < 0.1


@pytest.mark.parametrize("instant", [False, True], ids=["of an order", "instant"])
@pytest.mark.parametrize(
    ("request_type", "change"),
    [
        (SwitchMap, action("enableMap", "i", mapId="scenex", mapVersion="12")),
        (InitRobot, action("initPosition", "i", **PLACE)),
    ],
    ids=["enableMap", "initPosition"],
)
async def test_what_cannot_be_interrupted_ends_before_the_cancellation_does(
    site: Site, request_type: type[InitRobot | SwitchMap], change: Message, instant: bool
) -> None:
    name = full_name(request_type)
    site.chassis.delay(name, 1.0)
    async with site.online() as master:
        await master.wait_state(lambda state: state.get("maps"))
        if instant:
            master.order(WAITS)
            await master.accepted()
            master.instant(change)
        else:
            master.order([node("a", 0, *START, actions=[change])])
        await eventually(lambda: site.chassis.counts[name])
        master.instant(action("cancelOrder", "c"))
        running = await master.status("c", "RUNNING")
        assert status_of(running, "i") == "RUNNING"
        ended = await master.status("c", "FINISHED")
        assert status_of(ended, "i") == "FINISHED"
        place = ended["agvPosition"]
        assert place["mapId"] == "scenex" or place["x"] == pytest.approx(PLACE["x"])
