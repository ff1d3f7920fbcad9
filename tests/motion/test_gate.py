"""The motion gate: reserved requests, stops, and the zero before the link or the agent ends."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from dataclasses import replace

import pytest
from google.protobuf.message import Message

from tests.link.link_peer import (
    INFO,
    TIMEOUT,
    Frame,
    Wire,
    answered,
    block,
    eventually,
    soon,
    turns,
)
from tests.motion.gate_checks import (
    FEEDBACKS,
    NEVER,
    ORDERS,
    RUNNING,
    TWIST,
    Rig,
    Script,
    answer_all,
    answer_nothing,
    feedback,
    gated,
    is_task_order,
    ok,
    refusing,
    speeds,
    types,
)
from tests.motion.moving import MOVING
from woosh_robot_agent.link import (
    ConnectionLostError,
    LinkError,
    LinkState,
    NotConnectedError,
    NotPermittedError,
    RequestTimeoutError,
    SupersededError,
    TooManyRequestsError,
)
from woosh_robot_agent.motion import MotionGate, MotionTiming, Sender, gate
from woosh_robot_agent.motion.requests import only_reads
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ExecPreTask, ExecTask, Follow, Speak, Twist
from woosh_robot_agent.pb.ros.action_pb2 import LiftControl, kExecute
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction

REASON = "the settings of the link have changed"

EXEC_TASK = "woosh.robot.ExecTask"
SET = 1719959961
"""Id of a set of tasks, in Unix seconds as that of a real one."""


def is_zero(frame: Frame) -> bool:
    return frame["type"] == TWIST and "linear" not in frame["body"]


refuse_zeros = refusing(is_zero, "no remote control")


# Reserved requests


async def test_moving_requests_are_refused_outside_the_gate() -> None:
    async with gated() as rig:
        for request in MOVING:
            with pytest.raises(RuntimeError, match="reserved"):
                await rig.client.request(request)
        assert types(rig.wire) == []
        for request in MOVING:
            await ok(rig.gate.request(request))
        assert types(rig.wire) == [each.DESCRIPTOR.full_name for each in MOVING]


async def test_a_client_can_have_only_one_gate() -> None:
    async with gated() as rig:
        with pytest.raises(RuntimeError, match="reserved already"):
            MotionGate(rig.client)


async def test_nothing_is_sent_again_after_a_lost_link() -> None:
    slowly = {"backoff_min": 0.5, "backoff_max": 0.5}
    async with gated(answer_nothing, slowly) as rig:
        requests = [asyncio.ensure_future(rig.gate.request(each)) for each in MOVING]
        await eventually(lambda: len(types(rig.wire)) == len(MOVING))
        rig.wire.abort()
        for each in await asyncio.gather(*requests, return_exceptions=True):
            assert isinstance(each, ConnectionLostError)
        # what is requested without a link is not sent later either
        requests = [asyncio.ensure_future(rig.gate.request(each)) for each in MOVING]
        for each in await asyncio.gather(*requests, return_exceptions=True):
            assert isinstance(each, NotConnectedError)
        again = await rig.second_wire()
        await answered(rig.gate.request(Speak()), again)
        assert types(again) == []


# Stops


async def test_a_stop_sends_the_zero_first_and_then_every_cancel() -> None:
    async with gated() as rig:
        report = await soon(rig.gate.stop(TIMEOUT))
        assert report.success
        sent = types(rig.wire)
        assert sent[:2] == [TWIST, "woosh.robot.ActionOrder"]
        assert sent[2:-1] == ["woosh.ros.CallAction"] * (ORDERS - 3)
        bodies = [frame["body"] for frame in rig.wire.seen if frame["type"] == sent[2]]
        assert len({next(iter(body)) for body in bodies}) == ORDERS - 3
        assert sent[-1] == "woosh.robot.Follow"
        assert "Follow" not in report.message


async def test_a_stop_is_sent_although_a_callback_fails(caplog: pytest.LogCaptureFixture) -> None:
    async with gated() as rig:
        rig.gate.on_stop(lambda: 1 // 0)
        assert (await soon(rig.gate.stop(TIMEOUT))).success
    assert "ZeroDivisionError" in caplog.text


async def test_after_a_stop_nothing_that_moves_is_sent() -> None:
    async with gated() as rig:
        await soon(rig.gate.stop(TIMEOUT))
        for request in MOVING:
            with pytest.raises(SupersededError, match="cancelled by a stop of the robot"):
                await rig.gate.request(request)
        await ok(rig.gate.request(Twist()))
        assert len(types(rig.wire)) == ORDERS + 1


async def test_a_stop_withdraws_what_waits_to_be_sent() -> None:
    async with gated() as rig:
        load = await block(rig.client, rig.wire)
        waiting = [asyncio.ensure_future(rig.gate.request(each)) for each in MOVING]
        await turns()
        stop = asyncio.ensure_future(rig.gate.stop(TIMEOUT))
        for each in waiting:
            with pytest.raises(SupersededError, match=r"cancelled by a stop of the robot|newer"):
                await soon(each)
        rig.wire.thaw()
        assert (await soon(stop)).success
        await soon(load)
        assert len(types(rig.wire)) == ORDERS


async def test_an_announced_stop_overtakes_what_waits_for_the_event_loop() -> None:
    async with gated() as rig:
        rig.gate.announce_stop()  # in another thread, while velocities wait for the event loop
        with pytest.raises(SupersededError, match="cancelled by a stop"):
            await soon(rig.drive(0.2))
        assert (await soon(rig.gate.stop(1.0))).success
        assert speeds(rig.wire) == [0]


async def test_what_was_sent_to_the_agent_before_a_stop_does_not_move_the_robot_later() -> None:
    async with gated(hold=0.0) as rig:
        before = asyncio.get_running_loop().time()
        await soon(rig.gate.stop(TIMEOUT))
        for request in MOVING:
            with pytest.raises(SupersededError, match=r"before the last stop.*synchronise the"):
                await rig.gate.request(request, sender=Sender(published=before))
        assert len(types(rig.wire)) == ORDERS


async def test_what_was_sent_to_the_agent_after_a_stop_moves_the_robot() -> None:
    async with gated(hold=0.0) as rig:
        before = asyncio.get_running_loop().time()
        await soon(rig.gate.stop(TIMEOUT))
        for request in MOVING:
            await ok(rig.gate.request(request, sender=Sender(published=math.inf)))
        assert len(types(rig.wire)) == ORDERS + len(MOVING)
        other_clock = Sender(published=before - 3600.0)
        slower = [each for each in MOVING if not isinstance(each, Twist)]
        for request in slower:
            await ok(rig.gate.request(request, sender=other_clock))
        assert len(types(rig.wire)) == ORDERS + len(MOVING) + len(slower)


@pytest.mark.parametrize(
    ("is_busy", "reason"),
    [(False, "the chassis did not answer"), (True, "not sent: the connection was busy")],
)
async def test_a_stop_without_an_answer_says_so(is_busy: bool, reason: str) -> None:
    async with gated(answer_nothing) as rig:
        load = await block(rig.client, rig.wire) if is_busy else None
        report = await soon(rig.gate.stop(0.03))
        assert not report.success
        assert report.message.startswith(f"NOT STOPPED: {reason}")
        assert report.message.endswith("press its emergency stop")
        if load is not None:
            load.cancel()


async def test_a_zero_that_is_refused_because_of_a_task_is_sent_again_after_the_cancel() -> None:
    cancelled = False

    def is_refused(frame: Frame) -> bool:
        nonlocal cancelled
        cancelled |= is_task_order(frame)
        return is_zero(frame) and not cancelled

    async with gated(refusing(is_refused)) as rig:
        report = await soon(rig.gate.stop(TIMEOUT))
        assert report.success
        assert report.message.startswith("stopped; task cancelled")
        assert speeds(rig.wire) == [0, 0]


async def test_a_zero_that_is_refused_while_the_task_ends_is_sent_again() -> None:
    """The report of the end comes just before the answer to the second zero."""

    async def chassis(wire: Wire, frame: Frame) -> bool:
        zeros = len(speeds(wire))
        if is_zero(frame) and zeros == 2:
            await wire.push("woosh.robot.TaskProc", {**RUNNING, "state": "kCanceled"})
        return await (refuse_zeros if zeros <= 2 else answer_all)(wire, frame)

    async with gated(chassis, effect=NEVER) as rig:
        await begins_uncancelled(rig)
        report = await soon(rig.gate.stop(TIMEOUT))
        assert report.success
        assert speeds(rig.wire) == [0, 0, 0]


@pytest.mark.parametrize("state", ["kExecuting", "kPaused"])
@pytest.mark.parametrize(
    "refuse", [refuse_zeros, refusing(lambda frame: is_zero(frame) or is_task_order(frame))]
)
async def test_a_zero_that_is_refused_until_the_task_has_ended_is_sent_again_then(
    refuse: Script, state: str
) -> None:
    """A real robot ends a task some time after it has accepted the cancel, or an earlier one."""
    ended = False

    async def chassis(wire: Wire, frame: Frame) -> bool:
        return await (answer_all if ended else refuse)(wire, frame)

    async with gated(chassis, effect=NEVER) as rig:
        await rig.tell("woosh.robot.TaskProc", {**RUNNING, "state": state})
        stop = asyncio.ensure_future(rig.gate.stop(TIMEOUT))
        await eventually(lambda: len(types(rig.wire)) == ORDERS + 1)
        await turns()
        assert not stop.done()
        ended = True
        await rig.wire.push("woosh.robot.TaskProc", {**RUNNING, "state": "kCanceled"})
        assert (await soon(stop)).success
        assert speeds(rig.wire) == [0, 0, 0]


async def test_a_stop_without_the_answer_to_one_cancel_is_a_failure() -> None:
    async def all_but_the_task(wire: Wire, frame: Frame) -> bool:
        return is_task_order(frame) or await answer_all(wire, frame)

    async with gated(all_but_the_task) as rig:
        report = await soon(rig.gate.stop(1.0))
        assert not report.success
        assert report.message.startswith("stopped; ")
        assert "cancel of task: the chassis did not answer" in report.message
        assert report.message.endswith("press its emergency stop")


@pytest.mark.parametrize(
    ("reports", "body", "what"),
    [
        ("woosh.robot.TaskProc", RUNNING, "task"),
        ("woosh.ros.Feedbacks", feedback("LiftControl", "kRosExecuting"), "LiftControl"),
        ("woosh.robot.RobotState", {"state": "kFollowing"}, "Follow"),
    ],
)
async def test_a_stop_is_a_failure_if_the_chassis_refuses_to_cancel_what_moves(
    reports: str, body: Frame, what: str
) -> None:
    async with gated(refusing(lambda frame: not is_zero(frame)), effect=0.1) as rig:
        assert (await soon(rig.gate.stop(TIMEOUT))).success, "nothing was running"
        await rig.tell(reports, body)
        report = await soon(rig.gate.stop(TIMEOUT))
        assert not report.success
        assert report.message.startswith(f"NOT STOPPED: cancel of {what}: Request failed; ")
        assert report.message.endswith("press its emergency stop")


async def test_a_stop_just_after_a_cancel_waits_for_the_report_of_its_effect() -> None:
    """The chassis refuses to cancel what has ended, and reports the end later."""
    async with gated(refusing(is_task_order), effect=NEVER) as rig:
        await rig.wire.push("woosh.robot.TaskProc", RUNNING)
        await eventually(lambda: rig.gate.owner)
        stop = asyncio.ensure_future(rig.gate.stop(TIMEOUT))
        await eventually(lambda: len(types(rig.wire)) == ORDERS)
        await turns()
        assert not stop.done()
        await rig.wire.push("woosh.robot.TaskProc", {**RUNNING, "state": "kCanceled"})
        assert (await soon(stop)).success


LIFT = CallAction(lift_control=LiftControl(action=kExecute, execute_mode=LiftControl.kUp))


@pytest.mark.parametrize(
    ("start", "answered"),
    [(ExecTask(task_id=7), "before the stop"), (LIFT, "after the stop"), (LIFT, "never")],
)
async def test_what_begins_after_a_stop_although_it_was_started_before_is_cancelled(
    start: Message, answered: str
) -> None:
    """The chassis refuses to cancel what it has accepted and not begun."""
    type_ = start.DESCRIPTOR.full_name
    begun = False
    starts: list[Frame] = []

    async def chassis(wire: Wire, frame: Frame) -> bool:
        if frame["type"] == type_ and not starts:
            starts.append(frame)
            if answered == "before the stop":
                await wire.answer(frame)
            return True
        is_cancel = frame["type"] in ("woosh.robot.ActionOrder", "woosh.ros.CallAction")
        if is_cancel and not begun:
            await wire.answer(frame, ok=False, msg="Request failed")
            return True
        return await answer_all(wire, frame)

    async with gated(chassis, effect=NEVER) as rig:
        starting = asyncio.ensure_future(rig.gate.request(start))
        await eventually(lambda: type_ in types(rig.wire))
        if answered == "before the stop":
            await soon(starting)
        assert (await soon(rig.gate.stop(TIMEOUT))).success, "nothing runs yet"
        if answered == "after the stop":
            await rig.wire.answer(starts[0])
            await soon(starting)
        begun = True
        sent = len(types(rig.wire))
        # the begin of something else tells nothing about the start
        await rig.wire.push("woosh.ros.Feedbacks", feedback("StepControl", "kRosExecuting"))
        if start is LIFT:
            await rig.wire.push("woosh.ros.Feedbacks", feedback("LiftControl", "kRosExecuting"))
        else:
            await rig.wire.push("woosh.robot.TaskProc", RUNNING)
        await eventually(lambda: len(types(rig.wire)) == sent + ORDERS)
        assert types(rig.wire)[sent : sent + 2] == [TWIST, "woosh.robot.ActionOrder"]
        starting.cancel()


async def test_a_second_start_before_a_stop_is_also_cancelled_late() -> None:
    async with gated(hold=0.0, effect=NEVER) as rig:
        for number in (6, 7):
            await ok(rig.gate.request(ExecTask(task_id=number)))
        await rig.wire.push("woosh.robot.TaskProc", {**RUNNING, "robotTaskId": "6"})
        await eventually(lambda: rig.gate.owner == "task 6")
        await soon(rig.gate.stop(TIMEOUT))
        sent = len(types(rig.wire))
        await rig.wire.push("woosh.robot.TaskProc", RUNNING)
        await eventually(lambda: len(types(rig.wire)) == sent + ORDERS)


@pytest.mark.parametrize(
    ("before_stop", "after_stop"), [(1.1, 0.0), (0.0, 1.1), (0.0, 2.1)], ids=str
)
async def test_a_start_that_a_busy_chassis_executes_late_is_cancelled(
    before_stop: float, after_stop: float
) -> None:
    """What it begins depends on when it executes the requests, not on when they were sent.

    In the last case, it executes the start at once, and the stop late.
    """
    effect, busy, held = 1.0, True, list[Frame]()
    answers_start = after_stop > 2 * effect

    async def chassis(wire: Wire, frame: Frame) -> bool:
        is_awaited = "sn" in frame and frame["type"] not in (INFO, FEEDBACKS)
        if frame["type"] == EXEC_TASK and answers_start:
            return await answer_all(wire, frame)
        if busy and is_awaited:
            held.append(frame)
            return True
        return await answer_all(wire, frame)

    async with gated(chassis, hold=0.0, effect=effect) as rig:
        starting = asyncio.ensure_future(rig.gate.request(ExecTask(task_id=7)))
        await eventually(lambda: held or starting.done())
        await asyncio.sleep(before_stop)
        stopping = asyncio.ensure_future(rig.gate.stop(TIMEOUT))
        await eventually(lambda: len(held) == ORDERS + (not answers_start))
        await asyncio.sleep(after_stop)
        busy = False
        for frame in held:
            await rig.wire.answer(frame)
        assert (await soon(starting)).ok
        assert (await soon(stopping)).success
        await rig.wire.push("woosh.robot.TaskProc", RUNNING)
        await eventually(lambda: len(types(rig.wire)) == 1 + 2 * ORDERS)


async def test_a_late_start_is_cancelled_although_an_earlier_one_has_never_begun() -> None:
    """Its client may have cancelled the earlier one in time."""
    async with gated(hold=0.0, effect=1.0) as rig:
        await ok(rig.gate.request(ExecTask(task_id=6)))
        await asyncio.sleep(1.1)
        await ok(rig.gate.request(ExecTask(task_id=7)))
        await soon(rig.gate.stop(TIMEOUT))
        sent = len(types(rig.wire))
        await rig.wire.push("woosh.robot.TaskProc", RUNNING)
        await eventually(lambda: len(types(rig.wire)) == sent + ORDERS)


async def test_a_late_start_that_is_not_cancelled_is_an_error(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async with gated(refusing(is_task_order), effect=1.0) as rig:
        await ok(rig.gate.request(ExecTask(task_id=7)))
        assert (await soon(rig.gate.stop(TIMEOUT))).success, "nothing runs yet"
        await rig.wire.push("woosh.robot.TaskProc", RUNNING)
        await eventually(lambda: "NOT STOPPED: cancel of task: Request failed" in caplog.text)


async def begins_uncancelled(rig: Rig, task_id: int = 7) -> None:
    """Let a task begin, perhaps of another client; check that nothing is sent because of it."""
    sent = len(types(rig.wire))
    await rig.wire.push("woosh.robot.TaskProc", {**RUNNING, "robotTaskId": str(task_id)})
    await eventually(lambda: rig.gate.owner == f"task {task_id}")
    await turns()
    assert len(types(rig.wire)) == sent


@pytest.mark.parametrize("before", [6, 1719959961], ids=["a small id", "Unix seconds"])
async def test_what_another_client_starts_after_a_stop_is_not_cancelled(before: int) -> None:
    async with gated(hold=0.0, effect=NEVER) as rig:
        await ok(rig.gate.request(ExecTask(task_id=before)))
        await rig.wire.push("woosh.robot.TaskProc", {**RUNNING, "robotTaskId": str(before)})
        await eventually(lambda: rig.gate.owner == f"task {before}")
        await soon(rig.gate.stop(TIMEOUT))
        await begins_uncancelled(rig, before + 1)


@pytest.mark.parametrize(
    ("stopped", "start", "begins"),
    [
        (SET * 100 + 1, ExecPreTask(task_set_id=SET), [SET * 100 + 1, SET * 100 + 2]),
        (4711, ExecTask(task_id=4711), [4711]),
        (4711, ExecTask(task_id=4712), [4712]),  # as if it were the next one of set 47
    ],
    ids=["a set", "the same task", "another task"],
)
async def test_what_is_started_again_after_a_stop_is_not_cancelled(
    stopped: int, start: Message, begins: list[int]
) -> None:
    async with gated(hold=0.0, effect=NEVER) as rig:
        await begins_uncancelled(rig, stopped)
        await soon(rig.gate.stop(TIMEOUT))
        await rig.wire.push("woosh.robot.TaskProc", {})
        await eventually(lambda: not rig.gate.owner)
        await ok(rig.gate.request(start))
        for task_id in begins:
            await begins_uncancelled(rig, task_id)


@pytest.mark.parametrize("is_accepted", [False, True])
async def test_a_stopped_set_does_not_go_on_because_another_task_was_requested(
    is_accepted: bool,
) -> None:
    async def chassis(wire: Wire, frame: Frame) -> bool:
        waits = frame["type"] == EXEC_TASK and not is_accepted
        return not waits and await answer_all(wire, frame)

    async with gated(chassis, hold=0.0, effect=NEVER) as rig:
        await begins_uncancelled(rig, SET * 100 + 1)
        await soon(rig.gate.stop(TIMEOUT))
        await rig.wire.push("woosh.robot.TaskProc", {})
        await eventually(lambda: not rig.gate.owner)
        retry = asyncio.ensure_future(rig.gate.request(ExecTask(task_id=7)))
        if is_accepted:
            await ok(retry)
        else:
            frame = await rig.wire.next(EXEC_TASK)
        sent = len(types(rig.wire))
        for stops in (1, 2):
            body = {"robotTaskId": f"{SET * 100 + stops + 1}", "state": "kExecuting"}
            await rig.wire.push("woosh.robot.TaskProc", body)
            await eventually(lambda stops=stops: len(types(rig.wire)) == sent + stops * ORDERS)
        if not is_accepted:
            await rig.wire.answer(frame, ok=False, msg="Task is excuting")
            await soon(retry)


async def test_a_velocity_that_was_held_back_is_not_sent_after_a_task_was_requested() -> None:
    async with gated(answer_nothing, unanswered=0.0) as rig:
        first = rig.drive(1)
        frame = await rig.wire.next(TWIST)
        held = rig.drive(2)
        await turns()
        starting = asyncio.ensure_future(rig.gate.request(ExecTask(task_id=7)))
        with pytest.raises(SupersededError, match="a task or an action drives"):
            await soon(held)
        await rig.wire.answer(await rig.wire.next(EXEC_TASK))
        await rig.wire.answer(frame)
        await soon(asyncio.gather(first, starting))
        assert speeds(rig.wire) == [1]


async def test_the_next_of_a_set_that_had_ended_before_a_stop_is_not_cancelled() -> None:
    """E.g. after the stop of an idle robot."""
    async with gated(hold=0.0, effect=0.0) as rig:
        await begins_uncancelled(rig, SET * 100 + 1)
        await rig.wire.push("woosh.robot.TaskProc", {})
        await eventually(lambda: not rig.gate.owner)
        await soon(rig.gate.stop(TIMEOUT))
        rig.gate.timing = replace(rig.gate.timing, effect=NEVER)
        await begins_uncancelled(rig, SET * 100 + 2)


async def test_a_start_after_a_stop_that_ended_one_before_it_began_is_not_cancelled() -> None:
    async with gated(hold=0.0, effect=NEVER) as rig:
        await ok(rig.gate.request(ExecTask(task_id=6)))
        await soon(rig.gate.stop(TIMEOUT))
        await ok(rig.gate.request(ExecTask(task_id=7)))
        await begins_uncancelled(rig)


@pytest.mark.parametrize("again", [False, True], ids=["before the stop", "again after it"])
async def test_a_task_of_another_client_that_a_stop_did_not_reach_is_cancelled(again: bool) -> None:
    """The state of the robot shows that it has accepted a task, before the task begins."""
    async with gated(hold=0.0, effect=NEVER) as rig:
        await rig.tell("woosh.robot.RobotState", {"state": "kTask"})
        assert (await soon(rig.gate.stop(TIMEOUT))).success
        if again:
            for state in ("kIdle", "kTask"):
                await rig.wire.push("woosh.robot.RobotState", {"state": state})
            await begins_uncancelled(rig)
        else:
            sent = len(types(rig.wire))
            await rig.wire.push("woosh.robot.TaskProc", RUNNING)
            await eventually(lambda: len(types(rig.wire)) == sent + ORDERS)


@pytest.mark.parametrize("when", ["before the first task", "during a task", "between two tasks"])
@pytest.mark.parametrize("second", [2, 1], ids=["with more tasks", "that is repeated"])
async def test_a_stop_ends_a_whole_task_set(when: str, second: int) -> None:
    """Real robots go on with the next task of a set when the cancelled one has ended."""

    async def report(number: int, state: str) -> None:
        body = {"robotTaskId": str(SET * 100 + number), "state": state}
        await rig.wire.push("woosh.robot.TaskProc", body)

    async def ends(number: int) -> None:
        await report(number, "kCanceled")
        await rig.wire.push("woosh.robot.TaskProc", {})
        await eventually(lambda: not rig.gate.owner)

    async with gated(hold=0.0, effect=NEVER) as rig:
        if when == "before the first task":
            await ok(rig.gate.request(ExecPreTask(task_set_id=SET)))
        else:
            await report(1, "kExecuting")
            await eventually(lambda: rig.gate.owner)
        if when == "between two tasks":
            await ends(1)
        sent = len(types(rig.wire))
        assert (await soon(rig.gate.stop(TIMEOUT))).success
        if when == "during a task":
            await ends(1)
        numbers = (1, second, 3) if when == "before the first task" else (second, 3)
        for stops, number in enumerate(numbers, 2):
            await report(number, "kExecuting")
            await eventually(lambda stops=stops: len(types(rig.wire)) == sent + stops * ORDERS)
            await ends(number)
        await begins_uncancelled(rig)


@pytest.mark.parametrize(
    ("before", "is_told_first", "longest"),
    [
        ("a start", True, 30.0),
        ("a task of a set", False, 30.0),
        ("an accepted task", True, 30.0),
        ("a start", True, 0.0),
    ],
)
async def test_what_begins_during_a_loss_of_the_link_after_a_stop_is_cancelled(
    before: str, is_told_first: bool, longest: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The loss lasts for longer than what is expected to begin after a stop takes to begin."""
    monkeypatch.setattr(gate, "_LONGEST_LOSS", longest)
    running = {"robotTaskId": f"{SET * 100 + 2}", "state": "kExecuting"}
    async with gated(link={"backoff_min": 4.0, "backoff_max": 4.0}, hold=0.0, effect=1.0) as rig:
        if before == "a start":
            await ok(rig.gate.request(ExecTask(task_id=7)))
        elif before == "a task of a set":
            await begins_uncancelled(rig, SET * 100 + 1)
        else:
            await rig.tell("woosh.robot.RobotState", {"state": "kTask"})
        await soon(rig.gate.stop(TIMEOUT))
        rig.peer.info = {"state": "kTask", **({"taskProc": running} if is_told_first else {})}
        rig.wire.abort()
        await rig.second_wire()
        if not is_told_first:
            await rig.wire.push("woosh.robot.TaskProc", running)
        await eventually(lambda: rig.gate.owner)
        if longest:
            await eventually(lambda: len(types(rig.wire)) == ORDERS)
        else:
            await turns()
            assert types(rig.wire) == []


async def test_a_following_before_a_stop_is_no_start_of_a_task() -> None:
    async with gated(hold=0.0, effect=NEVER) as rig:
        await ok(rig.gate.request(Follow(type=True)))
        await soon(rig.gate.stop(TIMEOUT))
        await begins_uncancelled(rig)


async def test_a_task_that_was_not_sent_before_a_stop_is_no_start() -> None:
    async def hang_while_speaking(wire: Wire, frame: Frame) -> bool:
        return frame["type"] == "woosh.robot.Speak" or await answer_all(wire, frame)

    limit = {"max_in_flight": 1}
    async with gated(hang_while_speaking, link=limit, hold=0.0, effect=NEVER) as rig:
        speaking = asyncio.ensure_future(rig.client.request(Speak(text="x")))
        await turns()
        with pytest.raises(TooManyRequestsError):
            await rig.gate.request(ExecTask(task_id=6))
        await soon(rig.gate.stop(TIMEOUT))
        await begins_uncancelled(rig)
        speaking.cancel()


# The agent ends


async def test_once_closed_nothing_that_moves_is_sent() -> None:
    async with gated(hold=0.0) as rig:
        await rig.gate.close(TIMEOUT)
        await soon(rig.gate.stop(TIMEOUT))  # forbids motion for a while only
        for request in MOVING:
            with pytest.raises(SupersededError, match="the agent is stopping"):
                await rig.gate.request(request)
        await ok(rig.gate.request(Speak()))
        assert len(types(rig.wire)) == ORDERS


@pytest.mark.parametrize(
    "end",
    [lambda gate: gate.close(TIMEOUT), lambda gate: gate.stop_driving(REASON, TIMEOUT)],
    ids=["the agent ends", "the link is about to be closed"],
)
@pytest.mark.parametrize("drove", [False, True])
async def test_the_last_zero_is_sent_once_and_only_if_the_robot_may_drive(
    drove: bool, end: Callable[[MotionGate], Awaitable[None]]
) -> None:
    async with gated() as rig:
        if drove:
            await ok(rig.drive(1))
        await end(rig.gate)
        await end(rig.gate)
        assert speeds(rig.wire) == [1, 0] * drove
        assert not rig.gate.driving


async def test_a_zero_that_was_not_confirmed_is_sent_again() -> None:
    async with gated(answer_nothing) as rig:
        task = rig.drive(1)
        await rig.wire.answer(await rig.wire.next(TWIST))
        await soon(task)
        with pytest.raises(RequestTimeoutError):
            await rig.gate.close(0.03)
        closing = asyncio.ensure_future(rig.gate.close(TIMEOUT))
        await rig.wire.next(TWIST)
        await rig.wire.answer(await rig.wire.next(TWIST))
        await soon(closing)
        assert not rig.gate.driving


async def test_a_refused_zero_does_not_count_as_stopped() -> None:
    async with gated(refuse_zeros) as rig:
        await ok(rig.drive(1))
        assert not (await rig.gate.request(Twist())).ok
        assert rig.gate.driving
        with pytest.raises(LinkError, match="refused the zero velocity: no remote control"):
            await rig.gate.close(TIMEOUT)


async def test_the_last_zero_replaces_a_held_velocity() -> None:
    async with gated(answer_nothing, unanswered=0.0) as rig:
        first = rig.drive(1)
        frame = await rig.wire.next(TWIST)
        held = rig.drive(2)
        await turns()
        await answered(rig.gate.close(TIMEOUT), rig.wire)
        await rig.wire.answer(frame)
        await soon(first)
        with pytest.raises(SupersededError):
            await soon(held)
        assert speeds(rig.wire) == [1, 0]


async def test_a_velocity_that_was_not_sent_does_not_count_as_driving() -> None:
    async with gated() as rig:
        await rig.client.close()
        with pytest.raises(NotConnectedError):
            await rig.drive(1)
        await rig.gate.close(TIMEOUT)


async def test_the_robot_counts_as_standing_some_time_after_the_last_velocity() -> None:
    assert MotionTiming().driving == 1.5
    async with gated(driving=0.05) as rig:
        rig.gate.timing = MotionTiming(max_age=NEVER, driving=NEVER)
        await ok(rig.drive(1))
        assert rig.gate.driving
        rig.gate.timing = MotionTiming(max_age=NEVER, driving=0.05)
        await ok(rig.drive(1))
        await eventually(lambda: not rig.gate.driving)
        await rig.gate.close(TIMEOUT)
        assert speeds(rig.wire) == [1, 1]


# The link is about to be closed, or the agent begins to observe only


async def test_no_velocity_follows_the_zero() -> None:
    async def answer_velocities(wire: Wire, frame: Frame) -> bool:
        return is_zero(frame) or await answer_all(wire, frame)

    async with gated(answer_velocities) as rig:
        await ok(rig.drive(1))
        leaving = asyncio.ensure_future(rig.gate.stop_driving(REASON, TIMEOUT))
        await turns()
        with pytest.raises(SupersededError, match=REASON):
            await rig.drive(3)
        await eventually(lambda: speeds(rig.wire) == [1, 0])
        await rig.wire.answer(rig.wire.seen[-1])
        await soon(leaving)
        assert speeds(rig.wire) == [1, 0]


@pytest.mark.parametrize("refused", [False, True])
async def test_a_robot_that_cannot_be_stopped_is_an_error(
    refused: bool, caplog: pytest.LogCaptureFixture
) -> None:
    script = refuse_zeros if refused else answer_all
    async with gated(script, {"backoff_min": 60.0, "backoff_max": 60.0}) as rig:
        await ok(rig.drive(1))
        if not refused:
            rig.wire.abort()
            await eventually(lambda: rig.client.state is not LinkState.READY)
        await rig.gate.stop_driving(REASON, TIMEOUT)
        (record,) = [each for each in caplog.records if each.levelname == "ERROR"]
        assert "the robot was not stopped" in record.getMessage()
        assert ("no remote control" if refused else "not connected") in record.getMessage()


async def test_a_robot_that_is_only_observed_from_now_on_gets_its_zero_and_no_other_command() -> (
    None
):
    async with gated() as rig:
        await ok(rig.drive(1))
        rig.client.permit_only(only_reads, "it only observes")
        await rig.gate.stop_driving("it only observes", TIMEOUT)
        for request in (*MOVING, Twist()):
            with pytest.raises(NotPermittedError, match="it only observes"):
                await rig.gate.request(request)
        assert not rig.gate.driving, "a refused velocity does not drive"
        report = await rig.gate.stop(TIMEOUT)
        assert not report.success
        assert "it only observes" in report.message
        await rig.gate.close(TIMEOUT)
        assert speeds(rig.wire) == [1, 0]
