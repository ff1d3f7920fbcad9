"""Commands that the chassis accepts but that move nothing."""

from __future__ import annotations

import asyncio
import logging
import time
from typing import Any

import pytest

from tests.link.link_peer import eventually, turns
from tests.robot.rig import READY, Rig
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ActionOrder, ExecTask, Follow, Twist
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed, RobotInfo, TaskProc
from woosh_robot_agent.pb.ros.action_pb2 import (
    ChargeControl,
    LiftControl,
    MoveBase,
    StepControl,
    kExecute,
)
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction, Feedbacks
from woosh_robot_agent.pb.util.action_pb2 import kContinue, kPause
from woosh_robot_agent.robot import standstill
from woosh_robot_agent.robot.standstill import likely_causes

LIMIT = 0.15
"""Time after which a robot that stands is reported, in seconds."""
FORWARD, ZERO = Twist(linear=0.2), Twist()
STRAIGHT = StepControl.Step(mode=StepControl.Step.kStraight, value=1.0)
STEP = CallAction(step_control=StepControl(steps=[STRAIGHT], action=kExecute))
DRIVING = {"robotTaskId": "17", "type": 1, "state": 3, "action": {"type": 1, "state": 1}}
MOVING = {"pose": {"x": 1.1, "y": 2.0, "theta": 3.0}, "twist": {"linear": 0.2}, "mapId": 3}


def quick() -> Rig:
    """Return a ready robot, of which a standstill is reported soon."""
    return Rig(READY, limit=LIMIT)


async def no_warning(rig: Rig) -> None:
    """Check that there is no warning after the limit."""
    await after_limit()
    assert rig.watch.standstill.warning == ""


async def after_limit() -> None:
    """Wait for a timer that is later than that of a warning."""
    passed = asyncio.Event()
    asyncio.get_running_loop().call_later(1.5 * LIMIT, passed.set)
    await passed.wait()
    await turns()


async def warned(rig: Rig) -> str:
    return str(await eventually(lambda: rig.watch.standstill.warning))


def warnings(caplog: pytest.LogCaptureFixture) -> list[logging.LogRecord]:
    found = [each for each in caplog.records if each.levelno == logging.WARNING]
    return [each for each in found if "does not move" in each.getMessage()]


async def test_a_robot_that_does_not_move_is_reported_until_it_moves(
    caplog: pytest.LogCaptureFixture,
) -> None:
    commands = (
        (FORWARD, "cmd_vel", "cmd_vel"),
        (ExecTask(task_id=17), "", "robot/ExecTask"),
        (Twist(angular=0.3), "robot/Twist", "robot/Twist"),
        (STEP, "", "ros/StepControl"),
        (CallAction(move_base=MoveBase(action=kExecute)), "", "ros/MoveBase"),
    )
    async with quick().running() as rig:
        for request, source, name in commands:
            await rig.send(request, source)
            text = await warned(rig)
            assert text.startswith(f"{name} was accepted, but the robot does not move: ")
            assert "key switch" in text
            await rig.push(PoseSpeed(), MOVING)
            await eventually(lambda: not rig.watch.standstill.warning)
    names = [record.getMessage().split()[0] for record in warnings(caplog)]
    assert names == [name for _, _, name in commands]


async def test_a_warning_does_not_come_from_reports_that_a_stall_has_held_up() -> None:
    async with quick().running() as rig:
        await rig.send(FORWARD, "cmd_vel")
        time.sleep(3 * LIMIT)  # the stall under test: the timer is due, and nothing has been read
        await turns()
        assert rig.watch.standstill.warning == ""
        assert "does not move" in await warned(rig)


async def test_it_is_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    async with quick().running() as rig:
        await rig.send(FORWARD, "cmd_vel")
        await warned(rig)
        for _ in range(3):
            await rig.send(FORWARD, "cmd_vel")
            await rig.send(ZERO, "cmd_vel")
        await after_limit()
        assert rig.watch.standstill.warning
        await rig.push(PoseSpeed(), MOVING)
    assert len(warnings(caplog)) == 1
    assert any("the robot moves after cmd_vel" in r.getMessage() for r in caplog.records)


@pytest.mark.parametrize("request_", [STEP, FORWARD])
async def test_the_same_command_is_logged_again_after_a_while(
    request_: Any, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with quick().running() as rig:
        for kept, count in ((30.0, 1), (30.0, 1), (0.1, 2)):
            monkeypatch.setattr(standstill, "KEPT", kept)
            await rig.send(request_)
            await after_limit()
            # on a busy machine, a warning may come later
            await eventually(lambda count=count: len(warnings(caplog)) >= count)
            assert len(warnings(caplog)) == count


async def test_a_robot_that_is_only_observed_now_is_not_expected_to_move() -> None:
    async with quick().running() as rig:
        await rig.send(FORWARD, "cmd_vel")
        rig.client.permit_only(lambda _: False, "this agent only observes the robot")
        await no_warning(rig)


async def test_a_stream_that_comes_to_nothing_after_a_drive_is_reported():
    async with quick().running() as rig:
        await rig.send(FORWARD, "cmd_vel")
        await rig.push(PoseSpeed(), MOVING)
        await no_warning(rig)
        await rig.send(FORWARD, "cmd_vel")
        await warned(rig)


async def test_only_a_change_of_the_pose_is_a_movement() -> None:
    poses = ({"x": 1.01, "y": 2.0, "theta": 3.0}, {"x": 1.01, "y": 2.0, "theta": -3.2})
    async with quick().running() as rig:
        for pose in poses:
            await rig.send(FORWARD)
            await rig.push(PoseSpeed(), {"pose": pose})
            await no_warning(rig)
        await rig.send(FORWARD)
        await rig.push(PoseSpeed(), {"pose": poses[-1]})
        await warned(rig)


async def test_refused_commands_are_not_reported() -> None:
    rig = quick()
    rig.refusal = "Request failed"
    async with rig.running():
        for request in (FORWARD, STEP):
            await rig.send(request)
            await no_warning(rig)


async def test_commands_that_need_not_move_the_robot_are_not_reported() -> None:
    tiny = StepControl.Step(mode=StepControl.Step.kRotate, value=0.005)
    commands = (
        Follow(type=True),
        CallAction(lift_control=LiftControl(action=kExecute)),
        CallAction(charge_control=ChargeControl(action=kExecute)),
        CallAction(step_control=StepControl(steps=[tiny], action=kExecute)),
    )
    async with quick().running() as rig:
        for request in commands:
            await rig.send(request)
            await no_warning(rig)


async def test_a_command_that_has_ended_or_is_paused_is_not_reported() -> None:
    async with quick().running() as rig:
        await rig.send(FORWARD)
        await rig.send(ZERO)
        await no_warning(rig)
        for state in (3, 1):  # paused, and ended
            await rig.send(STEP)
            report = {"action": "woosh.ros.action.StepControl", "state": state}
            await rig.push(Feedbacks(), {"fbs": [report]})
            await no_warning(rig)
        await rig.send(FORWARD)
        await rig.gate.stop(1.0)
        await no_warning(rig)


async def test_a_task_that_may_stand_is_not_reported() -> None:
    reports = (
        {**DRIVING, "state": 4, "action": {"type": 1, "state": 10}},  # paused
        {**DRIVING, "state": 4, "action": {"type": 1, "state": 2}},  # an obstacle
        {**DRIVING, "state": 5, "action": {"type": 6, "state": 1}},  # a wait
        {**DRIVING, "action": {"type": 7, "state": 1}},  # charging
        {**DRIVING, "action": {"type": 5, "state": 1}},  # lifting
        {**DRIVING, "state": 7},  # completed at once
    )
    async with quick().running() as rig:
        for report in reports:
            await rig.send(ExecTask(task_id=17))
            await rig.push(TaskProc(), DRIVING)
            await rig.push(TaskProc(), report)
            await no_warning(rig)


async def test_a_task_that_goes_on_after_a_pause_is_reported_if_it_stands():
    async with quick().running() as rig:
        await rig.send(ExecTask(task_id=17))
        await rig.push(TaskProc(), {**DRIVING, "state": 4})
        await no_warning(rig)
        await rig.push(TaskProc(), {**DRIVING, "robotTaskId": "16", "state": 7})  # another task
        await rig.push(TaskProc(), DRIVING)
        await warned(rig)
        await rig.push(TaskProc(), {**DRIVING, "state": 9})
        await eventually(lambda: not rig.watch.standstill.warning)


@pytest.mark.parametrize("is_first", [False, True])
async def test_a_task_that_is_resumed_but_waits_is_not_reported(is_first: bool) -> None:
    held = {**DRIVING, "state": 4, "action": {"type": 1, "state": 2}}
    async with quick().running() as rig:
        if is_first:  # the robot then reports nothing new
            await rig.push(TaskProc(), held)
        await rig.send(ActionOrder(order=kContinue))
        if not is_first:
            await rig.push(TaskProc(), held)
        await no_warning(rig)
        await rig.push(TaskProc(), DRIVING)
        await warned(rig)


END = (TaskProc(), {**DRIVING, "state": 9})
STEP_END = (Feedbacks(), {"fbs": [{"action": "woosh.ros.action.StepControl", "state": 1}]})


@pytest.mark.parametrize(
    ("request_", "end"),
    [
        (ExecTask(task_id=17), None),
        (FORWARD, None),
        (ExecTask(task_id=17), END),
        (ActionOrder(order=kContinue), END),
        (STEP, STEP_END),
    ],
)
async def test_a_command_that_is_accepted_after_its_end_is_not_reported(
    request_: Any, end: Any
) -> None:
    async with quick().running() as rig:
        rig.late = full_name(request_)
        sent = asyncio.ensure_future(rig.send(request_))
        await eventually(lambda: rig.unanswered)
        await (rig.push(*end) if end else rig.gate.stop(LIMIT))
        await rig.answer_late()
        await sent
        await no_warning(rig)


@pytest.mark.parametrize(
    ("request_", "end"),
    [
        (ExecTask(task_id=17), None),
        (FORWARD, None),
        (ActionOrder(order=kContinue), ActionOrder(order=kPause)),
        (ExecTask(task_id=17), END),
    ],
)
async def test_a_warning_ends_once_the_robot_may_stand(request_: Any, end: Any) -> None:
    async with quick().running() as rig:
        await rig.send(request_)
        await warned(rig)
        if isinstance(end, ActionOrder):
            await rig.send(end)
        else:
            await (rig.push(*end) if end else rig.gate.stop(1.0))
        await no_warning(rig)


async def test_an_id_can_be_used_again() -> None:
    async with quick().running() as rig:
        await rig.push(*END)
        await rig.send(ExecTask(task_id=17))
        await warned(rig)


def test_what_the_robot_reports_comes_first_and_what_it_rules_out_last():
    info = RobotInfo()
    info.device_state.hardware = 1024
    text = likely_causes(info)
    assert text.startswith("the robot reports that the emergency stop is pressed")
    assert "perhaps the key switch is at manual" in text
    info.device_state.hardware = 0
    info.mode.ctrl = 2
    text = likely_causes(info)
    assert text.startswith("the robot reports that its control mode is manual")
    assert text.index("brake") < text.index("less likely") < text.index("emergency stop")
    assert "perhaps the emergency stop is pressed" in likely_causes(RobotInfo())
