"""The link to the robot is lost, answers are missing, or another robot answers."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest

from tests.asynchronous import eventually
from tests.quick_chassis import edit_bodies, quick_config, set_speed
from tests.vda5050.chassis_events import commands, received
from tests.vda5050.conftest import EXEC, LEG, ORDER, Site, scene_with_start
from tests.vda5050.master import (
    START,
    Master,
    Message,
    action,
    edge,
    error_types,
    node,
    nodes_left,
    references,
    result_of,
    status_of,
)
from woosh_robot_agent.link import ChassisClient
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.link.tasks import LARGE
from woosh_robot_agent.motion import timeliness
from woosh_robot_agent.motion.timeliness import boot_time
from woosh_robot_agent.pb.map.map_pack_pb2 import SceneData, SceneList
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ChangeNavMode, ExecTask, InitRobot
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo, RobotState, TaskHistory, TaskProc
from woosh_robot_agent.pb.ros import action_pb2
from woosh_robot_agent.pb.ros.action_pb2 import StepControl
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction, Feedbacks, kRosSuccess
from woosh_robot_agent.pb.util import action_pb2 as action_state_pb2
from woosh_robot_agent.pb.util import robot_pb2, task_pb2
from woosh_robot_agent.simulator import SimulatedChassis, SimulatorThread
from woosh_robot_agent.simulator.serving.exchange import Outgoing
from woosh_robot_agent.simulator.world.geometry import Pose
from woosh_robot_agent.vda5050.actions import runner
from woosh_robot_agent.vda5050.robot.link import Timing

FEEDBACKS = "woosh.ros.Feedbacks"
SPEAK = "woosh.robot.Speak"
SCENE_DATA = "woosh.map.SceneData"
NEW = 30002
"""Id, and serial number, of the robot that replaces the other one."""
FOREIGN = 7777
"""Id of a task of another client."""
Restart = Callable[..., SimulatorThread]


@pytest.fixture
def restart(chassis: SimulatorThread) -> Iterator[Restart]:
    """Function that stops the chassis, and starts another one at its address."""
    with ExitStack() as stack:

        def start(**options: object) -> SimulatorThread:
            port = chassis.port
            chassis.stop()
            return stack.enter_context(
                SimulatorThread(quick_config(port=port, tcp_port=0, **options))
            )

        yield start


def is_connected(state: Message) -> bool:
    return "robotConnectionError" not in error_types(state)


async def test_an_order_goes_on_when_the_robot_has_arrived_without_a_link(site: Site) -> None:
    async with site.online() as master:
        await site.drive(master)
        async with site.without_link(master):
            assert "velocity" not in master.state
            assert nodes_left(master.state) == "b"
            set_speed(site.chassis, 20.0)
            await eventually(lambda: abs(site.chassis.state.pose.x - 8.0) < 0.05)
        await master.wait_state(is_connected)
        ended = await master.reached("b")
        assert ended["errors"] == []
    assert site.chassis.counts[EXEC] == 1


async def test_an_order_that_comes_without_a_link_starts_later_and_once(site: Site) -> None:
    async with site.online() as master:
        async with site.without_link(master):
            words = action("speak", "words", text="ready")
            master.order([node("a", 0, *START, actions=[words]), node("b", 2, 6.0, -7.0)])
            await master.status("words", "WAITING")
        ended = await master.reached("b")
        assert status_of(ended, "words") == "FINISHED"
    assert site.chassis.state.spoken == ("ready",)
    assert site.chassis.counts[EXEC] == 1


@pytest.mark.parametrize("is_long", [False, True])
async def test_an_action_that_comes_during_a_long_loss_of_the_link_is_not_begun_later(
    site: Site, monkeypatch: pytest.MonkeyPatch, is_long: bool
) -> None:
    if is_long:
        monkeypatch.setattr(runner, "_MAX_LOSS", 0.0)
    async with site.online() as master:
        async with site.without_link(master):
            place = {"x": 0.0, "y": 0.0, "theta": 0.0, "mapId": "wooshmap"}
            master.instant(
                action("step", "step", distance=0.2), action("initPosition", "i", **place)
            )
            for each in "step", "i":
                state = await master.status(each, "FAILED" if is_long else "WAITING")
                assert ("no link to the robot for" in result_of(state, each)) == is_long
        await master.wait_state(is_connected)
        master.instant(action("step", "next", distance=0.2))
        await master.status("next", "FINISHED")
    assert len(received(site.chassis, CallAction)) == (1 if is_long else 2)
    assert site.chassis.counts[full_name(InitRobot)] == (0 if is_long else 1)


@pytest.mark.parametrize("suspended", [False, True], ids=["no link", "computer suspended"])
async def test_a_step_that_waits_for_another_is_not_begun_after_a_long_loss_of_the_link(
    site: Site, monkeypatch: pytest.MonkeyPatch, suspended: bool
) -> None:
    set_speed(site.chassis, 0.2)
    async with site.online() as master:
        steps = {"blocking": "SOFT", "distance": 0.2, "speed": 0.02}
        master.instant(action("step", "one", **steps), action("step", "two", **steps))
        await master.status("one", "RUNNING")
        await master.status("two", "INITIALIZING")
        if suspended:
            monkeypatch.setattr(timeliness, "boot_time", lambda: boot_time() + 3600.0)
        else:
            monkeypatch.setattr(runner, "_MAX_LOSS", 0.0)
            # as if the clock had been set back during the loss
            monkeypatch.setattr(ChassisClient, "since", time.time() + 7200.0)
            async with site.without_link(master):
                state = await master.status("two", "FAILED")
                assert status_of(state, "one") == "RUNNING"
        set_speed(site.chassis, 20.0)
        await master.status("one", "FINISHED")
        state = await master.status("two", "FAILED")
        cause = "the connector was suspended" if suspended else "there was no link to the robot"
        assert cause in result_of(state, "two")
    assert len(received(site.chassis, CallAction)) == 1


async def test_a_step_whose_start_was_not_answered_goes_on_after_a_long_loss_of_the_link(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_speed(site.chassis, 1.0)
    silent = ["woosh.ros.CallAction", "woosh.ros.Feedbacks"]
    site.chassis.intercept(lambda out: [] if {out.type, out.request} & {*silent} else [out])
    async with site.online() as master:
        master.instant(action("step", "step", distance=0.6, speed=0.02))
        await eventually(lambda: site.chassis.state.velocity.speed > 0.0)
        async with site.without_link(master):
            monkeypatch.setattr(runner, "_MAX_LOSS", 0.0)
            silent.clear()
        set_speed(site.chassis, 20.0)
        await master.status("step", "FINISHED")
    assert commands(site.chassis) == ["step_control execute"]


async def test_an_order_that_comes_without_a_link_does_not_start_elsewhere(site: Site) -> None:
    """Even if the first report of the new link is so large that it takes time to be decoded."""
    large = "x" * LARGE
    async with site.online() as master:
        async with site.without_link(master):
            master.order(LEG)
            await master.accepted()
            pose = Pose(START[0] + 2.0, START[1], 0.0)
            site.chassis.call(lambda simulator: simulator.chassis.localise(pose))
            edit_bodies(
                site.chassis, RobotInfo, lambda info: setattr(info.network, "sch_ip", large)
            )
        await master.error("interruptedError")
    assert site.chassis.counts[EXEC] == 0


@pytest.mark.parametrize("place", [START, (0.0, 0.0)])
async def test_an_order_waits_for_a_robot_that_comes_back_without_its_position(
    site: Site, place: tuple[float, float]
) -> None:
    """It goes on only if the master control finds the robot where the order stopped."""

    def switched_off_and_on(simulator: SimulatedChassis) -> None:
        simulator.chassis.localise(Pose(0.0, 0.0, 0.0))
        simulator.chassis.lose_localisation()

    async with site.online() as master:
        async with site.without_link(master):
            master.order(LEG)
            await master.accepted()
            site.chassis.call(switched_off_and_on)
        await master.wait_state(lambda state: "does not know its position" in str(state["errors"]))
        assert "interruptedError" not in error_types(master.state)
        x, y = place
        master.instant(action("initPosition", "i", x=x, y=y, theta=0.0, mapId="wooshmap"))
        if place == START:
            ended = await master.reached("b")
            assert ended["errors"] == []
        else:
            await master.error("interruptedError")
    assert site.chassis.counts[EXEC] == (1 if place == START else 0)


async def test_an_order_does_not_go_on_if_the_robot_restarts_elsewhere_while_an_action_runs(
    site: Site, restart: Restart, tmp_path: Path
) -> None:
    words = action("speak", "words", blocking="SOFT", text="ready")
    async with site.online() as master:
        site.chassis.mute(SPEAK)
        master.order([node("a", 0, *START, actions=[words]), node("b", 2, 8.0, -7.5)])
        await eventually(lambda: site.chassis.counts[SPEAK])
        lift = action("liftTo", "lift", blocking="NONE", height=0.5, speed=0.001)
        master.instant(lift)
        await master.status("lift", "RUNNING")
        scene = scene_with_start(tmp_path / "scene", f"6.0, {START[1]}, 0.0")
        restarted = restart(scenes=(scene,))
        await master.error("interruptedError")
        assert restarted.counts[EXEC] == 0


async def test_a_node_that_was_passed_without_a_link_counts_when_the_robot_is_known_to_drive_on(
    site: Site,
) -> None:
    y = START[1]
    order = [node("a", 0, *START), node("b", 2, 5.2, y), node("c", 4, 6.0, y), node("d", 6, 9.0, y)]
    async with site.online() as master:
        await site.drive(master, order)
        async with site.without_link(master):
            set_speed(site.chassis, 1.0)
            await eventually(lambda: site.chassis.state.pose.x > 5.9)
            set_speed(site.chassis, 0.01)
            assert master.state["lastNodeId"] == "a"
        state = await master.wait_state(lambda state: state["lastNodeId"] != "a")
        assert state["lastNodeId"] == "c"
        assert nodes_left(state) == "d"
        assert site.chassis.counts[EXEC] == 1


async def test_a_start_without_an_answer_is_found_out_and_not_repeated(site: Site) -> None:
    site.chassis.mute(EXEC)
    timing = Timing(minimum_timeouts={})
    async with site.online(request_timeout=1.0, timing=timing) as master:
        await site.drive(master)
        await eventually(lambda: site.chassis.counts["woosh.robot.TaskProc"])
        set_speed(site.chassis, 20.0)
        ended = await master.reached("b")
        assert ended["errors"] == []
    assert site.chassis.counts[EXEC] == 1


def hide_tasks(
    chassis: SimulatorThread, *, pushes: bool = True, state: robot_pb2.State = robot_pb2.kIdle
) -> Callable[[], None]:
    """Let a chassis tell nothing of its tasks; return a function that ends this.

    Args:
        state: the state that it reports.
        pushes: False if its pushes still tell of them, and its state that it executes a task.
    """

    def without_tasks(frame: Outgoing) -> list[Outgoing]:
        if isinstance(frame.body, RobotInfo | RobotState) and pushes:
            frame.body.state = state
        if isinstance(frame.body, RobotInfo):
            frame.body.ClearField("task_proc")
        elif isinstance(frame.body, TaskProc | TaskHistory) and frame.is_answer:
            return [replace(frame, body=type(frame.body)())]
        elif isinstance(frame.body, TaskProc) and pushes:
            return []
        return [frame]

    return chassis.intercept(without_tasks)


IMPATIENT = Timing(check_every=0.3, ask_every=0.2, give_up_after=0.5)
"""For a vehicle that asks the robot often, and soon gives up what the robot does not know."""


async def next_order(site: Site, master: Master, *, answers: bool) -> None:
    """Cancel the order; the next one must not wait for what has ended.

    Args:
        answers: False if the robot does not answer as long as it has faults.
    """
    master.instant(action("cancelOrder", "cancel"))
    await master.status("cancel", "FINISHED")
    pose = site.chassis.state.pose
    master.order([node("p", 0, pose.x, pose.y), node("q", 2, 8.0, -7.0)], order_id="next")
    if not answers:
        await master.error("robotBusyError")
    site.chassis.clear_faults()
    await master.reached("q")


@pytest.mark.parametrize("answers", [True, False])
async def test_a_task_that_the_robot_drops_without_a_report_is_an_error_and_nothing_waits_for_it(
    site: Site, answers: bool
) -> None:
    """Even if the robot does not tell its state for some time."""
    async with site.online(request_timeout=1.0, timing=IMPATIENT) as master:
        await site.drive(master)
        show = hide_tasks(site.chassis)
        if not answers:
            site.chassis.mute(full_name(RobotInfo))
        site.chassis.call(lambda simulator: simulator.chassis.tasks.cancel("a restart"))
        state = await master.error("drivingError")
        assert nodes_left(state) == "b"
        assert "does not know the task" in str(state["errors"])
        assert site.chassis.counts[EXEC] == 1
        show()
        set_speed(site.chassis, 20.0)
        await next_order(site, master, answers=answers)


def lose_ends(chassis: SimulatorThread) -> None:
    """Let a chassis push no report on the end of a task or an action, nor on the wait before it."""

    def without_ends(frame: Outgoing) -> list[Outgoing]:
        body, ends = frame.body, False
        if isinstance(body, TaskProc):
            is_driving = body.action.state == action_state_pb2.kRosExecuting
            ends = body.state != task_pb2.kExecuting or not is_driving
        elif isinstance(body, Feedbacks):
            ends = any(each.state == kRosSuccess for each in body.fbs)
        return [] if ends and not frame.is_answer else [frame]

    chassis.intercept(without_ends)


@pytest.mark.parametrize("kind", ["step", "pick"])
async def test_no_drive_waits_for_what_has_ended_without_a_report(site: Site, kind: str) -> None:
    """Neither for a drive, nor for a task or step of an action.

    The speed limit of the next drive waits for this drive: a real robot would refuse it before.
    """
    lose_ends(site.chassis)
    work = {
        "step": action("step", "work", distance=0.2),
        "pick": action("pick", "work", stationName="U5"),
    }[kind]
    async with site.online(timing=IMPATIENT) as master:
        nodes = [
            node("a", 0, *START),
            node("b", 2, 2.0, -7.0, actions=[work]),
            node("c", 4, 2.0, -6.0),
        ]
        ways = zip(pairwise(nodes), (0.8, 0.5), strict=True)
        master.order(nodes, [edge(*way, maxSpeed=speed) for way, speed in ways])
        state = await master.reached("c")
        assert status_of(state, "work") == "FINISHED"
    assert len(received(site.chassis, ChangeNavMode)) == 2


async def test_an_obstacle_does_not_outlast_a_task_that_has_ended_without_a_report(
    site: Site,
) -> None:

    def without_other_pushes(frame: Outgoing) -> list[Outgoing]:
        is_other = isinstance(frame.body, TaskProc) and frame.body != blocked
        return [] if is_other and not frame.is_answer else [frame]

    async with site.online(timing=IMPATIENT) as master:
        await site.drive(master)
        blocked = TaskProc()
        blocked.CopyFrom(site.chassis.call(lambda each: each.chassis.tasks.reported))
        blocked.action.state = action_state_pb2.kRosWarning
        site.chassis.intercept(without_other_pushes)
        site.chassis.call(lambda each: each.chassis.emit(blocked))
        await master.error("obstacleError")
        set_speed(site.chassis, 20.0)
        ended = await master.reached("b")
        assert ended["errors"] == []


async def test_a_task_of_which_only_pushes_tell_goes_on(site: Site) -> None:
    async with site.online(timing=IMPATIENT) as master:
        hide_tasks(site.chassis, pushes=False)
        await site.drive(master, then=0.02)
        asked = site.chassis.counts[full_name(TaskHistory)]
        await eventually(lambda: site.chassis.counts[full_name(TaskHistory)] > asked + 4)
        set_speed(site.chassis, 20.0)
        ended = await master.reached("b")
        assert ended["errors"] == []
    assert site.chassis.counts[ORDER] == 0


async def test_a_cancelled_order_ends_though_the_robot_stays_in_a_task_that_it_does_not_name(
    site: Site,
) -> None:
    async with site.online(timing=replace(IMPATIENT, repeat_after=0.3)) as master:
        hide_tasks(site.chassis, state=robot_pb2.kTask)
        await site.drive(master)
        asked = site.chassis.counts[full_name(TaskHistory)]
        await eventually(lambda: site.chassis.counts[full_name(TaskHistory)] > asked + 3)
        assert master.state["errors"] == []
        site.chassis.refuse(ORDER, "Request failed")
        master.instant(action("cancelOrder", "cancel"))
        await eventually(lambda: site.chassis.counts[ORDER] > 2)
        assert status_of(master.state, "cancel") == "RUNNING"
        sent = site.chassis.counts[ORDER]
        site.chassis.clear_faults()
        await eventually(lambda: site.chassis.counts[ORDER] > sent)  # before it arrives
        set_speed(site.chassis, 20.0)
        await master.status("cancel", "FINISHED")


async def test_a_task_that_the_robot_begins_too_late_is_cancelled(
    site: Site,
) -> None:
    async with site.online(timing=Timing(check_every=0.5)) as master:
        show = hide_tasks(site.chassis)
        await site.drive(master, then=0.02)
        await master.error("drivingError")
        show()
        site.chassis.call(lambda each: each.chassis.emit(each.chassis.tasks.reported))
        await eventually(lambda: site.chassis.counts[ORDER])
        set_speed(site.chassis, 20.0)
        await site.idle()
        state = await master.wait_state(lambda state: not state["driving"])
        assert nodes_left(state) == "b"
    assert site.chassis.state.pose.x < 7.9
    assert site.chassis.counts[EXEC] == 1


async def test_a_pause_does_not_hit_a_foreign_task_if_the_robot_refuses_to_tell_its_task(
    site: Site,
) -> None:
    def refuse_to_tell(frame: Outgoing) -> list[Outgoing]:
        if frame.request == full_name(TaskProc):
            return [replace(frame, ok=False, body=TaskProc())]
        is_own = isinstance(frame.body, TaskProc) and frame.body.robot_task_id != FOREIGN
        return [] if is_own and not frame.request else [frame]

    async with site.online(timing=Timing(pause_within=0.3)) as master:
        await site.drive(master, then=0.02)
        site.chassis.intercept(refuse_to_tell)
        asked = site.chassis.counts[full_name(TaskProc)]
        report = TaskProc(robot_task_id=FOREIGN, state=task_pb2.kExecuting)
        site.chassis.call(lambda each: each.chassis.emit(report))
        await eventually(lambda: site.chassis.counts[full_name(TaskProc)] > asked)
        await asyncio.sleep(0.1)  # the answer arrives
        master.instant(action("startPause", "p"))
        await eventually(lambda: status_of(master.state, "p") in ("FAILED", "FINISHED"))
        assert site.chassis.counts[ORDER] == 0


@pytest.mark.parametrize("is_drive", [False, True])
async def test_no_action_begins_a_task_while_one_that_began_too_late_is_cancelled(
    site: Site, is_drive: bool
) -> None:
    site.stand_at_charger()
    async with site.online(timing=IMPATIENT) as master:
        show = hide_tasks(site.chassis)
        set_speed(site.chassis, 0.02)
        if is_drive:
            master.order([node("a", 0, -9.5, 0.5), node("b", 2, -8.0, 0.5)])
            await master.error("drivingError")
        else:
            master.instant(action("startCharging", "late"))
            await master.status("late", "FAILED")
        site.chassis.call(lambda simulator: simulator.chassis.tasks.pause("it stands"))
        set_speed(site.chassis, 20.0)
        site.chassis.refuse(ORDER, "Request failed")
        show()
        (late,) = received(site.chassis, ExecTask)
        report = TaskProc(robot_task_id=late.task_id, state=task_pb2.kExecuting)
        site.chassis.call(lambda each: each.chassis.emit(report))
        await eventually(lambda: site.chassis.counts[ORDER])
        master.instant(action("startCharging", "next"))
        await master.status("next", "INITIALIZING")
        await eventually(lambda: site.chassis.counts[ORDER] > 1)
        assert site.chassis.counts[EXEC] == 1
        site.chassis.clear_faults()
        await master.status("next", "FINISHED")


def hide_actions(chassis: SimulatorThread, answer: Feedbacks, *, pushes: bool = True) -> None:
    """Let a chassis answer all queries about its actions alike, and push nothing of them.

    Args:
        answer: the answer.
        pushes: False if its pushes still tell of them.
    """

    def without_actions(frame: Outgoing) -> list[Outgoing]:
        if isinstance(frame.body, Feedbacks) and frame.is_answer:
            return [replace(frame, body=answer)]
        return [] if isinstance(frame.body, Feedbacks) and pushes else [frame]

    chassis.intercept(without_actions)


@pytest.mark.parametrize("begun", [True, False])
async def test_an_action_that_the_robot_drops_without_a_report_fails(
    site: Site, begun: bool
) -> None:
    async with site.online(timing=IMPATIENT) as master:
        if not begun:
            hide_actions(site.chassis, Feedbacks())
        master.instant(action("step", "step", distance=1.0, speed=0.02))
        await eventually(lambda: site.chassis.state.velocity.speed > 0.0)
        if begun:  # it knows the action when it is asked
            await eventually(lambda: site.chassis.counts[FEEDBACKS] > 2)
        hide_actions(site.chassis, Feedbacks())
        state = await master.status("step", "FAILED")
        assert "does not tell how it ended" in result_of(state, "step")


@pytest.mark.parametrize("answers", [True, False])
async def test_no_order_waits_for_an_action_that_the_robot_has_dropped_without_a_report(
    site: Site, answers: bool
) -> None:
    """Even if it does not answer its cancellation for some time."""
    timing = replace(IMPATIENT, minimum_timeouts={})
    async with site.online(request_timeout=1.0, timing=timing) as master:
        step = action("step", "step", distance=1.0, speed=0.02)
        master.order([node("a", 0, *START, actions=[step]), node("b", 2, 8.0, -7.0)])
        await eventually(lambda: site.chassis.state.velocity.speed > 0.0)
        await eventually(lambda: site.chassis.counts[FEEDBACKS] > 2)
        hide_actions(site.chassis, Feedbacks())
        site.chassis.call(
            lambda simulator: simulator.chassis.actions.cancel(full_name(StepControl))
        )
        if not answers:
            site.chassis.mute(full_name(CallAction))
        await master.status("step", "FAILED")
        await next_order(site, master, answers=answers)


async def test_the_cancel_of_an_action_of_unknown_end_goes_on_after_a_lost_link(site: Site) -> None:
    set_speed(site.chassis, 1.0)
    timing = replace(IMPATIENT, minimum_timeouts={})
    async with site.online(request_timeout=1.0, timing=timing) as master:
        master.instant(action("step", "step", distance=1.0, speed=0.02))
        await eventually(lambda: site.chassis.state.velocity.speed > 0.0)
        await eventually(lambda: site.chassis.counts[FEEDBACKS] > 2)
        hide_actions(site.chassis, Feedbacks())
        site.chassis.mute(full_name(CallAction))
        await master.status("step", "FAILED")
        await eventually(lambda: "step_control cancel" in commands(site.chassis))
        async with site.without_link(master):
            sent = len(commands(site.chassis))
            site.chassis.accept(full_name(CallAction))
        await eventually(lambda: commands(site.chassis)[sent:] == ["step_control cancel"])


async def test_an_action_of_which_only_pushes_tell_goes_on(site: Site) -> None:
    async with site.online(timing=IMPATIENT) as master:
        hide_actions(site.chassis, Feedbacks(), pushes=False)
        set_speed(site.chassis, 1.0)
        master.instant(action("step", "step", distance=0.5, speed=0.02))
        await eventually(lambda: site.chassis.counts[FEEDBACKS] > 5)
        assert status_of(master.state, "step") == "RUNNING"
        set_speed(site.chassis, 20.0)
        await master.status("step", "FINISHED")


async def test_a_cancelled_order_ends_though_the_robot_never_names_its_action(site: Site) -> None:
    async with site.online(timing=replace(IMPATIENT, repeat_after=0.3)) as master:
        hide_actions(site.chassis, Feedbacks(), pushes=False)
        set_speed(site.chassis, 1.0)
        step = action("step", "step", distance=1.0, speed=0.02)
        master.order([node("a", 0, *START, actions=[step])])
        await eventually(lambda: site.chassis.state.velocity.speed > 0.0)
        await eventually(lambda: site.chassis.counts[FEEDBACKS] > 5)
        hide_actions(site.chassis, Feedbacks())
        site.chassis.refuse(full_name(CallAction), "Request failed")
        master.instant(action("cancelOrder", "cancel"))
        await eventually(lambda: site.chassis.counts[full_name(CallAction)] > 3)
        assert status_of(master.state, "step") == "RUNNING"
        site.chassis.clear_faults()
        await master.status("cancel", "FINISHED")


async def test_a_cancelled_order_ends_though_the_robot_answers_nothing_about_its_action(
    site: Site,
) -> None:
    async with site.online(
        request_timeout=1.0, timing=replace(IMPATIENT, minimum_timeouts={})
    ) as master:
        hide_actions(site.chassis, Feedbacks())
        site.chassis.mute(full_name(CallAction))
        step = action("step", "step", distance=1.0, speed=0.02)
        master.order([node("a", 0, *START, actions=[step])])
        await eventually(lambda: site.chassis.counts[full_name(CallAction)])
        master.instant(action("cancelOrder", "cancel"))
        await master.status("cancel", "FINISHED")


async def test_the_end_of_an_earlier_action_does_not_end_the_next_one(site: Site) -> None:
    async with site.online() as master:
        master.instant(action("step", "first", distance=0.2))
        await master.status("first", "FINISHED")
        last = site.chassis.call(lambda simulator: simulator.chassis.actions.last)
        hide_actions(site.chassis, Feedbacks(fbs=last.values()))
        master.instant(action("step", "next", distance=1.0, speed=0.02))
        await master.status("next", "RUNNING")
        site.chassis.drop()
        await master.status("next", "FAILED")


async def test_the_end_of_an_action_before_the_start_of_the_vehicle_ends_no_action(
    site: Site,
) -> None:
    async with site.other_client() as other:
        command = StepControl(action=action_pb2.kExecute)
        command.steps.add(mode=StepControl.Step.kStraight, value=0.2)
        await other.request(CallAction(step_control=command))
        actions = site.chassis.call(lambda simulator: simulator.chassis.actions)
        await eventually(
            lambda: kRosSuccess in [each.state for each in list(actions.last.values())]
        )
    async with site.online(timing=IMPATIENT) as master:
        hide_actions(site.chassis, Feedbacks(fbs=actions.last.values()))
        master.instant(action("step", "step", distance=1.0, speed=0.02))
        await eventually(lambda: status_of(master.state, "step") in ("FINISHED", "FAILED"))
        assert "does not tell how it ended" in result_of(master.state, "step")


async def test_a_cancel_is_repeated_until_the_robot_obeys(site: Site) -> None:
    async with site.online() as master:
        await site.drive(master)
        site.chassis.refuse(ORDER, "Request failed")
        master.instant(action("cancelOrder", "cancel"))
        await eventually(lambda: site.chassis.counts[ORDER] >= 2)
        assert status_of(master.state, "cancel") == "RUNNING"
        site.chassis.clear_faults()
        set_speed(site.chassis, 20.0)
        state = await master.status("cancel", "FINISHED")
        assert state["nodeStates"] == []
        assert state["lastNodeId"] == "a"
    assert site.chassis.counts[EXEC] == 1


async def test_a_cancel_without_a_link_is_carried_out_later(site: Site) -> None:
    async with site.online() as master:
        await site.drive(master)
        async with site.without_link(master):
            master.instant(action("cancelOrder", "cancel"))
            await master.status("cancel", "RUNNING")
        await eventually(lambda: site.chassis.counts[ORDER])
        set_speed(site.chassis, 20.0)
        state = await master.status("cancel", "FINISHED")
        assert state["lastNodeId"] == "a"
    assert site.chassis.state.pose.x < 7.9


async def test_an_obstacle_that_blocks_the_way_is_reported_until_it_is_gone(site: Site) -> None:
    set_speed(site.chassis, 1.0)
    async with site.online() as master:
        start, end = node("a", 0, *START), node("b", 2, START[0] + 1.0, START[1])
        obstacle = site.chassis.inject("obstacle", x=START[0] + 1.5, y=START[1], radius=0.3)
        points = [{"x": START[0] + x, "y": START[1]} for x in (0.0, 1.0)]
        line = {"degree": 1, "knotVector": [0, 0, 1, 1], "controlPoints": points}
        master.order([start, end], [edge(start, end, trajectory=line)])  # not driven round
        state = await master.error("obstacleError")
        (error,) = state["errors"]
        assert error["errorLevel"] == "WARNING"
        assert references(error) == {"orderId": "order", "nodeId": "b"}
        assert not state["paused"]
        obstacle.clear()
        state = await master.reached("b")
        assert state["errors"] == []


async def test_the_factsheet_names_the_firmware_with_which_the_robot_comes_back(site: Site) -> None:
    async with site.online() as master:
        async with site.without_link(master):
            version = "as updated"
            edit_bodies(
                site.chassis, RobotInfo, lambda info: setattr(info.genral.version, "rc", version)
            )
        await eventually(lambda: version in str(master.last("factsheet")))


async def test_another_robot_at_the_address_is_refused(site: Site, restart: Restart) -> None:
    async with site.online() as master:
        await site.drive(master)
        replacement = restart(robot_id=NEW)
        state = await master.wait_state(lambda state: f"robot {NEW}" in str(state["errors"]))
        (error,) = state["errors"]
        assert error["errorType"] == "robotConnectionError"
        assert "robot 30001" in error["errorDescription"]
        assert "restart" in error["errorDescription"]
        assert nodes_left(state) == "b"
        master.instant(action("cancelOrder", "cancel"), action("speak", "words", text="hello"))
        await master.status("words", "WAITING")
    assert replacement.counts[EXEC] == replacement.counts[ORDER] == 0
    assert replacement.state.spoken == ()
    assert {message["serialNumber"] for message in site.recorder.sent("connection")} == {"30001"}


async def test_the_order_of_another_robot_is_dropped_after_a_restart(
    site: Site, restart: Restart, tmp_path: Path
) -> None:
    async with Master(site.broker.port, serial="forklift") as master:
        async with site.vehicle(serial_number="forklift", state_folder=tmp_path):
            await site.drive(master)
        replacement = restart(robot_id=NEW)
        async with site.vehicle(serial_number="forklift", state_folder=tmp_path):
            state = await master.error("interruptedError")
            assert (state["orderId"], state["nodeStates"]) == ("", [])
    assert replacement.counts[EXEC] == 0


async def test_an_order_that_has_ended_is_not_said_to_be_dropped(
    site: Site, restart: Restart, tmp_path: Path
) -> None:
    async with Master(site.broker.port, serial="forklift") as master:
        async with site.vehicle(serial_number="forklift", state_folder=tmp_path):
            await master.online()
            master.order([node("a", 0, *START)])
            await master.wait_state(
                lambda state: state["orderId"] == "order" and not state["nodeStates"]
            )
        restart(robot_id=NEW)
        master.received.clear()
        async with site.vehicle(serial_number="forklift", state_folder=tmp_path):
            await master.online()
            assert master.state["orderId"] == ""
            assert "interruptedError" not in error_types(master.state)


NOT_READ = "has not sent its maps and marks yet"
MARKED = [
    node("a", 0, *START),
    {"nodeId": "K10", "sequenceId": 2, "released": False, "actions": []},
]
"""Nodes of an order; the position of the second one is that of a mark of the robot."""


@pytest.mark.parametrize("answer", ["none", "refusal", "other type"])
async def test_marks_that_the_robot_did_not_send_are_requested_again(
    site: Site, answer: str
) -> None:
    if answer == "none":
        site.chassis.mute(SCENE_DATA)
    elif answer == "refusal":
        site.chassis.refuse(SCENE_DATA, "Request failed")
    else:
        site.chassis.answer_as(SCENE_DATA, full_name(RobotInfo))
    timing = Timing(ask_again_after=0.1, minimum_timeouts={})
    async with site.online(request_timeout=1.0, timing=timing) as master:
        await eventually(lambda: site.chassis.counts[SCENE_DATA] >= 2)
        nodes = MARKED
        master.order(nodes)
        await master.wait_state(lambda state: NOT_READ in str(state["errors"]))
        master.instant(action("startCharging", "c", stationName="C1"))
        state = await master.status("c", "FAILED")
        assert NOT_READ in result_of(state, "c")
        site.chassis.accept(SCENE_DATA)
        await master.order_until_accepted(nodes)
        # the marks are those of another scene now, in which the robot knows no K10
        master.instant(action("enableMap", "map", mapId="scenex", mapVersion="12"))
        await master.status("map", "FINISHED")
        master.order(nodes)
        master.instant(action("stateRequest", "last"))
        state = await master.status("last", "FINISHED")
        assert error_types(state) == []


async def test_a_list_of_maps_that_the_robot_refused_is_requested_again(site: Site) -> None:
    site.chassis.refuse(full_name(SceneList), "Request failed")
    async with site.online(timing=Timing(ask_again_after=0.1)) as master:
        await eventually(lambda: site.chassis.counts[full_name(SceneList)] >= 2)
        master.order([node("a", 0, *START), node("b", 2, 0.0, 0.0, map_id="scenex")])
        await master.wait_state(lambda state: NOT_READ in str(state["errors"]))
        site.chassis.accept(full_name(SceneList))
        await master.wait_state(lambda state: state.get("maps"))


async def test_marks_that_the_robot_refused_are_requested_at_once_after_a_reconnect(
    site: Site,
) -> None:
    site.chassis.refuse(SCENE_DATA, "Request failed")
    async with site.online(timing=Timing(ask_again_after=200.0)) as master:
        await eventually(lambda: site.chassis.counts[SCENE_DATA])
        site.chassis.accept(SCENE_DATA)
        async with site.without_link(master):
            pass
        await master.order_until_accepted(MARKED)


async def test_a_scene_that_is_too_large_does_not_cost_the_link_each_time(site: Site) -> None:
    edit_bodies(site.chassis, SceneData, lambda scene: scene.maps.add(name="x" * 2**20))
    timing = Timing(ask_again_after=200.0)
    async with site.online(max_frame_size=2**19, timing=timing) as master:
        await master.error("robotConnectionError")
        await master.wait_state(is_connected)
        master.order(LEG)
        await master.reached("b")
        assert site.chassis.counts[SCENE_DATA] == 1
        # another scene may be smaller
        master.instant(action("enableMap", "map", mapId="scenex", mapVersion="12"))
        await eventually(lambda: site.chassis.counts[SCENE_DATA] == 2)
