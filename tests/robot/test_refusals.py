"""Reasons of refusals, with a scripted chassis behind a real socket."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from tests.link.link_peer import TIMEOUT, Frame, Wire, eventually
from tests.robot.rig import Rig
from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode
from woosh_robot_agent.pb.robot.robot_pack_pb2 import (
    ActionOrder,
    BuildMap,
    ChangeNavMode,
    Deployment,
    ExecTask,
    InitRobot,
    Speak,
    Twist,
)
from woosh_robot_agent.pb.robot.robot_pb2 import TaskProc
from woosh_robot_agent.pb.ros.action_pb2 import StepControl
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction
from woosh_robot_agent.pb.task.woosh_task_pb2 import RepeatTask
from woosh_robot_agent.pb.util.action_pb2 import kPause
from woosh_robot_agent.robot.readiness import (
    EMERGENCY_STOP,
    MAINTENANCE,
    MANUAL,
    NO_TASK,
    NOT_DEPLOYMENT,
    NOT_INITIALISED,
)
from woosh_robot_agent.robot.refusals import CODE_DELAY, type_of

READY = {"mode": {"ctrl": 1, "work": 2}, "state": 2}
NAVIGATING = {**READY, "state": 4, "taskProc": {"robotTaskId": "17", "state": 3}}
STEP = CallAction(step_control=StepControl(action=1))
STATUS_CODE = "woosh.robot.count.StatusCode"
NOT_NAVIGATING = 140801000071
NOT_AUTOMATIC = 140801000081
NO_SPEED_CONTROL = 140801000091
NO_INITIALISATION = 140801000232
STEP_OCCUPIED = 120301000022
BY_KEY = "set by its key switch or by software"
UNRELATED = 130104000000


def code(number: int, **fields: Any) -> Frame:
    """Return the body of a status code."""
    return {"code": str(number), **fields}


class RefusingRig(Rig):
    """A rig whose chassis refuses every request.

    Args:
        info: its RobotInfo.
        before: status codes that it sends just before the answer.
        after: status codes that it sends just after the answer.
        patient: wait for a status code as long as a busy machine may need.
    """

    def __init__(
        self,
        info: Any,
        before: tuple[Any, ...] = (),
        after: tuple[Any, ...] = (),
        patient: bool = False,
    ) -> None:
        super().__init__(info, code_delay=TIMEOUT if patient else CODE_DELAY)
        self.refusal = "Request failed"
        self._before, self._after = before, after

    async def reason(self, request: Any) -> str:
        """Send a request; return the reason of its refusal."""
        answer = await self.send(request)
        assert (answer.ok, answer.msg) == (False, "Request failed")
        return await self.explainer.reason(type_of(request))

    async def _handle(self, wire: Wire, frame: Frame) -> bool:
        refused = "sn" in frame and frame["type"] != "woosh.robot.RobotInfo"
        for body in self._before if refused else ():
            await wire.push(STATUS_CODE, body)
        handled = await super()._handle(wire, frame)
        for body in self._after if refused else ():
            await wire.push(STATUS_CODE, body)
        return handled


async def reason_of(rig: RefusingRig, request: Any) -> str:
    """Run a rig, and return the reason for which its chassis refuses a request."""
    async with rig.running():
        return await rig.reason(request)


@pytest.mark.parametrize(
    ("request_", "number", "meaning"),
    [
        (ExecTask(task_id=1), NOT_AUTOMATIC, "action refused: not in automatic mode"),
        (Twist(linear=0.1), NO_SPEED_CONTROL, "speed control refused in the present state"),
        (InitRobot(), NO_INITIALISATION, "initialisation refused in the present state"),
        (ChangeNavMode(), NOT_NAVIGATING, "navigation mode unchanged: robot is not navigating"),
        (STEP, STEP_OCCUPIED, "step control is already in use"),
    ],
)
async def test_the_status_code_after_the_answer_gives_the_reason(
    request_: Any, number: int, meaning: str
) -> None:
    rig = RefusingRig(NAVIGATING, (), (code(UNRELATED), code(number)), patient=True)
    reason = await reason_of(rig, request_)
    assert reason.endswith(f"status code {number}: {meaning}")


async def test_an_earlier_an_unrelated_and_a_late_status_code_give_no_reason():
    unrelated = (UNRELATED, NO_SPEED_CONTROL, NOT_NAVIGATING, STEP_OCCUPIED)
    rig = RefusingRig(READY, (code(NOT_AUTOMATIC),), tuple(map(code, unrelated)))
    async with rig.running():
        assert await rig.reason(ExecTask(task_id=1)) == ""
        await rig.push(StatusCode(), code(NOT_AUTOMATIC))
        assert await rig.explainer.reason("woosh.robot.ExecTask") == ""


async def test_the_reason_is_also_known_to_those_who_ask_after_the_status_code():
    rig = RefusingRig(READY, after=(code(NOT_AUTOMATIC),), patient=True)
    async with rig.running():
        codes: list[StatusCode] = []
        rig.client.subscribe(StatusCode, codes.append)
        await rig.send(ExecTask(task_id=1))
        await eventually(lambda: codes)
        assert "action refused" in await rig.explainer.reason("woosh.robot.ExecTask")


@pytest.mark.parametrize(
    ("request_", "info", "reason"),
    [
        (
            ExecTask(task_id=1),
            {**READY, "mode": {"ctrl": 2, "work": 2}},
            f"{MANUAL.reason}, {BY_KEY}",
        ),
        (ExecTask(task_id=1), {**READY, "state": 1}, NOT_INITIALISED.reason),
        (Twist(linear=0.1), {**READY, "deviceState": {"hardware": 1024}}, EMERGENCY_STOP.reason),
        (ExecTask(task_id=1), NAVIGATING, "the robot is executing task 17"),
        (Twist(linear=0.1), {**READY, "state": 4}, "the robot is executing a task"),
        (Twist(linear=0.1), {**READY, "mode": {"ctrl": 2, "work": 2}}, ""),
        (ChangeNavMode(), READY, NO_TASK.reason),
        (ActionOrder(order=kPause), NAVIGATING, ""),
        (InitRobot(), {**READY, "mode": {"ctrl": 3, "work": 2}}, MAINTENANCE.reason),
        (RepeatTask(order=RepeatTask.kExec), NAVIGATING, "the robot is executing task 17"),
        (RepeatTask(order=RepeatTask.kPut), NAVIGATING, ""),
        (BuildMap(), READY, NOT_DEPLOYMENT.reason),
        (BuildMap(), {**READY, "mode": {"ctrl": 1, "work": 1}}, ""),
        (
            Deployment(),
            NAVIGATING,
            f"the robot is executing task 17; {NOT_DEPLOYMENT.reason}",
        ),
        (Deployment(), {**READY, "mode": {"ctrl": 2, "work": 1}}, ""),
        (Speak(), {**READY, "deviceState": {"hardware": 1024}}, ""),
    ],
)
async def test_the_state_gives_the_reason(request_: Any, info: Any, reason: str) -> None:
    assert await reason_of(RefusingRig(info), request_) == reason


async def test_state_and_status_code_are_both_given():
    info = {**READY, "deviceState": {"hardware": 1024, "software": 1}}
    rig = RefusingRig(info, after=(code(NO_SPEED_CONTROL),), patient=True)
    assert await reason_of(rig, Twist(linear=0.1)) == (
        f"{EMERGENCY_STOP.reason}; status code {NO_SPEED_CONTROL}: "
        "speed control refused in the present state"
    )


async def test_the_state_at_the_time_of_the_refusal_counts():
    rig = RefusingRig(NAVIGATING, patient=True)
    async with rig.running():
        refused: list[Any] = []
        rig.client.on_refused(refused.append)
        await rig.send(ExecTask(task_id=1))
        reason = asyncio.ensure_future(rig.explainer.reason("woosh.robot.ExecTask"))
        await eventually(lambda: any(isinstance(each, ExecTask) for each in refused))
        rig.last_known.remember(TaskProc())
        await rig.wire.push(STATUS_CODE, code(NOT_AUTOMATIC))
        assert (await reason).startswith("the robot is executing task 17; ")
