"""The motion gate: reserved requests, `stop`, closing, and the owner of the wheels."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable
from typing import Any

import pytest
from google.protobuf.message import Message

from tests.link.link_peer import TIMEOUT, Frame, Peer, Wire, aio, eventually, soon, turns
from tests.motion.moving import MOVING, name_of
from woosh_robot_agent.link import (
    ChassisClient,
    LinkError,
    LinkState,
    NotConnectedError,
    NotPermittedError,
    RequestTimeoutError,
    SupersededError,
)
from woosh_robot_agent.motion import MotionGate
from woosh_robot_agent.motion import gate as gate_module
from woosh_robot_agent.motion.gate import ZeroRefusedError
from woosh_robot_agent.motion.stop import cancel_orders
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Speak, Twist
from woosh_robot_agent.pb.ros.action_pb2 import kExecute, kResume
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction
from woosh_robot_agent.reads import only_reads

TWIST = "woosh.robot.Twist"
ORDERS = len(cancel_orders()) + 1
LOAD = "x" * 16_000_000
"""Text larger than the socket buffers."""

every_moving_request = pytest.mark.parametrize("request_", MOVING, ids=name_of)


@pytest.fixture(autouse=True)
def long_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a stop hold for the whole test, even on a slow machine."""
    monkeypatch.setattr(gate_module, "HOLD", 3600.0)


@pytest.fixture
def long_drive(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the robot count as driving for the whole test, even on a slow machine."""
    monkeypatch.setattr(gate_module, "DRIVING", 3600.0)


async def answer_all(wire: Wire, frame: Frame) -> bool:
    """Accept every request; a script for `Peer`."""
    if frame["type"] != "woosh.robot.RobotInfo" and "sn" in frame:
        await wire.answer(frame)
        return True
    return False


def types(wire: Wire) -> list[str]:
    wanted = {TWIST, *(message.DESCRIPTOR.full_name for message in MOVING)}
    wanted.add("woosh.robot.ActionOrder")
    return [frame["type"] for frame in wire.seen if frame["type"] in wanted]


async def ok(work: Awaitable[Any]) -> None:
    assert (await soon(asyncio.ensure_future(work))).ok


@every_moving_request
@aio
async def test_moving_requests_are_refused_outside_the_gate(request_: Message) -> None:
    async with Peer(script=answer_all) as peer, peer.client() as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        with pytest.raises(RuntimeError, match="reserved"):
            await client.request(request_)
        assert types(wire) == []
        await ok(gate.request(request_))
        assert types(wire) == [request_.DESCRIPTOR.full_name]


@aio
async def test_a_client_can_have_only_one_gate() -> None:
    async with Peer() as peer, peer.client() as client:
        MotionGate(client)
        with pytest.raises(RuntimeError, match="reserved already"):
            MotionGate(client)


@aio
async def test_requests_that_move_nothing_are_sent_even_when_closed() -> None:
    async with Peer(script=answer_all) as peer, peer.client() as client:
        gate = MotionGate(client)
        await gate.close(TIMEOUT)
        await ok(gate.request(Speak()))


@aio
async def test_a_stop_sends_the_zero_first_and_then_every_cancel() -> None:
    async with Peer(script=answer_all) as peer, peer.client() as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        report = await soon(asyncio.ensure_future(gate.stop(TIMEOUT)))
        assert report.success
        sent = types(wire)
        assert sent[:2] == [TWIST, "woosh.robot.ActionOrder"]
        assert sent[2:] == ["woosh.ros.CallAction"] * (ORDERS - 2)
        cancelled = {next(iter(frame["body"])) for frame in wire.seen if frame["type"] == sent[-1]}
        assert len(cancelled) == ORDERS - 2


@every_moving_request
@aio
async def test_after_a_stop_nothing_that_moves_is_sent(request_: Message) -> None:
    async with Peer(script=answer_all) as peer, peer.client() as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        await soon(asyncio.ensure_future(gate.stop(TIMEOUT)))
        with pytest.raises(SupersededError, match="cancelled by the `stop` service"):
            await gate.request(request_)
        await ok(gate.request(Twist()))
        assert len(types(wire)) == ORDERS + 1


@every_moving_request
@aio
async def test_a_stop_withdraws_what_waits_to_be_sent(request_: Message) -> None:
    async with Peer(script=answer_all) as peer, peer.client() as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        wire.freeze()
        load = asyncio.ensure_future(client.request(Speak(text=LOAD)))
        await turns()
        waiting = asyncio.ensure_future(gate.request(request_))
        await turns()
        stop = asyncio.ensure_future(gate.stop(TIMEOUT))
        with pytest.raises(SupersededError, match=r"cancelled by the `stop` service|newer"):
            await soon(waiting)
        wire.thaw()
        assert (await soon(stop)).success
        await soon(load)
        assert len(types(wire)) == ORDERS


@aio
async def test_a_request_some_time_after_a_stop_is_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gate_module, "HOLD", 0.05)
    async with Peer(script=answer_all) as peer, peer.client() as client:
        gate = MotionGate(client)
        await soon(asyncio.ensure_future(gate.stop(TIMEOUT)))
        await asyncio.sleep(0.1)
        await ok(gate.request(Twist(linear=1)))


@aio
async def test_a_stop_without_an_answer_says_so() -> None:
    async with Peer() as peer, peer.client() as client:
        gate = MotionGate(client)
        report = await soon(asyncio.ensure_future(gate.stop(0.03)))
        assert not report.success
        assert report.message.startswith("NOT STOPPED: the chassis did not answer")
        assert report.message.endswith("press its emergency stop")


@aio
async def test_a_stop_without_the_answer_to_one_cancel_is_a_failure() -> None:
    async def all_but_the_task(wire: Wire, frame: Frame) -> bool:
        return frame["type"] == "woosh.robot.ActionOrder" or await answer_all(wire, frame)

    async with Peer(script=all_but_the_task) as peer, peer.client() as client:
        gate = MotionGate(client)
        await peer.wire()
        await client.wait_ready(TIMEOUT)
        report = await soon(asyncio.ensure_future(gate.stop(1.0)))
        assert not report.success
        assert report.message.startswith("stopped; ")
        assert "cancel of task: the chassis did not answer" in report.message
        assert report.message.endswith("press its emergency stop")


@every_moving_request
@aio
async def test_once_closed_nothing_that_moves_is_sent(request_: Message) -> None:
    async with Peer(script=answer_all) as peer, peer.client() as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        await gate.close(TIMEOUT)
        await soon(asyncio.ensure_future(gate.stop(TIMEOUT)))  # forbids motion for a while only
        with pytest.raises(SupersededError, match="the agent is stopping"):
            await gate.request(request_)
        assert len(types(wire)) == ORDERS


@pytest.mark.parametrize("drove", [False, True])
@aio
async def test_the_last_zero_is_sent_only_if_the_robot_may_drive(drove: bool) -> None:
    async with Peer(script=answer_all) as peer, peer.client() as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        if drove:
            await ok(gate.request(Twist(linear=1)))
        await gate.close(TIMEOUT)
        await gate.close(TIMEOUT)
        assert types(wire) == [TWIST, TWIST] * drove


@aio
async def test_a_zero_that_was_not_confirmed_is_sent_again() -> None:
    async with Peer() as peer, peer.client() as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        task = asyncio.ensure_future(gate.request(Twist(linear=1)))
        await wire.answer(await wire.next(TWIST))
        await soon(task)
        with pytest.raises(RequestTimeoutError):
            await gate.close(0.03)
        closing = asyncio.ensure_future(gate.close(TIMEOUT))
        await wire.next(TWIST)
        await wire.answer(await wire.next(TWIST))
        await soon(closing)
        assert not gate.driving


@aio
async def test_a_refused_zero_does_not_count_as_stopped(long_drive: None) -> None:
    async def refuse_zeros(wire: Wire, frame: Frame) -> bool:
        if frame["type"] == TWIST:
            await wire.answer(frame, ok=bool(frame["body"].get("linear")), msg="no remote control")
        return frame["type"] == TWIST

    async with Peer(script=refuse_zeros) as peer, peer.client() as client:
        gate = MotionGate(client)
        await ok(gate.request(Twist(linear=1)))
        assert not (await gate.request(Twist())).ok
        assert gate.driving
        with pytest.raises(ZeroRefusedError, match="refused the zero velocity: no remote control"):
            await gate.close(TIMEOUT)


@aio
async def test_the_last_zero_replaces_a_held_velocity(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async with Peer() as peer, peer.client() as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        first = asyncio.ensure_future(gate.request(Twist(linear=1)))
        frame = await wire.next(TWIST)
        for serial in gate._velocities._unanswered:
            gate._velocities._unanswered[serial] -= 3600.0  # unanswered for too long
        held = asyncio.ensure_future(gate.request(Twist(linear=2)))
        await turns()
        closing = asyncio.ensure_future(gate.close(TIMEOUT))
        await wire.answer(await wire.next(TWIST))
        await soon(closing)
        await wire.answer(frame)
        await soon(first)
        with pytest.raises(SupersededError):
            await soon(held)
        assert types(wire) == [TWIST, TWIST]


@aio
async def test_a_robot_that_drove_when_the_link_was_lost_counts_as_not_stopped() -> None:
    async with (
        Peer(script=answer_all) as peer,
        peer.client(backoff_min=60.0, backoff_max=60.0) as client,
    ):
        gate = MotionGate(client)
        wire = await peer.wire()
        await ok(gate.request(Twist(linear=1)))
        wire.abort()
        await eventually(lambda: client.state.value == "waiting")
        with pytest.raises(NotConnectedError):
            await gate.close(TIMEOUT)


@aio
async def test_a_velocity_that_was_not_sent_does_not_count_as_driving() -> None:
    async with Peer() as peer, peer.client() as client:
        gate = MotionGate(client)
        await client.close()
        with pytest.raises(NotConnectedError):
            await gate.request(Twist(linear=1))
        await gate.close(TIMEOUT)


@aio
async def test_no_zero_follows_an_accepted_task() -> None:
    """The zero at the end would stop the task."""
    taking = ("ExecTask", "ExecPreTask", "ActionOrder", "Follow")
    tasks = [each for each in MOVING if each.DESCRIPTOR.name in taking]
    assert len(tasks) == len(taking)
    starting, resuming = CallAction(), CallAction()
    starting.move_base.action = kExecute
    resuming.step_control.action = kResume
    for request_ in (*tasks, starting, resuming):
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
]
each_start = pytest.mark.parametrize(("type_", "runs", "rests"), STARTS, ids=["task", "action"])


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


@aio
async def test_long_after_a_velocity_the_robot_counts_as_standing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(gate_module, "DRIVING", 0.05)
    async with Peer(script=answer_all) as peer, peer.client() as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        await ok(gate.request(Twist(linear=1)))
        await eventually(lambda: not gate.driving)
        await gate.close(TIMEOUT)
        assert types(wire) == [TWIST]


@every_moving_request
@aio
async def test_nothing_is_sent_again_after_a_lost_link(request_: Message) -> None:
    async with Peer() as peer, peer.client(backoff_min=0.05, backoff_max=0.05) as client:
        gate = MotionGate(client)
        wire = await peer.wire()
        task = asyncio.ensure_future(gate.request(request_))
        await wire.next(request_.DESCRIPTOR.full_name)
        wire.abort()
        await asyncio.wait([task])
        assert task.exception() is not None
        with pytest.raises(NotConnectedError):
            await gate.request(request_)  # a request without a link is not sent later either
        again = await peer.wire(2)
        await client.wait_ready(TIMEOUT)
        speaking = asyncio.ensure_future(gate.request(Speak()))
        await again.answer(await again.next("woosh.robot.Speak"))
        await soon(speaking)
        assert types(again) == []


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


@aio
async def test_an_open_goal_owns_the_wheels() -> None:
    goals = 1
    async with Peer() as peer, peer.client() as client:
        gate = MotionGate(client, lambda: goals)
        assert gate.owner == "a goal"
        goals = 0
        assert gate.owner == ""


async def turn_to(client: ChassisClient, gate: MotionGate, peer: Peer) -> None:
    """Turn a client to another robot, as the agent does."""
    await client.reconfigure(peer.config(), gate.farewell(TIMEOUT))
    await client.wait_ready(TIMEOUT)


@pytest.mark.parametrize("drove", [False, True])
@pytest.mark.usefixtures("long_drive")
@aio
async def test_a_robot_that_is_left_gets_its_zero_if_it_may_drive(drove: bool) -> None:
    async with (
        Peer(script=answer_all) as one,
        Peer(script=answer_all) as two,
        one.client() as client,
    ):
        gate = MotionGate(client)
        if drove:
            await ok(gate.request(Twist(linear=1)))
        await turn_to(client, gate, two)
        wire = await one.wire()
        assert types(wire) == [TWIST, TWIST] * drove
        assert all("linear" not in frame["body"] for frame in wire.seen[-1:] if drove)
        assert not gate.driving
        await gate.close(TIMEOUT)
        assert types(await two.wire()) == []


@pytest.mark.usefixtures("long_drive")
@aio
async def test_no_velocity_follows_the_zero_of_a_robot_that_is_left() -> None:
    async with Peer(script=answer_all) as one, Peer() as two, one.client() as client:
        gate = MotionGate(client)
        wire = await one.wire()
        await ok(gate.request(Twist(linear=1)))
        wire.freeze()
        load = asyncio.ensure_future(client.request(Speak(text=LOAD)))
        await turns()
        waiting = asyncio.ensure_future(gate.request(Twist(linear=2)))
        await turns()
        turning = asyncio.ensure_future(turn_to(client, gate, two))
        await turns()
        late = asyncio.ensure_future(gate.request(Twist(linear=3)))
        for each in (load, waiting, late):
            with pytest.raises(LinkError):
                await soon(each)
        wire.thaw()
        await soon(turning)
        speeds = [frame["body"].get("linear") for frame in wire.seen if frame["type"] == TWIST]
        assert speeds == [1, None]


@pytest.mark.parametrize("refused", [False, True])
@pytest.mark.usefixtures("long_drive")
@aio
async def test_a_robot_that_is_left_and_cannot_be_stopped_is_an_error(
    refused: bool, caplog: pytest.LogCaptureFixture
) -> None:
    async def refuse_zero(wire: Wire, frame: Frame) -> bool:
        if frame["type"] == TWIST and "linear" not in frame["body"] and refused:
            await wire.answer(frame, ok=False, msg="no speed control")
            return True
        return await answer_all(wire, frame)

    async with (
        Peer(script=refuse_zero) as one,
        Peer() as two,
        one.client(backoff_min=60.0, backoff_max=60.0) as client,
    ):
        gate = MotionGate(client)
        await ok(gate.request(Twist(linear=1)))
        if not refused:
            (await one.wire()).abort()
            await eventually(lambda: client.state is not LinkState.READY)
        await turn_to(client, gate, two)
        (record,) = [each for each in caplog.records if each.levelname == "ERROR"]
        assert f"ws://127.0.0.1:{one.port} was not stopped" in record.getMessage()
        assert ("no speed control" if refused else "not connected") in record.getMessage()


@pytest.mark.usefixtures("long_drive")
@aio
async def test_a_robot_that_is_only_observed_from_now_on_gets_its_zero_and_no_other_command() -> (
    None
):
    async with Peer(script=answer_all) as peer, peer.client() as client:
        gate = MotionGate(client)
        await ok(gate.request(Twist(linear=1)))
        stop = gate.farewell(TIMEOUT)
        client.permit_only(only_reads, "it only observes")
        assert stop is not None
        await soon(asyncio.ensure_future(stop()))
        for request in (*MOVING, Twist()):
            with pytest.raises(NotPermittedError, match="it only observes"):
                await gate.request(request)
        assert not gate.driving, "a refused velocity does not drive"
        report = await gate.stop(TIMEOUT)
        assert not report.success
        assert "it only observes" in report.message
        await gate.close(TIMEOUT)
        assert types(await peer.wire()) == [TWIST, TWIST]


@aio
async def test_the_task_of_a_former_robot_does_not_own_the_wheels() -> None:
    running = {"taskProc": {"robotTaskId": "7", "state": "kExecuting"}}
    async with Peer(info=running) as one, Peer() as two:
        client = one.client()
        gate = MotionGate(client)
        async with client:
            await eventually(lambda: gate.owner == "task 7")
            changing = asyncio.ensure_future(client.reconfigure(two.config()))
            await turns(1)
            assert gate.owner == ""
            await changing
