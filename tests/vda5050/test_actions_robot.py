"""Charging, loads, the robot's own actions, and wrong ones, on the wire and at the chassis."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest

from tests.asynchronous import eventually
from tests.quick_chassis import edit_bodies, set_speed
from tests.vda5050.chassis_events import commands, received, statuses
from tests.vda5050.conftest import AT_ONCE, Held, Site, task_to
from tests.vda5050.master import START, action, error_types, node, references, result_of, status_of
from tests.vda5050.test_orders_instant import SCOPES
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.pb.map.storage_edit_pb2 import Storages
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ExecTask
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo, RobotState, TaskProc
from woosh_robot_agent.pb.ros.ros_pack_pb2 import Feedbacks
from woosh_robot_agent.pb.util import action_pb2, robot_pb2
from woosh_robot_agent.pb.util import task_pb2 as task
from woosh_robot_agent.simulator import SimulatedChassis
from woosh_robot_agent.simulator.serving.exchange import Outgoing
from woosh_robot_agent.simulator.world.geometry import Pose
from woosh_robot_agent.vda5050.robot.link import Timing


async def test_an_order_waits_until_its_charging_task_has_ended(site: Site) -> None:
    site.lower_battery()
    async with site.online(limits=AT_ONCE) as master:
        charge = action("startCharging", "charge")
        nodes = [node("a", 0, *START), node("b", 2, -9.5, 0.5, actions=[charge])]
        last = node("c", 4, *START)
        master.order([*nodes, last | {"released": False}])
        finished = await master.status("charge", "FINISHED")
        assert finished["errors"] == []  # it waits for an update
        master.order([nodes[1], last], update=1)
        waiting = await master.error("robotBusyError")
        assert waiting["batteryState"]["charging"]
        assert status_of(waiting, "charge") == "FINISHED"
        assert error_types(waiting) == ["robotBusyError"]
        assert "stopCharging" in waiting["errors"][0]["errorHint"]
        master.instant(action("startCharging", "again"))  # idempotent
        await master.status("again", "FINISHED")
        master.instant(action("stopCharging", "stop"))
        stopped = await master.status("stop", "FINISHED")
        assert not stopped["batteryState"]["charging"]
        ended = await master.reached("c")
        assert ended["errors"] == []
    assert commands(site.chassis) == ["drive", "charge C1", "cancel", "drive"]
    assert statuses(site.recorder, "charge")[-2:] == ["RUNNING", "FINISHED"]


async def test_charging_ends_although_the_robot_has_just_confirmed_it(lifelike: Site) -> None:
    confirmed: list[bool] = []
    chassis = lifelike.chassis
    simulator = chassis.call(lambda simulator: simulator)

    def wait_after_confirmation(out: Outgoing) -> list[Outgoing]:
        job = out.body.action if isinstance(out.body, TaskProc) else TaskProc.Action()
        done = (job.type, job.state) == (action_pb2.kCharge, action_pb2.kRosSuccess)
        if done and not confirmed:
            confirmed.append(done)
            simulator.speed = 0.05  # the task ends after 20 s
        return [out]

    lifelike.lower_battery()
    chassis.intercept(wait_after_confirmation)
    async with lifelike.online() as master:
        charge = action("startCharging", "charge")
        master.order([node("a", 0, *START), node("b", 2, -9.5, 0.5, actions=[charge])])
        await eventually(lambda: confirmed)
        await master.status("charge", "FINISHED")
        master.instant(action("stopCharging", "stop"))
        await eventually(lambda: "cancel" in commands(chassis))
        set_speed(chassis, 20.0)
        stopped = await master.status("stop", "FINISHED")
        assert not stopped["batteryState"]["charging"]
        assert commands(chassis)[2:] == ["cancel", "charge_control execute"]


@pytest.mark.parametrize("is_foreign", [False, True])
async def test_the_next_drive_begins_when_the_robot_has_left_its_task(
    lifelike: Site, is_foreign: bool
) -> None:
    states: list[int] = []
    chassis, (x, y) = lifelike.chassis, START
    simulator = chassis.call(lambda simulator: simulator)

    def record(out: Outgoing) -> list[Outgoing]:
        if isinstance(out.body, RobotState):
            if states[-1:] != [out.body.state]:  # each client gets it
                states.append(out.body.state)
        elif isinstance(out.body, TaskProc) and out.body.action.state == action_pb2.kRosSuccess:
            simulator.speed = 0.2  # the robot leaves its task 25 to 100 ms after its end
        return [out]

    chassis.intercept(record)
    async with lifelike.online() as master, lifelike.other_client() as other:
        if is_foreign:
            set_speed(chassis, 1.0)
            await other.request(task_to(x + 0.5, y))
            await eventually(lambda: chassis.state.pose.x > x + 0.1)
            set_speed(
                chassis, 0.1
            )  # so that the order comes before the end, on a busy machine, too
            near = node("b", 0, x + 0.5, y, allowedDeviationXY=2.0)
            master.order([near, node("c", 2, x + 1.0, y)])
            await master.error("robotBusyError")
            set_speed(chassis, 20.0)
        else:
            stop = node("b", 2, x + 0.5, y, theta=0.0, allowedDeviationTheta=0.1)
            master.order([node("a", 0, x, y), stop, node("c", 4, x + 1.0, y)])
        await eventually(lambda: len(received(chassis, ExecTask)) == 2)
        set_speed(chassis, 20.0)
        await master.reached("c")
    assert states[:3] == [robot_pb2.kTask, robot_pb2.kIdle, robot_pb2.kTask]


async def test_a_robot_that_was_taken_from_its_charger_without_a_link_does_not_go_on(
    site: Site,
) -> None:
    def take_away(simulator: SimulatedChassis) -> None:
        simulator.chassis.tasks.cancel("a button")
        simulator.chassis.localise(Pose(*START, 0.0))

    site.lower_battery()
    async with site.online() as master:
        charge = action("startCharging", "charge")
        nodes = [node("a", 0, *START), node("b", 2, -9.5, 0.5, actions=[charge])]
        master.order([*nodes, node("c", 4, 6.0, -7.0)])
        await master.error("robotBusyError")
        # real robots do not report a task that has ended
        edit_bodies(site.chassis, RobotInfo, lambda info: info.ClearField("task_proc"))
        async with site.without_link(master):
            site.chassis.call(take_away)
        await master.error("interruptedError")
    assert commands(site.chassis) == ["drive", "charge C1"]


async def test_an_order_ends_the_charging_task_after_a_lost_link(site: Site) -> None:
    site.stand_at_charger()
    async with site.online() as master:
        master.instant(action("startCharging", "charge"))
        await master.status("charge", "FINISHED")
        async with site.without_link(master):
            pass
        await master.wait_state(lambda state: "robotConnectionError" not in error_types(state))
        pose = site.chassis.state.pose
        stop = action("stopCharging", "stop")
        master.order([node("a", 0, pose.x, pose.y, actions=[stop]), node("b", 2, -8.0, 0.5)])
        ended = await master.reached("b")
        assert status_of(ended, "stop") == "FINISHED"
    assert commands(site.chassis) == ["charge C1", "cancel", "drive"]


async def test_a_pause_while_the_robot_is_asked_for_its_chargers_holds_back_the_task(
    site: Site,
) -> None:
    held = Held(site.chassis, lambda out: out.request == full_name(Storages))
    async with site.online(limits=AT_ONCE) as master:
        charge = action("startCharging", "charge")
        master.order([node("a", 0, *START), node("b", 2, -9.5, 0.5, actions=[charge])])
        await held.wait()
        master.instant(action("startPause", "p"))
        await master.status("p", "FINISHED")
        held.release()
        master.instant(action("stateRequest", "r"))
        await master.status("r", "FINISHED")
        assert commands(site.chassis) == ["drive"]
        master.instant(action("stopPause", "s"))
        await master.status("charge", "FINISHED")
    assert commands(site.chassis) == ["drive", "charge C1"]


async def test_an_order_goes_on_if_its_charging_is_stopped_before_it_charges(site: Site) -> None:
    site.stand_at_charger()
    set_speed(site.chassis, 0.5)
    async with site.online() as master:
        charge = action("startCharging", "charge", blocking="SOFT")
        master.order([node("a", 0, -9.5, 0.5, actions=[charge]), node("b", 2, -8.0, 0.5)])
        await master.wait_state(lambda state: state["driving"])
        master.instant(action("stopCharging", "stop", blocking="SOFT"))
        await eventually(lambda: "cancel" in commands(site.chassis))
        set_speed(site.chassis, 20.0)
        ended = await master.reached("b")
        assert (status_of(ended, "charge"), status_of(ended, "stop")) == ("FAILED", "FINISHED")


async def test_charging_without_a_charger_fails(site: Site) -> None:
    async with site.online() as master:
        master.instant(
            action("startCharging", "far"), action("startCharging", "rack", stationName="A1")
        )
        state = await master.wait_state(
            lambda state: status_of(state, "far") == status_of(state, "rack") == "FAILED"
        )
        assert "no charger within 3 m" in result_of(state, "far")
        assert "14.1 m away, more than 3 m" in result_of(state, "rack")
        assert error_types(state) == ["actionError", "actionError"]
        assert references(state["errors"][0])["actionId"] == "far"
        master.instant(action("stopCharging", "stop"))
        await master.status("stop", "FINISHED")
    assert commands(site.chassis) == []


@pytest.mark.parametrize("is_on_map", [True, False])
async def test_a_robot_that_does_not_know_its_position_is_not_said_to_lack_the_mark(
    site: Site, is_on_map: bool
) -> None:
    if is_on_map:
        site.chassis.lose_localisation()
    else:
        edit_bodies(site.chassis, RobotInfo, lambda info: info.pose_speed.ClearField("map_id"))
    async with site.online() as master:
        master.instant(
            action("startCharging", "nearest"), action("startCharging", "named", stationName="C1")
        )
        for each in ("nearest", "named"):
            state = await master.status(each, "FAILED")
            assert result_of(state, each) == "the robot does not know its position"
    assert commands(site.chassis) == []


async def test_pick_and_drop_move_the_lift(site: Site) -> None:
    async with site.online(limits=AT_ONCE) as master:
        pick = action("pick", "pick", stationType="floor", loadType="EPAL")
        master.order([node("a", 0, *START, actions=[pick])])
        await master.status("pick", "FINISHED")
        assert site.chassis.state.jack == pytest.approx(0.06)
        drop = action("drop", "drop")
        master.order([node("a", 0, *START, actions=[drop])], order_id="second")
        await master.status("drop", "FINISHED")
        assert site.chassis.state.jack == 0.0
    assert commands(site.chassis) == ["lift_control execute", "lift_control execute"]
    assert statuses(site.recorder, "pick")[-2:] == ["RUNNING", "FINISHED"]


async def test_pick_and_drop_at_a_mark_are_tasks_that_wait_for_each_other(site: Site) -> None:
    names = ("pick", "drop")
    work = [action(each, each, blocking="SOFT", stationName="U5") for each in names]
    async with site.online() as master:
        first, second = node("a", 0, *START), node("b", 2, 2.0, -7.0, actions=work)
        master.order([first, second, node("c", 4, 2.0, -6.0)])
        ended = await master.reached("c")
        assert status_of(ended, "pick") == status_of(ended, "drop") == "FINISHED"
    assert commands(site.chassis) == ["drive", "carry U5", "carry U5", "drive"]
    tasks = received(site.chassis, ExecTask)
    assert [each.direction for each in tasks] == [0, task.kFeeding, task.kCutting, 0]


async def test_two_actions_that_look_for_a_charger_at_once_begin_one_task(site: Site) -> None:
    site.stand_at_charger()
    async with site.online() as master:
        names = ("first", "second")
        master.instant(*(action("startCharging", each, blocking="SOFT") for each in names))
        for each in names:
            await master.status(each, "FINISHED")
    assert commands(site.chassis) == ["charge C1"]


async def test_the_robots_own_actions(site: Site) -> None:
    async with site.online() as master:
        before = site.chassis.state.pose
        master.instant(
            action("speak", "speak", text="good morning"),
            action("switchFootprint", "footprint", footprint="EXPAND"),
            action("liftTo", "lift", height=0.25),
            action("step", "step", distance=-0.4, speed=0.2),
        )
        await master.wait_state(
            lambda state: all(
                status_of(state, each) == "FINISHED"
                for each in ("speak", "footprint", "lift", "step")
            )
        )
        after = site.chassis.state
        assert after.spoken == ("good morning",)
        assert after.column == pytest.approx(0.25)
        assert after.pose.distance(before.point) == pytest.approx(0.4, abs=0.01)
        assert site.chassis.call(lambda simulator: simulator.chassis.footprint) == robot_pb2.kExpand
        master.instant(action("rotate", "turn", angle=-1.0))
        ended = await master.status("turn", "FINISHED")
        assert result_of(ended, "turn") == "1 of 1 steps done"
        turned = math.remainder(site.chassis.state.pose.theta - before.theta, math.tau)
        assert turned == pytest.approx(-1.0, abs=0.01)


async def test_what_the_robot_refuses_fails_with_its_words(site: Site) -> None:
    async with site.online() as master:
        too_high = action("liftTo", "lift", height=1.5)
        master.order([node("a", 0, *START, actions=[too_high]), node("b", 2, 7.0, -7.0)])
        state = await master.status("lift", "FAILED")
        assert "not within 0 to 1 m" in result_of(state, "lift")
        assert "actionError" in error_types(state)
        await master.reached("b")


async def test_an_action_survives_a_lost_link_and_is_not_repeated(site: Site) -> None:
    async with site.online() as master:
        master.instant(action("step", "step", distance=0.6, speed=0.02))
        await eventually(lambda: site.chassis.state.velocity.speed > 0.0)
        site.chassis.drop()
        await master.status("step", "FINISHED")
    assert commands(site.chassis) == ["step_control execute"]


async def test_an_order_does_not_go_on_after_a_blocking_action_whose_end_is_unknown(
    site: Site,
) -> None:
    site.chassis.refuse("woosh.ros.Feedbacks", "unknown request")
    async with site.online() as master:
        step = action("step", "step", distance=0.6, speed=0.02)
        master.order([node("a", 0, *START, actions=[step]), node("b", 2, 7.0, -7.0)])
        await eventually(lambda: site.chassis.state.velocity.speed > 0.0)
        site.chassis.intercept(
            lambda frame: (
                [] if isinstance(frame.body, Feedbacks) and not frame.is_answer else [frame]
            )
        )
        set_speed(site.chassis, 0.1)
        site.chassis.drop()
        state = await master.error("interruptedError")
        assert status_of(state, "step") == "FAILED"
        assert "does not tell how it ended" in result_of(state, "step")
        (error,) = [each for each in state["errors"] if each["errorType"] == "interruptedError"]
        assert error["errorLevel"] == "FATAL"
        assert "does not tell how it ended" in error["errorDescription"]
        set_speed(site.chassis, 20.0)
        master.instant(action("cancelOrder", "cancel"))
        await master.status("cancel", "FINISHED")
    assert commands(site.chassis) == ["step_control execute", "step_control cancel"]
    assert site.chassis.state.pose.x < START[0] + 0.5


async def test_the_error_of_a_last_action_whose_end_is_unknown_can_be_cancelled(
    site: Site,
) -> None:
    async with site.online(timing=Timing(ask_every=0.2, give_up_after=0.5)) as master:
        step = action("step", "step", distance=1.0, speed=0.02)
        set_speed(site.chassis, 1.0)
        master.order([node("a", 0, *START, actions=[step])])
        await master.status("step", "RUNNING")

        def without_actions(frame: Outgoing) -> list[Outgoing]:
            is_about_actions = isinstance(frame.body, Feedbacks)
            return [replace(frame, body=Feedbacks())] if is_about_actions else [frame]

        site.chassis.intercept(without_actions)
        site.chassis.drop()
        state = await master.error("interruptedError")
        assert "cancelOrder" in str(state["errors"])
        master.instant(action("cancelOrder", "cancel"))
        state = await master.status("cancel", "FINISHED")
        assert "interruptedError" not in error_types(state)
        master.instant(action("cancelOrder", "again"))
        await master.status("again", "FAILED")


async def test_a_log_report_is_stored(site: Site, tmp_path: Path) -> None:
    """Even if a hundred others have later names, because the clock was set back."""
    folder = tmp_path / "reports"
    async with site.online(state_folder=tmp_path) as master:
        master.instant(action("logReport", "first", reason="a test"))
        state = await master.status("first", "FINISHED")
        robot = (folder / result_of(state, "first")).parent
        for number in range(100):
            (robot / f"log_report_30{number:02}.json").touch()
        master.instant(action("logReport", "log", reason="a test"))
        state = await master.status("log", "FINISHED")
        assert len(list(robot.iterdir())) == 100
        content = json.loads((folder / result_of(state, "log")).read_text("utf-8"))
        assert content["reason"] == "a test"
        assert content["robot"]["robot_id"] == 30001
        assert set(content) == {"time", "reason", "robot", "taskHistory", "statusCodes"}
        folder.rename(tmp_path / "moved")
        folder.write_text("no folder")
        master.instant(action("logReport", "full", reason="a test"))
        state = await master.status("full", "FAILED")
        assert "cannot be stored" in result_of(state, "full")


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
