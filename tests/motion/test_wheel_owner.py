"""Tasks and actions that drive the robot: the gate sends no zero that would stop them."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from tests.link.link_peer import TIMEOUT, Frame, Wire, eventually, soon
from tests.motion.gate_checks import (
    FEEDBACKS,
    RUNNING,
    TWIST,
    Rig,
    answer_all,
    answer_nothing,
    feedback,
    gated,
    ok,
    refusing,
    speeds,
    types,
)
from tests.motion.moving import MOVING
from woosh_robot_agent.link import LinkState
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Speak
from woosh_robot_agent.pb.ros.action_pb2 import kExecute, kResume
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction
from woosh_robot_agent.pb.task.woosh_task_pb2 import RepeatTask

TASK_PROC = "woosh.robot.TaskProc"
EXEC_TASK = next(each for each in MOVING if each.DESCRIPTOR.name == "ExecTask")


each_start = pytest.mark.parametrize(
    ("type_", "runs", "rests", "owner"),
    [
        (TASK_PROC, RUNNING, {**RUNNING, "state": "kPaused"}, "task 7"),
        (
            FEEDBACKS,
            feedback("MoveBase", "kRosExecuting"),
            feedback("MoveBase", "kSuspend"),
            "MoveBase",
        ),
        (
            FEEDBACKS,
            feedback("ChargeControl", "kRosExecuting"),
            feedback("ChargeControl", "kRosSuccess"),
            "ChargeControl",
        ),
    ],
    ids=["task", "action", "charging"],
)


async def owned(rig: Rig, type_: str = TASK_PROC, body: Frame = RUNNING) -> None:
    """Let the chassis report that a task or an action runs."""
    await rig.wire.push(type_, body)
    await eventually(lambda: rig.gate.owner)


async def test_no_zero_follows_an_accepted_task() -> None:
    """A zero on closing the gate would stop the task."""
    taking = ("ExecTask", "ExecPreTask", "ActionOrder", "Follow")
    tasks = [each for each in MOVING if each.DESCRIPTOR.name in taking]
    assert len(tasks) == len(taking)
    starting, resuming, docking = CallAction(), CallAction(), CallAction()
    starting.move_base.action = kExecute
    resuming.step_control.action = kResume
    docking.charge_control.action = kExecute
    task_set = RepeatTask(order=RepeatTask.kExec)
    for request_ in (*tasks, task_set, starting, resuming, docking):
        async with gated() as rig:
            await ok(rig.drive(1))
            await ok(rig.gate.request(request_))
            await rig.gate.close(TIMEOUT)
            assert types(rig.wire) == [TWIST, request_.DESCRIPTOR.full_name]


@each_start
async def test_no_zero_follows_a_task_or_action_of_another_client(
    type_: str, runs: Frame, rests: Frame, owner: str
) -> None:
    async with gated() as rig:
        assert rig.gate.owner == ""
        for _ in range(2):  # started, then resumed
            await ok(rig.drive(1))
            assert rig.gate.driving
            await rig.wire.push(type_, runs)
            await eventually(lambda: rig.gate.owner == owner)
            assert not rig.gate.driving
            await rig.wire.push(type_, rests)
            await eventually(lambda: not rig.gate.owner)
        await rig.gate.close(TIMEOUT)
        assert speeds(rig.wire) == [1, 1]


async def test_no_zero_follows_a_task_that_another_client_started_without_a_link() -> None:
    async with gated() as rig:
        await ok(rig.drive(1))
        rig.peer.info = {"taskProc": RUNNING}
        rig.wire.abort()
        again = await rig.second_wire()
        await eventually(lambda: rig.gate.owner)
        await rig.gate.close(TIMEOUT)
        assert types(again) == []


@each_start
async def test_a_velocity_after_the_start_of_a_task_or_action_still_needs_its_zero(
    type_: str, runs: Frame, rests: Frame, owner: str
) -> None:
    async with gated() as rig:
        await owned(rig, type_, runs)
        await ok(rig.drive(1))
        await rig.wire.push(type_, runs)  # the chassis repeats its reports
        await rig.wire.push(type_, rests)
        await eventually(lambda: not rig.gate.owner)
        await rig.gate.close(TIMEOUT)
        assert speeds(rig.wire) == [1, 0]


async def test_a_velocity_that_is_unanswered_at_the_start_of_a_task_still_needs_its_zero() -> None:
    async with gated(answer_nothing) as rig:
        moving = rig.drive(1)
        frame = await rig.wire.next(TWIST)
        await owned(rig)
        await rig.wire.answer(frame)
        await soon(moving)
        assert rig.gate.driving


async def test_no_zero_follows_a_velocity_that_is_refused_because_a_task_has_started() -> None:
    async with gated(answer_nothing) as rig:
        before = rig.drive(1)
        await rig.wire.answer(await rig.wire.next(TWIST))
        await soon(before)
        refused = rig.drive(2)
        frame = await rig.wire.next(TWIST)
        await owned(rig)
        assert rig.gate.driving
        await rig.wire.answer(frame, ok=False)
        await soon(refused)
        assert not rig.gate.driving


async def test_a_velocity_between_acceptance_and_report_of_a_task_still_needs_its_zero() -> None:
    async with gated() as rig:
        await ok(rig.gate.request(EXEC_TASK))
        await ok(rig.drive(1))
        await owned(rig)
        assert rig.gate.driving


@pytest.mark.parametrize("accepted", [True, False])
async def test_a_velocity_that_is_sent_before_a_task_is_accepted_drives_unless_it_is_refused(
    accepted: bool,
) -> None:
    async with gated(answer_nothing) as rig:
        task = asyncio.ensure_future(rig.gate.request(EXEC_TASK))
        start = await rig.wire.next("woosh.robot.ExecTask")
        moving = rig.drive(1)
        velocity = await rig.wire.next(TWIST)
        await rig.wire.answer(start)
        await soon(task)
        assert rig.gate.driving
        await rig.wire.answer(velocity, ok=accepted)
        await soon(moving)
        assert rig.gate.driving == accepted


async def test_a_zero_follows_a_velocity_though_a_task_was_refused() -> None:
    async with gated(refusing(lambda frame: frame["type"] == "woosh.robot.ExecTask")) as rig:
        await ok(rig.drive(1))
        assert not (await rig.gate.request(EXEC_TASK)).ok
        await rig.gate.close(TIMEOUT)
        assert types(rig.wire) == [TWIST, "woosh.robot.ExecTask", TWIST]


async def test_a_task_owns_the_wheels_while_it_may_drive_on_by_itself() -> None:
    owners = {
        ("kInit", "kStateUndefined"): "task 7",
        ("kReady", "kStateUndefined"): "task 7",
        ("kActionWait", "kRosExecuting"): "task 7",
        ("kTaskWait", "kRosExecuting"): "task 7",
        ("kPaused", "kRosWarning"): "task 7",  # an obstacle
        ("kPaused", "kTraffiCtrl"): "task 7",
        ("kPaused", "kSuspend"): "",
        ("kPaused", "kRosCancel"): "",
        ("kPaused", "kStateUndefined"): "",
        ("kCompleted", "kRosSuccess"): "",
        ("kStateUndefined", "kStateUndefined"): "",
    }
    async with gated() as rig:
        for (state, action), owner in owners.items():
            await rig.wire.push(TASK_PROC, {"robotTaskId": "6", "state": "kExecuting"})
            await eventually(lambda: rig.gate.owner == "task 6")
            nav = {"type": "kNav", "state": action}
            await rig.wire.push(TASK_PROC, {"robotTaskId": "7", "state": state, "action": nav})
            await eventually(lambda owner=owner: rig.gate.owner == owner)  # type: ignore[misc]


async def test_an_action_owns_the_wheels_while_it_may_drive_on_by_itself() -> None:
    owners = {
        "kRosErrMsg": "MoveBase",  # e.g. an obstacle
        "kRosPauseFailed": "MoveBase",
        "kRosPause": "",
        "kRosFailure": "",
    }
    async with gated() as rig:
        for state, owner in owners.items():
            await owned(rig, FEEDBACKS, feedback("MoveBase", "kRosExecuting"))
            await rig.wire.push(FEEDBACKS, feedback("MoveBase", state))
            await ok(rig.gate.request(Speak()))  # answered after the push
            assert rig.gate.owner == owner
            for late in ("kRosFailure", state):  # what it reports after its end does not begin it
                await rig.wire.push(FEEDBACKS, feedback("MoveBase", late))
            await ok(rig.gate.request(Speak()))
            assert rig.gate.owner == ""


async def test_a_task_that_goes_on_after_an_obstacle_takes_no_velocity_over() -> None:
    """The velocity was sent while the task owned the wheels, so it still needs its zero."""
    held = {"robotTaskId": "7", "state": "kPaused", "action": {"state": "kRosWarning"}}
    async with gated() as rig:
        await owned(rig)
        await rig.wire.push(TASK_PROC, held)
        await ok(rig.drive(1))
        await rig.wire.push(TASK_PROC, RUNNING)
        await ok(rig.gate.request(Speak()))  # answered after the push
        assert rig.gate.driving


async def test_an_open_goal_owns_the_wheels() -> None:
    goals = 1
    async with gated(goals=lambda: goals) as rig:
        assert rig.gate.owner == "a goal"
        goals = 0
        assert rig.gate.owner == ""


@pytest.mark.parametrize("state", ["kRosExecuting", "kRosErrMsg", "kRosPauseFailed"])
async def test_an_action_that_runs_when_the_link_is_made_owns_the_wheels(state: str) -> None:
    """Robots report an action only when its state changes, and RobotInfo has no actions."""
    async with gated() as rig:
        rig.actions = feedback("MoveBase", state)
        rig.wire.abort()
        await rig.second_wire()
        await eventually(lambda: rig.gate.owner == "MoveBase")


@pytest.mark.parametrize("answer", [{}, feedback("MoveBase", "kRosSuccess"), None])
async def test_an_action_owns_the_wheels_until_a_new_link_tells_its_end(
    answer: Frame | None,
) -> None:
    async with gated() as rig:
        await owned(rig, FEEDBACKS, feedback("MoveBase", "kRosExecuting"))
        rig.actions = answer
        rig.wire.abort()
        await eventually(lambda: rig.client.state is not LinkState.READY)
        assert rig.gate.owner == "MoveBase"
        await rig.second_wire()
        await eventually(lambda: not rig.gate.owner)


@pytest.mark.parametrize(
    ("pushed", "answer"),
    [
        ("kRosExecuting", {}),  # the report is newer
        ("kRosErrMsg", feedback("MoveBase", "kRosErrMsg")),  # it does not tell of a beginning
    ],
)
async def test_an_action_that_is_reported_before_the_answer_about_the_actions_owns_the_wheels(
    pushed: str, answer: Frame
) -> None:
    async def script(wire: Wire, frame: Frame) -> bool:
        if frame["type"] == FEEDBACKS:
            await wire.push(FEEDBACKS, feedback("MoveBase", pushed))
        return await answer_all(wire, frame)

    async with gated(script) as rig:
        rig.actions = answer
        known: list[Any] = []
        rig.gate.wheel_owner.on_known(known.append)
        rig.wire.abort()
        await rig.second_wire()
        await eventually(lambda: known)
        assert rig.gate.owner == "MoveBase"
