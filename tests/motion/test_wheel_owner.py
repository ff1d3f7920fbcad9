"""Tasks and actions that drive the robot: the gate sends no zero that would stop them."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from tests.link.link_peer import TIMEOUT, Frame, Peer, Wire, aio, eventually, soon
from tests.motion.gate_checks import TWIST, answer_all, ok, types
from tests.motion.moving import MOVING
from woosh_robot_agent.motion import MotionGate
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Speak, Twist
from woosh_robot_agent.pb.ros.action_pb2 import kExecute, kResume
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction
from woosh_robot_agent.pb.task.woosh_task_pb2 import RepeatTask


@aio
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
        async with Peer(script=answer_all) as peer, peer.client() as client:
            gate = MotionGate(client)
            wire = await peer.wire()
            await ok(gate.request(Twist(linear=1)))
            await ok(gate.request(request_))
            await gate.close(TIMEOUT)
            assert types(wire) == [TWIST, request_.DESCRIPTOR.full_name]


STARTS = [
    (
        "woosh.robot.TaskProc",
        {"robotTaskId": "7", "state": "kExecuting"},
        {"robotTaskId": "7", "state": "kPaused"},
    ),
    (
        "woosh.ros.Feedbacks",
        {"fbs": [{"action": "woosh.ros.action.MoveBase", "state": "kRosExecuting"}]},
        {"fbs": [{"action": "woosh.ros.action.MoveBase", "state": "kSuspend"}]},
    ),
    (
        "woosh.ros.Feedbacks",
        {"fbs": [{"action": "woosh.ros.action.ChargeControl", "state": "kRosExecuting"}]},
        {"fbs": [{"action": "woosh.ros.action.ChargeControl", "state": "kRosSuccess"}]},
    ),
]


each_start = pytest.mark.parametrize(
    ("type_", "runs", "rests"), STARTS, ids=["task", "action", "charging"]
)


@each_start
@aio
async def test_no_zero_follows_a_task_or_action_of_another_client(
    type_: str, runs: Frame, rests: Frame, long_drive: None
) -> None:
    async with Peer(script=answer_all) as peer, peer.client() as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        for _ in range(2):  # started, then resumed
            await ok(gate.request(Twist(linear=1)))
            assert gate.driving
            await wire.push(type_, runs)
            await eventually(lambda: gate.owner)
            assert not gate.driving
            await wire.push(type_, rests)
            await eventually(lambda: not gate.owner)
        await gate.close(TIMEOUT)
        assert types(wire) == [TWIST, TWIST]


@aio
async def test_no_zero_follows_a_task_that_another_client_started_without_a_link(
    long_drive: None,
) -> None:
    async with (
        Peer(script=answer_all) as peer,
        peer.client(backoff_min=0.05, backoff_max=0.05) as client,
    ):
        gate = MotionGate(client)
        wire = await peer.wire()
        await ok(gate.request(Twist(linear=1)))
        peer.info = {"taskProc": {"robotTaskId": "7", "state": "kExecuting"}}
        wire.abort()
        again = await peer.wire(2)
        await eventually(lambda: gate.owner)
        await gate.close(TIMEOUT)
        assert types(again) == []


@each_start
@aio
async def test_a_velocity_after_the_start_of_a_task_or_action_still_needs_its_zero(
    type_: str, runs: Frame, rests: Frame, long_drive: None
) -> None:
    async with Peer(script=answer_all) as peer, peer.client() as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        await wire.push(type_, runs)
        await eventually(lambda: gate.owner)
        await ok(gate.request(Twist(linear=1)))
        await wire.push(type_, runs)  # the chassis repeats its reports
        await wire.push(type_, rests)
        await eventually(lambda: not gate.owner)
        await gate.close(TIMEOUT)
        assert types(wire) == [TWIST, TWIST]


@aio
async def test_a_velocity_that_is_unanswered_at_the_start_of_a_task_still_needs_its_zero(
    long_drive: None,
) -> None:
    async with Peer() as peer, peer.client() as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        moving = asyncio.ensure_future(gate.request(Twist(linear=1)))
        frame = await wire.next(TWIST)
        await wire.push(*STARTS[0][:2])
        await eventually(lambda: gate.owner)
        await wire.answer(frame)
        await soon(moving)
        assert gate.driving


@aio
async def test_a_velocity_between_the_acceptance_and_the_report_of_a_task_still_needs_its_zero(
    long_drive: None,
) -> None:
    async with Peer(script=answer_all) as peer, peer.client() as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        await ok(gate.request(next(each for each in MOVING if "Exec" in each.DESCRIPTOR.name)))
        await ok(gate.request(Twist(linear=1)))
        await wire.push(*STARTS[0][:2])
        await eventually(lambda: gate.owner)
        assert gate.driving


@aio
async def test_a_zero_follows_a_velocity_though_a_task_was_refused() -> None:
    async def script(wire: Wire, frame: Frame) -> bool:
        if frame["type"] == TWIST:
            await wire.answer(frame)
        elif frame["type"] == "woosh.robot.ExecTask":
            await wire.answer(frame, ok=False)
        return frame["type"] in (TWIST, "woosh.robot.ExecTask")

    async with Peer(script=script) as peer, peer.client() as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        await ok(gate.request(Twist(linear=1)))
        task = next(each for each in MOVING if each.DESCRIPTOR.name == "ExecTask")
        assert not (await gate.request(task)).ok
        await gate.close(TIMEOUT)
        assert types(wire) == [TWIST, "woosh.robot.ExecTask", TWIST]


@pytest.mark.parametrize(
    ("push", "owner"),
    [
        (("woosh.robot.TaskProc", {"robotTaskId": "7", "state": "kExecuting"}), "task 7"),
        (
            (
                "woosh.ros.Feedbacks",
                {"fbs": [{"action": "woosh.ros.action.MoveBase", "state": "kRosExecuting"}]},
            ),
            "MoveBase",
        ),
    ],
)
@aio
async def test_a_reported_task_or_action_owns_the_wheels(
    push: tuple[str, dict[str, Any]], owner: str
) -> None:
    async with Peer() as peer, peer.client() as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        assert gate.owner == ""
        await wire.push(*push)
        await eventually(lambda: gate.owner == owner)


@pytest.mark.parametrize(
    ("state", "action", "owner"),
    [
        ("kInit", "kStateUndefined", "task 7"),
        ("kReady", "kStateUndefined", "task 7"),
        ("kActionWait", "kRosExecuting", "task 7"),
        ("kTaskWait", "kRosExecuting", "task 7"),
        ("kPaused", "kRosWarning", "task 7"),  # an obstacle
        ("kPaused", "kTraffiCtrl", "task 7"),
        ("kPaused", "kSuspend", ""),
        ("kPaused", "kRosCancel", ""),
        ("kPaused", "kStateUndefined", ""),
        ("kCompleted", "kRosSuccess", ""),
        ("kStateUndefined", "kStateUndefined", ""),
    ],
)
@aio
async def test_a_task_owns_the_wheels_while_it_may_drive_on_by_itself(
    state: str, action: str, owner: str
) -> None:
    other = ("woosh.robot.TaskProc", {"robotTaskId": "6", "state": "kExecuting"})
    this = {"robotTaskId": "7", "state": state, "action": {"type": "kNav", "state": action}}
    async with Peer() as peer, peer.client() as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        await wire.push(*other)
        await eventually(lambda: gate.owner == "task 6")
        await wire.push("woosh.robot.TaskProc", this)
        await eventually(lambda: gate.owner == owner)


@aio
async def test_a_task_that_goes_on_after_an_obstacle_takes_no_velocity_over(
    long_drive: None,
) -> None:
    """The velocity was sent while the task owned the wheels, so it still needs its zero."""
    held = {"robotTaskId": "7", "state": "kPaused", "action": {"state": "kRosWarning"}}
    async with Peer(script=answer_all) as peer, peer.client() as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        await wire.push(*STARTS[0][:2])
        await eventually(lambda: gate.owner)
        await wire.push("woosh.robot.TaskProc", held)
        await ok(gate.request(Twist(linear=1)))
        await wire.push(*STARTS[0][:2])
        await ok(gate.request(Speak()))  # answered after the push
        assert gate.driving


@aio
async def test_an_open_goal_owns_the_wheels() -> None:
    goals = 1
    async with Peer() as peer, peer.client() as client:
        gate = MotionGate(client, lambda: goals)
        assert gate.owner == "a goal"
        goals = 0
        assert gate.owner == ""
