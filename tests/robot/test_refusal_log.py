"""The log of refused commands."""

from __future__ import annotations

import asyncio
import logging

import pytest

from tests.link.link_peer import eventually
from tests.robot.rig import READY, Rig
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ActionOrder, ExecTask, Twist
from woosh_robot_agent.pb.robot.robot_pb2 import DeviceState, Mode
from woosh_robot_agent.pb.ros.action_pb2 import StepControl, kExecute
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction
from woosh_robot_agent.pb.util import action_pb2
from woosh_robot_agent.robot import code_log


def logged(caplog: pytest.LogCaptureFixture) -> list[str]:
    records = [record for record in caplog.records if record.name == code_log.__name__]
    return [record.getMessage() for record in records if record.levelno == logging.WARNING]


def explaining() -> bool:
    """Return True if the reason of a refusal is not known yet."""
    return "reason of a refusal" in {task.get_name() for task in asyncio.all_tasks()}


async def refused(rig: Rig, message: object, source: str = "") -> None:
    """Send a command that is refused, and wait until its reason is known."""
    await rig.send(message, source)
    await eventually(lambda: not explaining())


async def test_each_refusal_is_logged_once_until_a_success(
    caplog: pytest.LogCaptureFixture,
) -> None:
    rig = Rig({**READY, "deviceState": {"hardware": 1024, "software": 1}})
    async with rig.running():
        rig.refusal = "State not allow to twist"
        for _ in range(3):
            await refused(rig, Twist(linear=0.1), "robot/Twist")
        assert logged(caplog) == [
            "the chassis refused robot/Twist: State not allow to twist (the emergency stop is "
            "pressed: make sure that nobody is in danger, then release the button)"
        ]
        rig.refusal = ""
        await rig.send(Twist(linear=0.1), "robot/Twist")
        rig.refusal = "State not allow to twist"
        await refused(rig, Twist(linear=0.1), "robot/Twist")
        assert len(logged(caplog)) == 2


async def test_another_reason_is_logged_too(caplog: pytest.LogCaptureFixture) -> None:
    rig = Rig(READY)
    async with rig.running():
        rig.refusal = "Request failed"
        await refused(rig, ExecTask(task_id=1))
        await rig.push(Mode(), {"ctrl": 2, "work": 2})
        await refused(rig, ExecTask(task_id=1))
        await rig.push(DeviceState(), {"hardware": 1024, "software": 1})
        await refused(rig, CallAction(step_control=StepControl(action=kExecute)))
    first, second, third = logged(caplog)
    assert first == "the chassis refused robot/ExecTask: Request failed"
    assert second.startswith("the chassis refused robot/ExecTask: Request failed (the robot is in ")
    assert third.startswith("the chassis refused ros/StepControl: Request failed (the emergency ")


async def test_refusals_in_other_words_are_logged_even_at_the_same_time(
    caplog: pytest.LogCaptureFixture,
) -> None:
    rig = Rig(READY)
    async with rig.running():
        for rig.refusal in ("Request failed", "Task id exists", "Request failed"):
            await rig.send(ExecTask(task_id=1))
        await eventually(lambda: not explaining())
    assert sorted(logged(caplog)) == [
        "the chassis refused robot/ExecTask: Request failed",
        "the chassis refused robot/ExecTask: Task id exists",
    ]


async def test_a_refused_cancel_is_left_to_the_log_of_its_goal(
    caplog: pytest.LogCaptureFixture,
) -> None:
    rig = Rig(READY)
    async with rig.running():
        rig.refusal = "Request failed"
        await refused(rig, ActionOrder(order=action_pb2.kCancel), code_log.GOAL_CANCEL)
        assert logged(caplog) == []
        await refused(rig, ActionOrder(order=action_pb2.kCancel), "robot/ActionOrder")
        assert [line[:37] for line in logged(caplog)] == ["the chassis refused robot/ActionOrder"]
