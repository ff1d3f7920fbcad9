"""When the limit of the speed is sent, tested without ROS."""

from __future__ import annotations

import asyncio
import logging
import math

import pytest

from tests.link.link_peer import Frame, Wire, eventually, turns
from tests.motion.gate_checks import FEEDBACKS, Rig, answer_all, feedback, gated, ok
from woosh_robot_agent.motion import SpeedLimiter, speed_limiter
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ChangeNavMode
from woosh_robot_agent.pb.ros.action_pb2 import MoveBase, NavigationMode, kExecute
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction
from woosh_robot_agent.pb.util.navigation_pb2 import ModeSetting

LIMIT = "woosh.robot.ChangeNavMode"
TASK_PROC = "woosh.robot.TaskProc"


def navigating(task_id: int) -> Frame:
    """Return the body of a report on a task that navigates."""
    action = {"type": "kNav", "state": "kRosExecuting"}
    return {"robotTaskId": str(task_id), "state": "kExecuting", "action": action}


def limits(wire: Wire) -> list[float]:
    """Return the limits that the chassis has received, by a task or by an action, in m/s."""
    bodies = [frame["body"] for frame in wire.seen if "navMode" in frame.get("body", ())]
    return [round(body["navMode"].get("maxSpeed", 0.0), 3) for body in bodies]


def limited(rig: Rig) -> SpeedLimiter:
    """Return a limiter with a limit of 0.3 m/s."""
    limiter = SpeedLimiter(rig.client, rig.gate, asyncio.ensure_future, [].append)
    limiter.limit(0.3)
    return limiter


async def test_a_removal_that_the_end_of_a_navigation_prevents_is_sent_in_the_next_one() -> None:
    """Otherwise the robot could stay slow for ever."""

    async def script(wire: Wire, frame: Frame) -> bool:
        if frame["type"] == LIMIT and len(limits(wire)) == 2:
            await wire.push(TASK_PROC, {"robotTaskId": "7", "state": "kCompleted"})
            await wire.answer(frame, ok=False, msg="not navigating")
            return True
        return await answer_all(wire, frame)

    async with gated(script) as rig:
        limited: list[bool] = []
        refused: list[str] = []
        limiter = SpeedLimiter(
            rig.client,
            rig.gate,
            asyncio.ensure_future,
            refused.append,
            lambda: limited.append(limiter.is_limited),
        )
        limiter.limit(0.3)
        await rig.wire.push(TASK_PROC, navigating(7))
        await eventually(lambda: limits(rig.wire) == [0.3])
        limiter.limit(math.inf)
        await eventually(lambda: limited == [True, False, True])
        await rig.wire.push(TASK_PROC, navigating(8))
        await eventually(lambda: limits(rig.wire) == [0.3, 0.0, 0.0])
        await eventually(lambda: not limiter.is_limited)
        # later, the end of the link may leave the last limit without an answer
        assert limited == [True, False, True, False]
        assert refused == []


async def test_a_limit_that_was_not_answered_is_sent_again_during_the_same_drive(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A driving robot may report nothing until its task ends."""
    monkeypatch.setattr(speed_limiter, "_RETRY_AFTER", 0.1)

    async def script(wire: Wire, frame: Frame) -> bool:
        is_first = frame["type"] == LIMIT and limits(wire) == [0.3]
        return is_first or await answer_all(wire, frame)

    async with gated(script, {"request_timeout": 0.1}) as rig:
        limited(rig)
        await rig.wire.push(TASK_PROC, navigating(7))
        await eventually(lambda: limits(rig.wire) == [0.3, 0.3])


async def test_a_task_that_is_repeated_with_the_same_id_gets_the_limit_again() -> None:
    async with gated() as rig:
        limited(rig)
        for count in (1, 2):
            await rig.wire.push(TASK_PROC, navigating(7))
            await eventually(lambda count=count: limits(rig.wire) == [0.3] * count)
            await rig.wire.push(TASK_PROC, {"robotTaskId": "7", "state": "kCompleted"})


@pytest.mark.parametrize("earlier", ["task", "action"])
async def test_the_limit_waits_for_the_navigation_if_only_a_query_has_told_the_end_of_the_last_one(
    earlier: str,
) -> None:
    """Before that, a real robot refuses it."""

    async with gated() as rig:
        limited(rig)
        if earlier == "task":
            await rig.wire.push(TASK_PROC, navigating(7))
        else:
            await rig.wire.push(FEEDBACKS, feedback("MoveBase", "kRosExecuting"))
        await eventually(lambda: limits(rig.wire) == [0.3])
        rig.gate.wheel_owner.task_ended(7)
        rig.gate.wheel_owner.action_ended("MoveBase")
        await ok(rig.gate.request(CallAction(move_base=MoveBase(action=kExecute))))
        await turns()
        assert limits(rig.wire) == [0.3]
        await rig.wire.push(FEEDBACKS, feedback("MoveBase", "kRosExecuting"))
        await eventually(lambda: limits(rig.wire) == [0.3, 0.3])
        assert rig.wire.seen[-1]["type"] == CallAction.DESCRIPTOR.full_name


@pytest.mark.parametrize("state", ["kRosExecuting", "kRosErrMsg"])
@pytest.mark.parametrize("is_pushed", [True, False])
async def test_a_navigation_that_goes_on_over_a_lost_link_gets_the_limit_again(
    state: str, is_pushed: bool
) -> None:
    async def script(wire: Wire, frame: Frame) -> bool:
        if frame["type"] == FEEDBACKS and is_pushed and len(wire.peer.wires) > 1:
            await wire.push(FEEDBACKS, feedback("MoveBase", state))
        return await answer_all(wire, frame)

    async with gated(script) as rig:
        limited(rig)
        await rig.wire.push(FEEDBACKS, feedback("MoveBase", "kRosExecuting"))
        await eventually(lambda: limits(rig.wire) == [0.3])
        rig.actions = feedback("MoveBase", state)
        rig.wire.abort()
        again = await rig.second_wire()
        await eventually(lambda: limits(again) == [0.3])


async def test_a_refusal_ends_with_the_navigation_of_the_action() -> None:
    async def script(wire: Wire, frame: Frame) -> bool:
        if frame["type"] != CallAction.DESCRIPTOR.full_name:
            return await answer_all(wire, frame)
        await wire.answer(frame, ok=False, msg="not now")
        return True

    async with gated(script) as rig:
        limiter = limited(rig)
        await rig.wire.push(FEEDBACKS, feedback("MoveBase", "kRosExecuting"))
        await eventually(lambda: limiter.refusal == "not now")
        await rig.wire.push(FEEDBACKS, feedback("MoveBase", "kRosSuccess"))
        await eventually(lambda: not limiter.refusal)


async def test_a_limit_that_may_not_be_sent_is_logged_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.DEBUG)
    async with gated() as rig:
        rig.client.permit_only(lambda _message: False, "nothing is sent")
        limited(rig)
        for number in (1, 2, 3):
            await rig.wire.push(TASK_PROC, navigating(number))
        await eventually(lambda: caplog.text.count("nothing is sent") >= 3)
        warnings = [each.message for each in caplog.records if each.levelname == "WARNING"]
        assert len(warnings) == 1, warnings
        assert warnings[0].startswith("the speed limit was not sent")


@pytest.mark.parametrize("of", ["task", "action"])
async def test_it_is_sent_again_after_a_client_has_set_a_higher_speed_or_none(of: str) -> None:
    async def check(sent: list[float]) -> None:
        await eventually(lambda: limits(rig.wire) == sent)
        await turns()
        assert limits(rig.wire) == sent

    def by_client(speed: float) -> CallAction | ChangeNavMode:
        if of == "action":
            return CallAction(nav_mode=NavigationMode(max_speed=speed))
        return ChangeNavMode(nav_mode=ModeSetting(max_speed=speed))

    async with gated() as rig:
        limited(rig)
        if of == "action":
            await rig.wire.push(FEEDBACKS, feedback("MoveBase", "kRosExecuting"))
        else:
            await rig.wire.push(TASK_PROC, navigating(7))
        await check([0.3])
        sent = [0.3]
        for speed, again in ((0.5, [0.3]), (0.2, []), (0.0, [0.3])):
            await ok(rig.gate.request(by_client(speed)))
            sent = [*sent, speed, *again]
            await check(sent)
