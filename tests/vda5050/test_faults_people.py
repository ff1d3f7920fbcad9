"""People and other programs command the robot while it has an order."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

from tests.asynchronous import TIMEOUT, eventually
from tests.quick_chassis import set_speed
from tests.vda5050.chassis_events import commands
from tests.vda5050.conftest import CHARGER, EXEC, LEG, ORDER, Site, task_to
from tests.vda5050.master import (
    START,
    Master,
    action,
    error_types,
    node,
    nodes_left,
    references,
    result_of,
    status_of,
)
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ActionOrder, ExecTask, Follow
from woosh_robot_agent.pb.ros.action_pb2 import LiftControl3, StepControl, kCancel, kExecute
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction
from woosh_robot_agent.pb.util import action_pb2, robot_pb2, task_pb2
from woosh_robot_agent.simulator.world.geometry import Pose

STRAIGHT = StepControl.Step(mode=StepControl.Step.kStraight, value=0.4, speed=0.02)


async def test_a_manual_mode_clears_the_order_and_rejects_the_next(site: Site) -> None:
    async with site.online() as master:
        await site.drive(master)
        site.chassis.set_key_switch(True)
        set_speed(site.chassis, 2.0)
        state = await master.wait_state(
            lambda state: state["operatingMode"] == "MANUAL" and not state["nodeStates"]
        )
        assert "interruptedError" in error_types(state)
        assert state["orderId"] == "order"
        master.order([node("a", 0, *START), node("b", 2, 6.0, -7.0)], order_id="next")
        state = await master.error("orderError")
        assert state["orderId"] == "order"
        site.chassis.set_key_switch(False)
        await master.wait_state(lambda state: state["operatingMode"] == "AUTOMATIC")
        await site.idle()
        assert site.chassis.state.pose.x < 7.9
        assert site.chassis.counts[EXEC] == 1


@pytest.mark.parametrize("when", ["before", "after"])
async def test_a_step_does_not_go_on_when_the_key_is_back_at_automatic(
    site: Site, when: str
) -> None:
    set_speed(site.chassis, 1.0)
    async with site.online() as master:
        step = action("step", "step", distance=1.0, speed=0.2)
        if when == "before":
            master.instant(step)
            await eventually(lambda: site.chassis.state.velocity.speed > 0.1)
        site.chassis.set_key_switch(True, accept=True)  # it also accepts what it cannot do now
        await master.wait_state(lambda state: state["operatingMode"] == "MANUAL")
        if when == "after":
            master.instant(step)
        state = await master.status("step", "FAILED")
        assert result_of(state, "step") == "the robot is not in automatic mode"
        site.chassis.set_key_switch(False)
        await master.wait_state(lambda state: state["operatingMode"] == "AUTOMATIC")
        before = site.chassis.state.pose
        await asyncio.sleep(1.0)
        assert site.chassis.state.pose == before


async def test_a_task_that_somebody_cancels_is_an_error_and_not_repeated(site: Site) -> None:
    async with site.online() as master:
        await site.drive(master)
        async with site.other_client() as gate:
            assert (await gate.request(ActionOrder(order=action_pb2.kCancel))).ok
        set_speed(site.chassis, 20.0)
        state = await master.error("drivingError")
        assert nodes_left(state) == "b"
        assert site.chassis.counts[EXEC] == 1


@pytest.mark.parametrize("kind", ["step", "startCharging"])
@pytest.mark.parametrize("instant", [False, True])
async def test_an_order_does_not_go_on_when_somebody_stops_an_action(
    site: Site, kind: str, instant: bool
) -> None:
    """Nor does an action begin that waits for the end of the first one."""
    site.stand_at_charger()
    set_speed(site.chassis, 0.5)
    parameters = {"distance": 1.0, "speed": 0.02} if kind == "step" else {}
    work = [action(kind, each, blocking="SOFT", **parameters) for each in ("one", "two")]
    async with site.online() as master, site.other_client() as gate:
        if instant:
            master.instant(work.pop(0))
            await master.status("one", "RUNNING")
        master.order([node("a", 0, *CHARGER, actions=work), node("b", 2, -8.0, CHARGER[1])])
        await master.wait_state(lambda state: status_of(state, "two") and state["driving"])
        assert (await gate.stop(TIMEOUT)).success
        state = await master.error("interruptedError")
        assert status_of(state, "one") == "FAILED"
        set_speed(site.chassis, 20.0)
        master.instant(action("cancelOrder", "c"))
        ended = await master.status("c", "FINISHED")
        assert status_of(ended, "two") == "FAILED"
        if not instant:  # otherwise it was not begun, because the robot may have been moved
            assert f"{kind} was interrupted" in result_of(ended, "two")
    sent = [each for each in commands(site.chassis) if "cancel" not in each]
    assert sent == (["step_control execute"] if kind == "step" else ["charge C1"])


async def test_an_action_beside_the_drive_that_somebody_stops_fails_and_the_order_goes_on(
    site: Site,
) -> None:
    lift = action("liftTo", "lift", blocking="NONE", height=0.5, speed=0.001)
    async with site.online() as master, site.other_client() as gate:
        await site.drive(master, [node("a", 0, *START, actions=[lift]), LEG[1]])
        await master.status("lift", "RUNNING")
        stop = CallAction(lift_control3=LiftControl3(action=kCancel))
        assert (await gate.request(stop)).ok
        state = await master.error("actionError")
        assert result_of(state, "lift").startswith("it was cancelled at the robot")
        (error,) = state["errors"]
        assert references(error)["actionId"] == "lift"
        assert error["errorLevel"] == "WARNING"
        set_speed(site.chassis, 20.0)
        ended = await master.reached("b")
        assert status_of(ended, "lift") == "FAILED"


@asynccontextmanager
async def waiting_for(task: ExecTask, site: Site) -> AsyncIterator[Master]:
    """A master control whose order waits, because another client has started a task."""
    async with site.online() as master, site.other_client() as gate:
        set_speed(site.chassis, 0.1)
        assert (await gate.request(task)).ok
        await master.wait_state(lambda state: state["driving"])  # so the task is reported
        master.order([node("a", 0, *START, allowedDeviationXY=0.5), node("b", 2, 6.0, -7.0)])
        await master.error("robotBusyError")
        yield master


async def test_an_order_waits_for_the_task_of_somebody_else(site: Site) -> None:
    async with waiting_for(task_to(4.3, -6.68), site) as master:
        assert site.chassis.counts[EXEC] == 1
        set_speed(site.chassis, 20.0)
        ended = await master.reached("b")
        assert ended["errors"] == []
    assert site.chassis.counts[EXEC] == 2


async def test_an_order_waits_while_the_robot_follows_somebody(site: Site) -> None:
    async with site.online() as master, site.other_client() as gate:
        assert (await gate.request(Follow(type=True))).ok
        await eventually(lambda: site.chassis.state.info.state == robot_pb2.kFollowing)
        master.order([node("a", 0, *START), node("b", 2, 6.0, -7.0)])
        await master.error("robotBusyError")
        assert site.chassis.counts[EXEC] == 0
        assert (await gate.request(Follow())).ok
        ended = await master.reached("b")
        assert ended["errors"] == []


async def test_an_order_waits_for_the_step_of_somebody_else_beside_an_own_action(
    site: Site,
) -> None:
    step = StepControl(action=kExecute, steps=[STRAIGHT])
    async with site.online() as master, site.other_client() as gate:
        master.instant(action("liftTo", "lift", blocking="NONE", height=0.5, speed=0.001))
        await master.status("lift", "RUNNING")
        assert (await gate.request(CallAction(step_control=step))).ok
        await master.wait_state(lambda state: state["driving"])
        master.order([node("a", 0, *START, allowedDeviationXY=1.0), node("b", 2, 6.0, -7.0)])
        await master.error("robotBusyError")
        assert site.chassis.counts[EXEC] == 0
        await master.reached("b")


async def test_cancelling_an_order_leaves_the_task_of_somebody_else_alone(site: Site) -> None:
    async with waiting_for(task_to(4.3, -6.68), site) as master:
        master.instant(action("cancelOrder", "cancel"))
        state = await master.status("cancel", "FINISHED")
        assert state["nodeStates"] == []
        assert site.chassis.counts[ORDER] == 0
        set_speed(site.chassis, 20.0)
        await site.idle()
        assert site.chassis.state.info.task_proc.state == task_pb2.kCompleted


async def test_a_charging_task_that_is_not_of_the_vehicle_is_named(site: Site) -> None:
    charge = ExecTask(task_id=77, type=task_pb2.kCharge, mark_no="C1")
    async with waiting_for(charge, site) as master:
        assert "charging task" in master.state["errors"][0]["errorDescription"]
        master.instant(action("stopCharging", "stop"))
        set_speed(site.chassis, 20.0)
        await master.reached("b")


@pytest.mark.parametrize("by_action", [False, True])
async def test_the_last_node_is_forgotten_when_people_move_the_robot_away(
    site: Site, by_action: bool
) -> None:
    async with site.online() as master:
        if by_action:
            x, y = START
            position = {"x": x, "y": y, "theta": 0.0, "mapId": "wooshmap", "lastNodeId": "a"}
            master.instant(action("initPosition", "i", **position))
        else:
            master.order([node("a", 0, *START)])
        await master.reached("a")
        site.chassis.set_key_switch(True)
        state = await master.wait_state(lambda state: state["operatingMode"] == "MANUAL")
        assert state["lastNodeId"] == "a"
        site.chassis.call(lambda simulator: simulator.chassis.localise(Pose(5.5, -6.8, 0.0)))
        await master.reached("")


async def test_an_action_that_does_not_drive_hides_no_move(site: Site) -> None:
    async with site.online() as master:
        first, second = node("a", 0, *START), node("b", 2, 6.0, -7.0)
        master.order([first, second | {"released": False}])
        await master.accepted("order")
        master.instant(action("liftTo", "lift", blocking="NONE", height=0.5, speed=0.001))
        await master.status("lift", "RUNNING")
        site.chassis.call(lambda simulator: simulator.chassis.localise(Pose(5.5, -6.8, 0.0)))
        await eventually(
            lambda: master.last("visualization").get("agvPosition", {}).get("x") == 5.5
        )
        master.order([first, second], update=1)
        await master.error("interruptedError")
    assert site.chassis.counts[EXEC] == 0
