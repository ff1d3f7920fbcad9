"""Commands and driving from the page, without a browser."""

from __future__ import annotations

import asyncio
import itertools
import json
import math
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import pytest
from google.protobuf.message import Message

from tests.asynchronous import TIMEOUT, eventually
from tests.quick_chassis import quick_config
from tests.tools.dashboard.pages import (
    TOO_SLOW,
    Page,
    controlled,
    controlled_by_two,
    dashboard,
    is_driving,
    is_stopped_by_zero,
    last,
    page,
    say,
    velocities,
)
from woosh_robot_agent.link import ChassisClient, LinkConfig
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.motion import VelocityDriver, gate
from woosh_robot_agent.motion.timeliness import MotionTiming
from woosh_robot_agent.pb.robot.robot_pack_pb2 import (
    LED,
    ActionOrder,
    ExecTask,
    Follow,
    InitRobot,
    PlanNavPath,
    SetRobotPose,
    Speak,
    SwitchControlMode,
    SwitchWorkMode,
    Twist,
)
from woosh_robot_agent.pb.robot.robot_pb2 import RobotState, Scene, TaskProc
from woosh_robot_agent.pb.robot.robot_setting_pb2 import Sound
from woosh_robot_agent.pb.ros.action_pb2 import LiftControl
from woosh_robot_agent.pb.ros.ros_pack_pb2 import (
    CallAction,
    Feedback,
    Feedbacks,
    kRosExecuting,
    kRosSuccess,
)
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.pb.util import task_pb2 as task
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.simulator.body.base import Velocity
from woosh_robot_agent.tools.dashboard import control, stop_alarm

TWIST = full_name(Twist)


async def hold(
    viewer: Page, until: Callable[[], Any], linear: float = 0.3, angular: float = 0.0
) -> None:
    """Hold the stick until a condition is true."""
    async with viewer.holds(linear, angular):
        await eventually(until)


_ODD_TEXT = "请\u3000让开 \u200fא\u200e \U0001f468\u200d\U0001f527\u00a0!"
"""A text with a Chinese space, marks of the direction, a joined emoji, and a wide space."""
_COMMANDS: list[tuple[str, dict[str, Any], Any]] = [
    ("speak", {"text": "hello"}, Speak(text="hello")),
    ("speak", {"text": _ODD_TEXT}, Speak(text=_ODD_TEXT)),
    ("sound", {"mute": True, "volume": 20}, Sound(mute=True, volume=20)),
    ("light", {"effect": 2, "color": 5}, LED(normal=2, color=5)),
    ("workMode", {"mode": "deploy"}, SwitchWorkMode(mode=robot.kDeployMode)),
    ("controlMode", {"mode": "manual"}, SwitchControlMode(mode=robot.kManual)),
]


async def test_commands_become_requests(chassis: SimulatorThread) -> None:
    async with controlled(chassis) as viewer:
        here = chassis.state.pose
        await viewer.give("setPose", x=here.x, y=here.y, theta=here.theta)
        assert math.isclose(last(chassis, SetRobotPose).pose.x, here.x)
        await viewer.command("charge")  # the simulated robot wants a mark
        sent = last(chassis, ExecTask)
        assert (sent.type, sent.mark_no, sent.HasField("pose")) == (task.kCharge, "", False)
        await viewer.command("goMark", mark="A2", number=100_000)  # no kind of this scene
        assert last(chassis, ExecTask).task_type_no == 100_000
        assert viewer.parts["robot"]["sound"] == {"mute": False, "volume": 50}
        for name, args, sent in _COMMANDS:
            await viewer.give(name, **args)
            assert last(chassis, type(sent)) == sent
        await viewer.until(lambda parts: parts["robot"]["sound"]["volume"] == 20)
        await viewer.until(lambda parts: parts["robot"]["work"] == "deploy")


async def test_the_pose_of_a_robot_that_has_none_initialises_it() -> None:
    config = quick_config(port=0, tcp_port=0, initialised=False)
    with SimulatorThread(config) as chassis:
        async with dashboard(chassis, control=True) as running, page(running) as viewer:
            await viewer.ready()
            await viewer.until(lambda parts: parts["robot"]["state"] == "uninit")
            here = chassis.state.pose
            await viewer.give("setPose", x=here.x, y=here.y, theta=here.theta)
            assert chassis.counts[full_name(InitRobot)] == 1
            assert chassis.counts[full_name(SetRobotPose)] == 0


_INVALID: list[tuple[str, dict[str, Any]]] = [
    ("stopp", {}),
    ("go", {}),
    ("go", {"x": "1", "y": 0, "theta": 0}),
    ("go", {"x": True, "y": 0, "theta": 0}),
    ("go", {"x": math.nan, "y": 0, "theta": 0}),
    ("go", {"x": 1e9, "y": 0, "theta": 0}),
    ("go", {"x": 0, "y": 0, "theta": 10}),
    ("goMark", {"mark": 7}),
    ("goMark", {"mark": "A2", "type": "fly"}),
    ("goMark", {"mark": "A2", "number": -1}),
    ("goMark", {"mark": "A2", "number": 1.5}),
    ("speak", {"text": "x" * 201}),
    ("speak", {"text": "two\nlines"}),
    ("speak", {"text": "\ud800"}),
    ("workMode", {"mode": "fly"}),
    ("controlMode", {"mode": 1}),
    ("sound", {"mute": 1, "volume": 50}),
    ("sound", {"mute": False, "volume": 101}),
    ("speedLimit", {"limit": 0.0}),
    ("speedLimit", {"limit": True}),
    ("buildMap", {"type": "save", "scene": "hall", "map": "ground"}),
    ("plan", {"x": 0}),
    ("fault", {"text": "emergency_stop"}),
]
"""Commands that no page sends."""


async def test_an_invalid_command_is_refused(chassis: SimulatorThread) -> None:
    async with controlled(chassis) as viewer:
        before = chassis.counts
        for name, args in _INVALID:
            assert await viewer.refused(name, **args), (name, args)
        assert chassis.counts[full_name(ExecTask)] == before[full_name(ExecTask)]


async def test_without_control_no_command_reaches_the_robot(chassis: SimulatorThread) -> None:
    async with dashboard(chassis) as running, page(running) as viewer:
        await viewer.ready()
        for name in ("stop", "go", "goMark", "setPose", "cancel", "workMode", "speak", "fault"):
            text = await viewer.refused(name, x=0, y=0, theta=0, mark="A2", mode=1, text="x")
            assert "--control" in text
        reads = {
            *("woosh.Subscription", "woosh.robot.RobotInfo", "woosh.robot.RobotState"),
            *("woosh.robot.ScannerData", "woosh.map.SceneData", "woosh.map.SceneList"),
            "woosh.ros.Feedbacks",
        }
        assert set(chassis.counts) <= reads
        await viewer.drive(0.3)
        assert await viewer.closed() == 1008
        assert set(chassis.counts) <= reads


@pytest.mark.parametrize("end", ["hidden", "closed", "aborted", "switched", "released"])
async def test_a_driver_that_goes_away_stops_the_robot(
    chassis: SimulatorThread, other: SimulatorThread, end: str
) -> None:
    # the timeout of the stick does not stop the robot
    async with controlled_by_two(chassis, other, stick_timeout=TIMEOUT) as (watcher, viewer):
        await hold(viewer, lambda: is_driving(chassis))
        if end == "hidden":
            await viewer.send(do="visible", visible=False)
        elif end == "closed":
            await viewer.socket.close()
        elif end == "aborted":
            viewer.socket.transport.abort()
        elif end == "switched":
            await viewer.send(do="watch", robot=1)
        else:
            await viewer.send(do="release")
        await eventually(lambda: is_stopped_by_zero(chassis))
        await watcher.until(lambda parts: parts["control"]["owner"] is None)


async def test_the_stick_is_limited(chassis: SimulatorThread) -> None:
    async with controlled(chassis, max_linear=0.2, max_angular=0.3) as viewer:
        await hold(viewer, lambda: is_driving(chassis), 5.0, 5.0)
        sent = velocities(chassis)
        assert max(each.linear for each in sent) == pytest.approx(0.2)
        assert max(each.angular for each in sent) == pytest.approx(0.3)


async def test_the_stick_drives_during_a_task_only_while_it_is_paused(
    chassis: SimulatorThread,
) -> None:
    async with controlled(chassis) as viewer:
        await viewer.give("goMark", mark="A2")
        await viewer.until(lambda parts: parts["robot"]["task"]["state"] == "executing")
        await hold(viewer, lambda: viewer.parts.get("stick"))
        assert "is running: pause or cancel it to drive by hand" in say(viewer.parts["stick"])
        assert chassis.counts[TWIST] == 0
        await viewer.give("pause")
        await viewer.until(lambda parts: parts["robot"]["task"]["state"] == "paused")
        await hold(viewer, lambda: chassis.counts[TWIST] > 1)
        assert viewer.parts["robot"]["task"]["state"] == "paused"


async def test_a_late_velocity_is_not_sent(chassis: SimulatorThread) -> None:
    async with controlled(chassis) as viewer:
        for count, wrong in enumerate((0, 10**14), start=1):
            viewer.press = count
            await viewer.drive(0.4, clock=wrong)
            await viewer.until(lambda _, count=count: len(viewer.refusals) == count)
        assert set(viewer.refusals) == {TOO_SLOW}
        assert chassis.counts[TWIST] == 0
        await hold(viewer, lambda: is_driving(chassis))


async def test_what_was_given_before_a_suspension_of_the_computer_is_not_sent(
    chassis: SimulatorThread, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It arrives when the computer wakes up, and the monotonic time stood still meanwhile."""
    real = time.clock_gettime
    async with controlled(chassis) as viewer:
        clock = await viewer.until(lambda parts: parts["clock"])
        monkeypatch.setattr(time, "clock_gettime", lambda which: real(which) + 60.0)
        ok, text = await viewer.command_at(clock, "charge")
        assert (ok, TOO_SLOW in text) == (False, True)
        viewer.press += 1
        await viewer.drive(0.3, clock=clock)
        assert await viewer.until(lambda _: viewer.refusals) == [TOO_SLOW]
        assert not {full_name(ExecTask), TWIST} & set(chassis.counts)


async def test_a_place_of_another_map_is_not_sent(chassis: SimulatorThread) -> None:
    point = {"x": 0.0, "y": 0.0, "theta": 0.0}
    async with controlled(chassis) as viewer:
        for name, shown, place in (
            ("go", "Go", point),
            ("goMark", "Go", {"mark": "A2"}),
            ("setPose", "Set pose", point),
        ):
            for other in ({"map": "scenex"}, {"scene": "scenex"}, {"map": None}, {"version": -1}):
                reason = "the robot uses another map than the page has shown: wooshmap"
                answer = await viewer.command(name, **{**place, **other})
                assert answer == (False, f"{shown} was not sent: {reason}")
        assert not {full_name(ExecTask), full_name(SetRobotPose)} & set(chassis.counts)
        await viewer.give("goMark", mark="A2")


async def test_a_map_whose_version_a_browser_would_round_is_used(chassis: SimulatorThread) -> None:
    async with controlled(chassis) as viewer:
        before = viewer.parts["robot"]["version"]
        chassis.push(Scene(scene_name="wooshmap", map_name="wooshmap", version=2**53 + 1))
        version = await viewer.until(
            lambda parts: parts["robot"]["version"] != before and parts["robot"]["version"]
        )
        # a browser has only floats
        version = json.loads(json.dumps(version), parse_int=lambda digits: int(float(digits)))
        await viewer.give("go", x=0.0, y=0.0, theta=0.0, version=version)


async def test_a_late_command_is_not_sent(chassis: SimulatorThread) -> None:
    place = {"x": 1.0, "y": 0.0, "theta": 0.0}
    async with controlled(chassis) as viewer:
        before = chassis.counts
        for name, args in (
            ("go", place),
            ("goMark", {"mark": "A2"}),
            ("continue", {}),
            ("setPose", place),
            ("workMode", {"mode": "deploy"}),
            ("controlMode", {"mode": "manual"}),
        ):
            ok, text = await viewer.command_at(0, name, **args)
            assert not ok
            assert text.endswith(f" was not sent: {TOO_SLOW}")
        assert viewer.parts["control"]["owner"] is None
        commands = (ExecTask, ActionOrder, SetRobotPose, SwitchWorkMode, SwitchControlMode)
        assert not {full_name(cls) for cls in commands} & set(chassis.counts - before)


async def test_a_failed_watchdog_of_the_stick_stops_the_robot_and_is_shown(
    chassis: SimulatorThread, other: SimulatorThread, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, drivers = VelocityDriver.run, itertools.count()

    async def fail_for_one(driver: VelocityDriver) -> None:
        if next(drivers):
            return await run(driver)
        await eventually(lambda: is_driving(chassis))
        raise RuntimeError

    monkeypatch.setattr(VelocityDriver, "run", fail_for_one)
    async with controlled(chassis, other) as viewer, viewer.holds(0.3):
        await viewer.until(lambda parts: parts["link"]["state"] == "failed")
        await eventually(lambda: is_stopped_by_zero(chassis))
        links = ["failed", "connected"]
        await viewer.until(lambda parts: [each["link"] for each in parts["fleet"]] == links)


async def test_one_viewer_drives_and_the_others_see_who(chassis: SimulatorThread) -> None:
    async with controlled_by_two(chassis) as (driver, other):
        await driver.give("goMark", mark="A2")
        name = driver.parts["hello"]["you"]
        await other.until(lambda parts: parts["control"]["owner"] == name)
        refusal = await other.refused("cancel")
        assert refusal == f"viewer {name} has control: wait until it is released"
        await other.drive(0.3)
        await other.until(lambda parts: say(parts["stick"]).startswith(f"viewer {name} "))
        assert chassis.counts[TWIST] == 0
        assert "task cancelled" in await other.give("stop")  # everybody may
        await driver.socket.close()
        await other.until(lambda parts: parts["control"]["owner"] is None)
        # for a moment after a stop, nothing that moves is sent
        await other.passed(MotionTiming().hold)
        await other.give("goMark", mark="A2")


async def test_after_a_stop_nothing_moves_for_a_moment(chassis: SimulatorThread) -> None:
    async with controlled(chassis) as viewer:
        clock = await viewer.until(lambda parts: parts["clock"])
        await viewer.command("stop")
        ok, text = await viewer.command_at(clock, "goMark", mark="A2")
        reasons = ("STOP was pressed in the meantime", TOO_SLOW)
        assert not ok
        assert text.startswith("Go was not sent: ")
        assert text.endswith(reasons)
        assert chassis.counts[full_name(ExecTask)] == 0


@pytest.mark.parametrize("who", ["driver", "other"])
async def test_after_a_stop_only_another_press_drives(chassis: SimulatorThread, who: str) -> None:
    async with controlled_by_two(chassis) as (driver, other):
        async with driver.holds(0.3):
            await eventually(lambda: is_driving(chassis))
            await (driver if who == "driver" else other).give("stop")
            by = "" if who == "driver" else f" by viewer {other.parts['hello']['you']}"
            await driver.until(lambda _: {"stopping", f"stopped{by}"} <= set(driver.refusals))
            await driver.passed(MotionTiming().hold)
            await eventually(lambda: is_stopped_by_zero(chassis))
        sent = chassis.counts[TWIST]
        await driver.drive(0.0)  # the dead zone of the stick
        await driver.drive(0.3)
        await driver.command("pause")  # its reply comes after the velocities
        assert (chassis.counts[TWIST], is_stopped_by_zero(chassis)) == (sent, True)
        await hold(driver, lambda: is_driving(chassis))


async def test_a_press_that_rested_during_a_stop_drives_no_more(chassis: SimulatorThread) -> None:
    async with controlled_by_two(chassis) as (driver, other):
        driver.press += 1
        await driver.drive(0.0)  # the dead zone of the stick
        await driver.give("history")  # its reply comes after the velocity
        await other.give("stop")
        await driver.passed(MotionTiming().hold)
        sent = chassis.counts[TWIST]
        await driver.drive(0.3)
        reason = await driver.until(lambda _: driver.refusals)
        assert reason == ["STOP was pressed in the meantime"]
        await driver.command("pause")  # its reply comes after the velocity
        assert chassis.counts[TWIST] == sent
        await hold(driver, lambda: is_driving(chassis))


async def test_a_later_stop_that_is_confirmed_ends_the_alarm_for_all(
    chassis: SimulatorThread, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stop_alarm, "_STANDSTILL", TIMEOUT)
    async with controlled_by_two(chassis) as (first, second):
        freeze = chassis.inject("freeze")
        await first.refused("stop")
        await second.until(lambda parts: parts["fleet"][0]["alarm"])
        freeze.clear()
        await second.give("stop")
        await first.until(lambda parts: not parts["fleet"][0]["alarm"])


async def test_a_stop_that_fails_after_a_later_one_was_confirmed_raises_no_alarm(
    chassis: SimulatorThread, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stop_alarm, "_STANDSTILL", TIMEOUT)
    async with controlled_by_two(chassis) as (first, second):
        chassis.mute(full_name(ActionOrder))
        failing = asyncio.ensure_future(first.refused("stop"))
        await eventually(lambda: chassis.counts[full_name(ActionOrder)])
        chassis.accept(full_name(ActionOrder))
        await second.give("stop")
        await failing
        await second.passed(1.5)
        assert not second.parts["fleet"][0]["alarm"]


LIFTS = Feedback(action=full_name(LiftControl), state=kRosExecuting)
LIFTED = Feedback(action=full_name(LiftControl), state=kRosSuccess)


@pytest.mark.parametrize(
    ("begins", "ends"),
    [
        (Feedbacks(fbs=[LIFTS]), Feedbacks(fbs=[LIFTED])),
        (RobotState(state=robot.kFollowing), RobotState(state=robot.kIdle)),
        # it waits at a mark, and will drive on
        *(
            (
                TaskProc(robot_task_id=7, state=task.kActionWait),
                TaskProc(robot_task_id=7, state=end),
            )
            for end in (task.kPaused, task.kCanceled)
        ),
    ],
    ids=["lift", "following", "task that is paused", "task that ends"],
)
async def test_an_alarm_is_not_ended_while_the_robot_moves_a_lift_or_may_drive_on(
    chassis: SimulatorThread, begins: Message, ends: Message
) -> None:
    async with controlled(chassis) as viewer:
        state = await viewer.until(lambda parts: parts["robot"])
        chassis.mute(full_name(RobotState))  # the answer to a probe would end what is pushed here
        chassis.push(begins)
        await viewer.until(lambda parts: parts["robot"] != state)
        for refused in (ActionOrder, CallAction, Follow):
            chassis.refuse(full_name(refused), "Request failed")
        await viewer.refused("stop")
        await viewer.until(lambda parts: parts["fleet"][0]["alarm"])
        await viewer.passed(3.0)
        assert viewer.parts["fleet"][0]["alarm"]
        chassis.push(ends)
        await viewer.until(lambda parts: not parts["fleet"][0]["alarm"])


@pytest.mark.parametrize("answer", ["executing", "refused", "not named"])
async def test_an_alarm_is_not_ended_by_the_loss_of_the_link_while_an_action_goes_on(
    chassis: SimulatorThread, answer: str
) -> None:
    """The first RobotInfo of a link does not have the actions, and robots push only changes."""
    async with controlled(chassis) as viewer:
        chassis.push(Feedbacks(fbs=[LIFTS]))
        await viewer.until(lambda parts: parts["robot"]["actions"])
        if answer == "executing":
            chassis.call(lambda simulator: simulator.chassis.actions.last.update(lift=LIFTS))
        elif answer == "refused":
            chassis.refuse(full_name(Feedbacks), "Request failed")
        for refused in (ActionOrder, CallAction, Follow):
            chassis.refuse(full_name(refused), "Request failed")
        await viewer.refused("stop")
        await viewer.until(lambda parts: parts["fleet"][0]["alarm"])
        chassis.drop()
        await viewer.until(lambda parts: parts["details"]["connects"] == 2)
        if answer != "not named":
            state = "executing" if answer == "executing" else "unknown"
            await viewer.until(lambda parts: parts["robot"]["actions"][0]["state"] == state)
            await viewer.passed(3.0)
            assert viewer.parts["fleet"][0]["alarm"]
            chassis.push(Feedbacks(fbs=[LIFTED]))
        await viewer.until(lambda parts: not parts["fleet"][0]["alarm"])


async def test_what_begins_after_a_stop_and_is_not_cancelled_raises_the_alarm(
    chassis: SimulatorThread, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stop succeeds while a task of another client has been accepted and not begun."""
    monkeypatch.setattr(gate, "MotionTiming", partial(MotionTiming, effect=4.0))
    async with controlled(chassis) as viewer:
        chassis.refuse(full_name(ActionOrder), "Request failed")
        chassis.push(RobotState(state=robot.kTask))
        await viewer.until(lambda parts: parts["robot"]["state"] == "task")
        await viewer.give("stop")
        assert not viewer.parts["fleet"][0]["alarm"]
        chassis.push(TaskProc(robot_task_id=7, state=task.kExecuting))
        alarm = await viewer.until(lambda parts: parts["fleet"][0]["alarm"])
        assert "NOT STOPPED: cancel of task: Request failed" in say(alarm)


@pytest.mark.parametrize("velocity", [Twist(linear=0.3), Twist(angular=0.5)], ids=["", "turning"])
async def test_velocities_of_another_program_after_a_stop_raise_the_alarm(
    chassis: SimulatorThread, velocity: Twist
) -> None:
    """A joystick at an agent, for example, knows nothing of a stop by this page."""
    config = LinkConfig("127.0.0.1", chassis.port)
    async with controlled(chassis) as viewer, ChassisClient(config=config) as client:
        other = gate.MotionGate(client)

        async def drive() -> None:
            while True:
                await client.wait_ready(TIMEOUT)
                await other.request(velocity)
                await asyncio.sleep(0.05)

        driving = asyncio.ensure_future(drive())
        try:
            await eventually(lambda: chassis.state.velocity != Velocity())
            await viewer.give("stop")
            chassis.refuse(full_name(ExecTask), "Request failed")
            await viewer.refused("charge")  # moves nothing
            alarm = await viewer.until(lambda parts: parts["fleet"][0]["alarm"])
            assert "another program drives it" in say(alarm)
        finally:
            driving.cancel()
        await viewer.until(lambda parts: not parts["fleet"][0]["alarm"])


@pytest.mark.parametrize("how", ["release", "watch", "idle", "rest"])
async def test_a_press_does_not_take_the_control_again_that_has_ended(
    chassis: SimulatorThread, how: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if how in ("idle", "rest"):
        monkeypatch.setattr(control, "_IDLE_TIMEOUT", 5.0)
    timeout = {"stick_timeout": TIMEOUT} if how == "rest" else {}  # for which the stick may rest
    async with controlled(chassis, **timeout) as viewer:
        await hold(viewer, lambda: is_driving(chassis))
        await viewer.drive(0.3)  # a slow machine may have begun another press and not sent it
        await viewer.until(lambda parts: parts["control"]["owner"])
        if how == "rest":
            await viewer.drive(0.0)
        elif how != "idle":
            await viewer.send(do=how, robot=0)
        await viewer.until(lambda parts: parts["control"]["owner"] is None)
        assert (how == "rest") == ("no command came for a minute" in "".join(viewer.refusals))
        await eventually(lambda: is_stopped_by_zero(chassis))
        sent = chassis.counts[TWIST]
        await viewer.drive(0.3)
        assert await viewer.command("stop")  # its reply comes after the velocity
        assert chassis.counts[TWIST] == sent + 1
        assert viewer.parts["control"]["owner"] is None


async def test_a_press_that_was_silent_drives_no_more(chassis: SimulatorThread) -> None:
    async with controlled(chassis) as viewer:
        # after more than 1.5 s on a busy machine, the robot counts as standing
        while not is_stopped_by_zero(chassis):
            await hold(viewer, lambda: is_driving(chassis))
            await viewer.drive(0.3)  # a slow machine may have begun another press and not sent it
            await viewer.passed(2.0)
        sent = chassis.counts[TWIST]
        await viewer.drive(0.3)
        await viewer.until(lambda _: viewer.refusals[-1:] == [TOO_SLOW])
        await viewer.command("pause")  # its reply comes after the velocity
        assert (chassis.counts[TWIST], chassis.last(TWIST)) == (sent, Twist())


async def test_a_velocity_that_the_robot_refuses_ends_the_press(chassis: SimulatorThread) -> None:
    async with controlled(chassis) as viewer:
        chassis.refuse(TWIST, "the wheels are blocked")
        async with viewer.holds(0.3):
            await viewer.until(lambda _: any("blocked" in each for each in viewer.refusals))
            await viewer.command("pause")  # its reply comes after the velocities
            chassis.accept(TWIST)
            before = len(chassis.received)
            await viewer.passed(0.3)
        sent = velocities(chassis, before)
        assert all(each == Twist() for each in sent)
        await hold(viewer, lambda: is_driving(chassis))


async def test_a_robot_that_sends_nothing_is_not_driven(chassis: SimulatorThread) -> None:
    async with controlled(chassis) as viewer:
        async with viewer.holds(0.3):
            await eventually(lambda: is_driving(chassis))
            freeze = chassis.inject("freeze")
            await viewer.until(lambda _: any("no data for " in each for each in viewer.refusals))
        clock = await viewer.until(lambda parts: parts.pop("clock", 0))
        ok, text = await viewer.command_at(clock, "goMark", mark="A2")
        assert not ok
        assert "Go was not sent: " in text
        freeze.clear()
        await eventually(lambda: is_stopped_by_zero(chassis))
        await viewer.until(lambda parts: parts["link"]["good"])
        assert chassis.counts[full_name(ExecTask)] == 0
        await hold(viewer, lambda: is_driving(chassis))


async def test_a_press_may_rest_in_the_middle_of_the_stick(chassis: SimulatorThread) -> None:
    async with controlled(chassis) as viewer:

        async def rested() -> bool:
            """Drive, rest for longer than a press may be silent, and drive on."""
            viewer.press += 1
            known = len(viewer.refusals)
            for velocity, periods in ((0.3, 2), (0.0, 14), (0.3, 1)):
                for _ in range(periods):
                    await viewer.drive(velocity)
                    await asyncio.sleep(0.05)
            await viewer.drive(0.0)
            await viewer.command("pause")  # its reply comes after the refusals
            return len(viewer.refusals) == known

        async def rest() -> None:
            while not await rested():  # on a busy machine, the connection may be too slow
                pass

        await asyncio.wait_for(rest(), TIMEOUT)


async def test_an_invalid_velocity_ends_the_connection(chassis: SimulatorThread) -> None:
    async with dashboard(chassis, control=True) as running:
        for wrong in (
            {"linear": 101.0},
            {"linear": math.nan},
            {"linear": "1"},
            {"linear": True},
            {"angular": None},
            {"angular": -math.inf},
            {"press": 1e16},
            {"clock": 1e16},
        ):
            async with page(running) as viewer:
                await viewer.ready()
                clock = await viewer.until(lambda parts: parts["clock"])
                usual = {"linear": 0.3, "angular": 0.0, "press": 1, "clock": clock}
                await viewer.send(do="drive", **{**usual, **wrong})
                assert await viewer.closed() == 1008, wrong
        assert chassis.counts[TWIST] == 0


async def test_too_many_commands_wait_for_each_other_but_what_ends_a_motion_does_not(
    chassis: SimulatorThread,
) -> None:
    async with controlled(chassis) as viewer:
        await viewer.give("goMark", mark="A2")
        await viewer.until(lambda parts: parts["robot"]["task"]["running"])
        chassis.mute(full_name(PlanNavPath))
        place = {"x": 1.0, "y": 0.0, "theta": 0.0}
        for number in range(101, 110):
            await viewer.send(do="command", id=number, name="plan", args=place, clock=0)
        reply = await viewer.until(lambda _: viewer.replies.get(109))
        assert reply == (False, "wait for the other commands")
        for name in ("pause", "cancel", "stop"):
            await viewer.give(name)


@pytest.mark.parametrize("name", ["goMark", "stop"])
async def test_a_command_is_for_the_robot_that_was_watched_when_it_was_given(
    chassis: SimulatorThread, other: SimulatorThread, name: str
) -> None:
    async with dashboard(chassis, other, control=True) as running, page(running) as viewer:
        await viewer.ready()
        await eventually(lambda: running.robots[1].view.has_robot_info)
        clock = viewer.parts["clock"]
        version = viewer.parts["robot"]["version"]
        place = {"mark": "A2", "scene": "wooshmap", "map": "wooshmap", "version": version}
        reply, _ = await asyncio.gather(  # both are there when the dashboard reads the first one
            viewer.command_at(clock, name, **place), viewer.send(do="watch", robot=1)
        )
        sent = full_name(ExecTask if name == "goMark" else ActionOrder)
        assert (reply[0], chassis.counts[sent]) == (True, 1), reply
        await viewer.until(
            lambda parts: parts["watching"] == 1 and parts["control"]["owner"] is None
        )
        assert other.counts[sent] == 0


async def test_the_end_of_the_dashboard_stops_all_robots_at_once(
    chassis: SimulatorThread,
    other: SimulatorThread,
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(control, "_CLOSE_TIMEOUT", TIMEOUT)
    async with (
        dashboard(chassis, other, control=True) as running,
        page(running) as first,
        page(running) as second,
    ):
        await first.ready()
        await second.send(do="watch", robot=1)
        await second.until(lambda parts: parts["watching"] == 1 and parts["link"]["good"])
        async with first.holds(0.3), second.holds(0.3):
            await eventually(lambda: is_driving(chassis) and is_driving(other))
            chassis.mute(TWIST)
            closing = asyncio.ensure_future(running.close())
            await eventually(lambda: is_stopped_by_zero(other))
            assert not closing.done()  # it waits for the answer of the first robot
        chassis.drop()
        await closing
    assert f"the robot at ws://127.0.0.1:{chassis.port} was not stopped" in caplog.text


@pytest.mark.parametrize("fault", ["lose_answer", "delay", "key_switch"])
async def test_a_robot_that_stops_obeying_ends_the_press(
    chassis: SimulatorThread, fault: str
) -> None:
    options = {
        "lose_answer": {"type": TWIST},
        "delay": {"seconds": 1.5},
        "key_switch": {"requests": "accepted"},
    }
    reason = "mode" if fault == "key_switch" else "has not answered the stick"
    async with controlled(chassis) as viewer:
        async with viewer.holds(0.3, again=(TOO_SLOW,)):
            await eventually(lambda: is_driving(chassis))
            injected = chassis.inject(fault, **options[fault])
            await viewer.until(lambda _: any(reason in each for each in viewer.refusals))
            # on a busy machine, a zero that is late is not sent, and the chassis stops by itself
            await eventually(lambda: chassis.state.velocity.forward == 0.0)
            injected.clear()
            before = len(chassis.received)
            await viewer.passed(2.0)
            sent = velocities(chassis, before)
            assert all(each == Twist() for each in sent)
        if fault != "lose_answer":  # the lost answer is awaited until its timeout
            await hold(viewer, lambda: is_driving(chassis))


async def test_a_lost_link_to_the_robot_ends_the_press(chassis: SimulatorThread) -> None:
    async with controlled(chassis) as viewer:
        async with viewer.holds(0.3):
            await eventually(lambda: is_driving(chassis))
            chassis.stop_listening()
            await viewer.until(lambda _: any("no link to" in each for each in viewer.refusals))
            before = len(chassis.received)
            chassis.listen()
            await viewer.until(lambda parts: parts["details"]["connects"] == 2)
            await viewer.passed(1.0)
            sent = velocities(chassis, before)
            assert all(each == Twist() for each in sent)
            assert sum("no link to" in each for each in viewer.refusals) == 1
        await hold(viewer, lambda: is_driving(chassis))
