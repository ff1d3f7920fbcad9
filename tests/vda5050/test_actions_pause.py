"""startPause, stopPause and cancelOrder, on the wire and at the chassis."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.asynchronous import eventually
from tests.quick_chassis import set_speed
from tests.vda5050.chassis_events import commands, statuses
from tests.vda5050.conftest import AT_ONCE, ORDER, Held, Site, left_by_a_kill
from tests.vda5050.master import (
    START,
    Master,
    Message,
    action,
    error_types,
    node,
    nodes_left,
    references,
    result_of,
    status_of,
)
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ActionOrder, Speak
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction, Feedbacks
from woosh_robot_agent.pb.util import action_pb2
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.simulator.serving.exchange import Outgoing
from woosh_robot_agent.vda5050.robot.link import Timing


async def test_a_drive_is_paused_and_resumed(site: Site) -> None:
    async with site.online(limits=AT_ONCE) as master:
        master.order([node("a", 0, *START), node("b", 2, 9.0, 7.0)])
        await master.wait_state(lambda state: state["driving"])

        master.instant(action("startPause", "p1"))
        paused = await master.status("p1", "FINISHED")
        assert paused["paused"]
        assert paused["nodeStates"]
        standing = await master.wait_state(lambda state: not state["driving"])
        assert standing["lastNodeId"] == "a"
        assert site.chassis.state.velocity.speed == 0.0

        master.instant(action("startPause", "p2"))  # idempotent
        await master.status("p2", "FINISHED")
        master.instant(action("stopPause", "s1"))
        resumed = await master.status("s1", "FINISHED")
        assert not resumed["paused"]
        await master.reached("b")
    assert commands(site.chassis) == ["drive", "pause", "continue"]
    for name in ("p1", "s1"):  # a state may have been published before they began
        assert statuses(site.recorder, name)[-2:] == ["RUNNING", "FINISHED"]


async def test_a_pause_holds_back_what_comes_with_it_and_after_it(site: Site) -> None:
    async with site.online(limits=AT_ONCE) as master:
        lift = action("liftTo", "lift", blocking="NONE", height=0.1)
        master.instant(action("startPause", "p"), lift)
        paused = await master.status("p", "FINISHED")
        assert paused["paused"]
        step = action("step", "step", distance=0.2)
        master.order([node("a", 0, *START, actions=[step]), node("b", 2, 7.0, -7.0)])
        await master.accepted("order")
        master.instant(action("stateRequest", "s"))
        held = await master.status("s", "FINISHED")
        assert held["paused"]
        assert status_of(held, "step") == "WAITING"
        assert commands(site.chassis) == []
        master.instant(action("stopPause", "r"))
        await master.status("lift", "FINISHED")
        await master.reached("b")
    sent = commands(site.chassis)
    assert sorted(sent[:2]) == ["lift_control3 execute", "step_control execute"]
    assert sent[2:] == ["drive"]


async def test_a_pause_also_pauses_what_the_robot_moves(site: Site) -> None:
    """In version 2.1, a paused action is reported as running."""
    async with site.online(limits=AT_ONCE) as master:
        master.instant(action("step", "step", distance=1.0, speed=0.02))
        await eventually(lambda: site.chassis.state.velocity.speed > 0.0)
        master.instant(action("startPause", "p"))
        paused = await master.status("p", "FINISHED")
        assert paused["paused"]
        where = site.chassis.state.odometer
        master.instant(action("stopPause", "r"))
        ended = await master.status("step", "FINISHED")
        assert status_of(ended, "r") == "FINISHED"
        assert site.chassis.state.odometer > where
    assert commands(site.chassis) == [
        f"step_control {each}" for each in ("execute", "pause", "resume")
    ]
    assert statuses(site.recorder, "step")[-2:] == ["RUNNING", "FINISHED"]


async def test_stop_pause_also_ends_a_pause_from_elsewhere(site: Site) -> None:
    async with site.online() as master:
        master.order([node("a", 0, *START), node("b", 2, 9.0, 7.0)])
        await master.wait_state(lambda state: state["driving"])
        site.chassis.call(lambda simulator: simulator.chassis.tasks.pause("a button", ordered=True))
        await master.wait_state(lambda state: state["paused"])
        master.instant(action("stopPause", "s"))
        await master.status("s", "FINISHED")
        await master.reached("b")
    assert commands(site.chassis) == ["drive", "continue"]


@pytest.mark.parametrize(
    ("by", "when"), [("button", "before"), ("stop", "before"), ("stop", "during")]
)
async def test_the_end_of_an_action_does_not_resume_a_drive_that_people_have_stopped(
    site: Site, by: str, when: str
) -> None:
    async def begin_to_speak() -> None:
        master.instant(action("speak", "words", text="caution"))
        await held.wait()

    held = Held(site.chassis, lambda out: out.request == full_name(Speak))
    async with site.online() as master:
        await site.drive(master)
        if when == "during":
            await begin_to_speak()
        if by == "button":
            site.chassis.call(lambda simulator: simulator.chassis.tasks.pause(by, ordered=True))
            await master.wait_state(lambda state: state["paused"])
        else:
            site.chassis.set_emergency_stop(True)
            await master.wait_state(lambda state: state["safetyState"]["eStop"] == "MANUAL")
            site.chassis.set_emergency_stop(False)
            await master.wait_state(lambda state: state["safetyState"]["eStop"] == "NONE")
        if when == "before":
            await begin_to_speak()
        held.release()
        await master.status("words", "FINISHED")
        await master.wait_state(lambda state: state["paused"])
        master.instant(action("stateRequest", "r"))
        await master.status("r", "FINISHED")
        sent = commands(site.chassis)
        assert sent == (["drive"] if when == "before" else ["drive", "pause"])
        set_speed(site.chassis, 20.0)
        master.instant(action("stopPause", "s"))
        await master.reached("b")
    assert commands(site.chassis) == [*sent, "continue"]


async def test_the_end_of_an_action_does_not_resume_a_drive_that_only_people_could_pause(
    site: Site,
) -> None:
    async with site.online() as master:
        await site.drive(master)
        site.chassis.refuse(ORDER, "not now")
        master.instant(action("speak", "words", text="caution"))
        await eventually(lambda: site.chassis.counts[ORDER])
        site.chassis.call(lambda simulator: simulator.chassis.tasks.pause("button", ordered=True))
        await master.status("words", "FINISHED")
        await master.wait_state(lambda state: state["paused"])
        assert "continue" not in commands(site.chassis)


async def test_a_drive_that_people_resume_during_an_action_goes_on_after_it(site: Site) -> None:
    async with site.online() as master, site.other_client() as gate:
        await site.drive(master)
        assert (await gate.request(ActionOrder(order=action_pb2.kPause))).ok
        await master.wait_state(lambda state: state["paused"])
        master.instant(action("liftTo", "lift", height=0.1, speed=0.1))
        await master.status("lift", "RUNNING")
        assert (await gate.request(ActionOrder(order=action_pb2.kContinue))).ok
        await eventually(lambda: commands(site.chassis)[3:] == ["continue", "pause"])
        set_speed(site.chassis, 20.0)
        await master.reached("b")
    assert commands(site.chassis)[5:] == ["continue"]


async def at_full_speed(
    master: Master,
    chassis: SimulatorThread,
    *,
    at_start: Sequence[Message] = (),
    at_end: Sequence[Message] = (),
) -> None:
    """Let the robot drive an order in real time, so that it brakes for a fifth of a second."""
    set_speed(chassis, 1.0)
    master.order([node("a", 0, *START, actions=at_start), node("b", 2, 9.0, -8.0, actions=at_end)])
    await drives(master, chassis)


async def drives(master: Master, chassis: SimulatorThread) -> None:
    """Wait until the robot is quick, and has reported that it drives."""
    await eventually(lambda: chassis.state.velocity.speed > 0.3)
    await master.wait_state(lambda state: state["driving"])


def at_the_end(master: Master, action_id: str) -> Message:
    """The first state in which an action has finished."""
    states = master.received["state"]
    return next(state for state in states if status_of(state, action_id) == "FINISHED")


@pytest.mark.parametrize("by_step", [False, True], ids=["of an order", "of a step"])
async def test_a_pause_is_finished_when_the_robot_stands(site: Site, by_step: bool) -> None:
    async with site.online(limits=AT_ONCE) as master:
        if by_step:
            set_speed(site.chassis, 1.0)
            master.instant(action("step", "step", distance=2.0, speed=0.5))
            await drives(master, site.chassis)
        else:
            await at_full_speed(master, site.chassis)
        master.instant(action("startPause", "p"))
        await master.status("p", "FINISHED")
        assert site.chassis.state.velocity.speed == 0.0
    state = at_the_end(master, "p")
    assert (state["paused"], state["driving"]) == (True, False)


async def test_an_order_is_cancelled_when_the_robot_stands_and_emptied_in_the_same_state(
    site: Site,
) -> None:
    lift = action("liftTo", "lift", blocking="NONE", height=0.2, speed=0.001)
    pick = action("pick", "pick", stationType="floor", loadType="EPAL")
    async with site.online(limits=AT_ONCE) as master:
        await at_full_speed(master, site.chassis, at_start=[lift], at_end=[pick])
        await master.status("lift", "RUNNING")
        master.instant(action("cancelOrder", "wrong", orderId="another"))
        refused = await master.status("wrong", "FAILED")
        assert "another" in result_of(refused, "wrong")

        master.instant(action("cancelOrder", "c", orderId="order"), action("cancelOrder", "too"))
        await master.status("c", "FINISHED")
        assert site.chassis.state.velocity.speed == 0.0
        state = at_the_end(master, "c")
        assert state["nodeStates"] == state["edgeStates"] == []
        assert not state["driving"]
        assert status_of(state, "too") == "FINISHED"
        assert status_of(state, "lift") == status_of(state, "pick") == "FAILED"
        states = master.received["state"]
        before = [each for each in states[: states.index(state)] if each["orderId"]]
        assert status_of(before[-1], "c") == "RUNNING"
        assert {nodes_left(each) for each in before} == {"b"}

        master.instant(action("cancelOrder", "again"))
        refused = await master.status("again", "FAILED")
        errors = [each for each in refused["errors"] if each["errorType"] == "noOrderToCancel"]
        assert references(errors[-1])["actionId"] == "again"
    sent = commands(site.chassis)
    assert sent[:2] == ["lift_control3 execute", "drive"]
    assert sorted(sent[2:]) == ["cancel", "lift_control3 cancel"]


async def test_a_robot_that_does_not_report_its_standstill_is_asked(site: Site) -> None:
    def without_standstill(frame: Outgoing) -> list[Outgoing]:
        twist = frame.body.twist if isinstance(frame.body, PoseSpeed) else None
        stands = twist is not None and not (twist.linear or twist.angular)
        return [] if stands and not frame.is_answer else [frame]

    async with site.online(limits=AT_ONCE) as master:
        await at_full_speed(master, site.chassis)
        site.chassis.intercept(without_standstill)
        asked = site.chassis.counts[full_name(PoseSpeed)]
        master.instant(action("cancelOrder", "c"))
        await master.status("c", "FINISHED")
        assert site.chassis.counts[full_name(PoseSpeed)] > asked
    assert not at_the_end(master, "c")["driving"]


async def test_a_blocking_instant_action_begins_when_the_robot_stands(site: Site) -> None:
    speeds: list[float] = []
    simulator = site.chassis.call(lambda simulator: simulator)

    def note_speed(out: Outgoing) -> list[Outgoing]:
        if out.request == full_name(CallAction):
            speeds.append(simulator.state.velocity.speed)
        return [out]

    async with site.online(limits=AT_ONCE) as master:
        site.chassis.intercept(note_speed)
        await at_full_speed(master, site.chassis)
        master.instant(action("liftTo", "lift", blocking="HARD", height=0.1))
        await master.status("lift", "FINISHED")
    assert speeds == [0.0]


async def test_a_pause_that_the_robot_refuses_fails_and_is_sent_until_the_robot_obeys(
    site: Site,
) -> None:
    timing = Timing(repeat_after=0.5, pause_within=0.2)
    async with site.online(timing=timing) as master:
        await site.drive(master)
        site.chassis.refuse(ORDER, "not now")
        master.instant(action("startPause", "p"))
        failed = await master.status("p", "FAILED")
        assert failed["driving"]
        assert not failed["paused"]
        assert error_types(failed) == ["actionError"]
        assert "stopPause" in result_of(failed, "p")
        await eventually(lambda: site.chassis.counts[ORDER] >= 2)
        site.chassis.clear_faults()
        paused = await master.wait_state(lambda state: state["paused"] and not state["driving"])
        assert nodes_left(paused) == "b"
        master.instant(action("stopPause", "s"))
        set_speed(site.chassis, 20.0)
        await master.reached("b")
    sent = commands(site.chassis)
    assert sent[0] == "drive"
    assert set(sent[1:-1]) == {"pause"}
    assert sent[-1] == "continue"


async def test_a_pause_of_a_step_that_the_robot_refuses_is_sent_until_the_robot_obeys(
    site: Site,
) -> None:
    async with site.online(timing=Timing(repeat_after=0.2, pause_within=0.5)) as master:
        set_speed(site.chassis, 1.0)
        master.instant(action("step", "step", distance=1.0, speed=0.02))
        await eventually(lambda: site.chassis.state.velocity.speed > 0.0)
        site.chassis.refuse(full_name(CallAction), "not now")
        master.instant(action("startPause", "p"))
        await master.status("p", "FAILED")
        site.chassis.clear_faults()
        await master.wait_state(lambda state: state["paused"] and not state["driving"])
        assert status_of(master.state, "step") == "RUNNING"


async def test_a_pause_that_the_robot_refuses_before_it_drives_is_sent_when_it_drives(
    lifelike: Site,
) -> None:
    """The robot reports a task up to a second after its start."""
    chassis = lifelike.chassis
    async with lifelike.online(timing=Timing(repeat_after=60)) as master:
        chassis.refuse(ORDER, "Request failed")
        set_speed(chassis, 0.1)
        master.order([node("a", 0, *START), node("b", 2, 9.0, 7.0)])
        await eventually(lambda: commands(chassis) == ["drive"])
        master.instant(action("startPause", "p"))
        await eventually(lambda: chassis.counts[ORDER])
        chassis.clear_faults()
        set_speed(chassis, 5.0)
        await master.status("p", "FINISHED")
    assert commands(chassis)[-2:] == ["pause", "pause"]


async def test_a_pause_that_the_robot_refuses_before_it_lifts_is_sent_when_it_lifts(
    site: Site,
) -> None:
    """The robot has accepted the action, but not reported it yet."""
    async with site.online(timing=Timing(repeat_after=60)) as master:
        held = Held(site.chassis, lambda out: isinstance(out.body, Feedbacks) and not out.is_answer)
        master.instant(action("liftTo", "lift", height=0.3, speed=0.001))
        await master.status("lift", "RUNNING")
        await held.wait()
        site.chassis.refuse(full_name(CallAction), "Request failed")
        master.instant(action("startPause", "p"))
        await eventually(lambda: site.chassis.counts[full_name(CallAction)] == 2)
        site.chassis.clear_faults()
        held.release()
        await master.status("p", "FINISHED")
    assert commands(site.chassis) == [
        f"lift_control3 {each}" for each in ("execute", "pause", "pause")
    ]


async def test_an_action_that_the_robot_does_not_resume_stays_paused_until_it_does(
    site: Site,
) -> None:
    async with site.online(timing=Timing(pause_within=0.5)) as master:
        master.instant(action("step", "step", distance=1.0, speed=0.02))
        await eventually(lambda: site.chassis.state.velocity.speed > 0.0)
        master.instant(action("startPause", "p1"))
        await master.status("p1", "FINISHED")
        site.chassis.refuse(full_name(CallAction), "not now")
        master.instant(action("stopPause", "s1"))
        failed = await master.status("s1", "FAILED")
        assert failed["paused"]
        master.instant(action("startPause", "p2"))
        await master.status("p2", "FINISHED")
        site.chassis.clear_faults()
        master.instant(action("stopPause", "s2"))
        await master.status("s2", "FINISHED")
        await master.status("step", "FINISHED")


async def test_a_pause_is_not_finished_by_what_was_reported_before_the_link_was_lost(
    site: Site,
) -> None:
    async with site.online() as master:
        await site.drive(master)
        master.instant(action("startPause", "before"))
        await master.status("before", "FINISHED")
        async with site.without_link(master):  # people may let the robot go on now
            master.instant(action("startPause", "without"))
            await master.status("without", "RUNNING")
            await asyncio.sleep(0.3)
            assert status_of(master.state, "without") == "RUNNING"
        await master.status("without", "FINISHED")
    assert commands(site.chassis) == ["drive", "pause"]


async def test_a_stop_pause_without_a_link_does_not_fail_before_it_is_carried_out(
    site: Site,
) -> None:
    async with site.online(timing=Timing(pause_within=0.2)) as master:
        await site.drive(master, then=1.0)
        master.instant(action("startPause", "p"))
        await eventually(lambda: status_of(master.state, "p"))
        await master.wait_state(lambda state: state["paused"] and not state["driving"])
        async with site.without_link(master):
            master.instant(action("stopPause", "s"))
            await master.status("s", "RUNNING")
            await asyncio.sleep(0.5)
            assert status_of(master.state, "s") == "RUNNING"
        await eventually(lambda: commands(site.chassis) == ["drive", "pause", "continue"])
        set_speed(site.chassis, 20.0)
        await master.reached("b")
    assert statuses(site.recorder, "s")[-1] == "FINISHED"


async def test_the_last_of_a_stop_pause_and_a_start_pause_counts(lifelike: Site) -> None:
    """The robot obeys half a second later."""
    chassis = lifelike.chassis
    set_speed(chassis, 1.0)
    async with lifelike.online() as master:
        master.order([node("a", 0, *START), node("b", 2, 9.0, 7.0)])
        await master.wait_state(lambda state: state["driving"])
        master.instant(action("startPause", "p1"))
        await master.status("p1", "FINISHED")
        master.instant(action("stopPause", "s1"))
        await eventually(lambda: commands(chassis) == ["drive", "pause", "continue"])
        master.instant(action("startPause", "p2"))
        await master.status("p2", "FINISHED")
        assert commands(chassis)[3:4] == ["pause"]
        await eventually(lambda: chassis.state.velocity.speed == 0.0)
        master.instant(action("stopPause", "s2"))
        resumed = await master.status("s2", "FINISHED")
        assert not resumed["paused"]
    assert commands(chassis)[-1] == "continue"


async def test_a_robot_that_drives_on_in_a_pause_is_paused_again(site: Site) -> None:
    async with site.online() as master, site.other_client() as gate:
        await site.drive(master)
        master.instant(action("startPause", "p"))
        await master.status("p", "FINISHED")
        assert (await gate.request(ActionOrder(order=action_pb2.kContinue))).ok
        await eventually(lambda: commands(site.chassis) == ["drive", "pause", "continue", "pause"])
        await master.wait_state(lambda state: state["paused"] and not state["driving"])


async def test_a_pause_that_was_not_obeyed_yet_survives_a_kill(site: Site, tmp_path: Path) -> None:
    async with Master(site.broker.port) as master:
        async with site.vehicle(state_folder=tmp_path / "state"):
            await site.drive(master)
            site.chassis.refuse(ORDER, "not now")
            master.instant(action("startPause", "p"))
            await eventually(lambda: site.chassis.counts[ORDER])
            left = left_by_a_kill(tmp_path / "state")
        site.chassis.clear_faults()
        master.received.clear()
        sent = len(commands(site.chassis))
        async with site.vehicle(state_folder=left):
            await eventually(lambda: commands(site.chassis)[sent:] == ["pause"])
            paused = await master.wait_state(lambda state: state["paused"])
            assert nodes_left(paused) == "b"


async def test_a_cancellation_that_a_kill_interrupts_is_finished_after_the_restart(
    site: Site, tmp_path: Path
) -> None:
    async with Master(site.broker.port) as master, site.other_client() as gate:
        async with site.vehicle(state_folder=tmp_path / "state"):
            await site.drive(master)
            site.chassis.refuse(ORDER, "not now")
            master.instant(action("cancelOrder", "c"))
            await eventually(lambda: site.chassis.counts[ORDER])
            left = left_by_a_kill(tmp_path / "state")
        site.chassis.clear_faults()
        master.received.clear()
        set_speed(site.chassis, 20.0)
        assert (await gate.request(ActionOrder(order=action_pb2.kCancel))).ok
        await site.idle()
        async with site.vehicle(state_folder=left):
            ended = await master.status("c", "FINISHED")
            assert (ended["nodeStates"], ended["errors"]) == ([], [])


async def test_an_order_is_interrupted_by_a_kill_while_a_blocking_instant_action_runs(
    site: Site, tmp_path: Path
) -> None:
    lift = action("liftTo", "lift", blocking="HARD", height=0.3, speed=0.001)
    async with Master(site.broker.port) as master:
        async with site.vehicle(state_folder=tmp_path / "state"):
            await site.drive(master)
            master.instant(lift)
            await master.status("lift", "RUNNING")
            left = left_by_a_kill(tmp_path / "state")
        master.received.clear()
        async with site.vehicle(state_folder=left):
            state = await master.error("interruptedError")
            assert status_of(state, "lift") == "FAILED"
            assert nodes_left(state) == "b"
            set_speed(site.chassis, 20.0)
            master.instant(action("cancelOrder", "c"))
            ended = await master.status("c", "FINISHED")
            assert (ended["nodeStates"], ended["lastNodeId"]) == ([], "a")
    sent = commands(site.chassis)
    assert sent[:3] == ["drive", "pause", "lift_control3 execute"]
    assert sorted(sent[3:]) == ["cancel", "lift_control3 cancel"]
