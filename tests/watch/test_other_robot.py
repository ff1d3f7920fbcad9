"""Another robot: the observers forget what they know of the former one."""

from __future__ import annotations

import logging
from typing import Any

import pytest

from tests.link.link_peer import TIMEOUT, aio, eventually
from tests.watch.rig import READY, Rig
from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ExecPreTask, ExecTask, Follow, Twist
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed, RobotState, TaskProc
from woosh_robot_agent.robot import refusals, standstill
from woosh_robot_agent.robot.who_drives import OTHER_CLIENT, Driver

FORWARD = Twist(linear=0.2)
MOVING = {"pose": {"x": 1.1}, "twist": {"linear": 0.2}}
NAVIGATING = {"robotTaskId": "19", "type": 1, "state": 3, "action": {"type": 1, "state": 1}}
HOT = {"code": 110301000042, "level": 2}
NOT_AUTOMATIC = {"code": 140801000081, "level": 2}


def warnings(caplog: pytest.LogCaptureFixture, text: str) -> list[str]:
    found = [r.getMessage() for r in caplog.records if r.levelno >= logging.WARNING]
    return [message for message in found if text in message]


@pytest.mark.parametrize("request_", [ExecTask(task_id=19), ExecPreTask(task_set_id=19)])
@aio
async def test_its_tasks_are_not_those_of_the_agent(request_: Any) -> None:
    number = 19 if isinstance(request_, ExecTask) else 1901
    async with Rig(READY).running() as rig:
        await rig.send(request_, "robot/ExecTask")
        await rig.turn_to_another_robot()
        await rig.push(TaskProc(), {**NAVIGATING, "robotTaskId": str(number)})
        assert rig.watch.who_drives.now() == Driver(OTHER_CLIENT, f"task {number}")


@aio
async def test_its_own_task_is_told_by_its_own_report() -> None:
    """The number tells at which second the robot began the task, here two days before."""
    own = {**NAVIGATING, "robotTaskId": "172724740253", "type": 2}
    async with Rig(READY).running() as rig:
        await rig.push(TaskProc(), {**own, "time": 1727247402})
        assert rig.watch.who_drives.now().name == "the robot itself"
        await rig.turn_to_another_robot({**READY, "taskProc": {**own, "time": 1727447402}})
        assert rig.watch.who_drives.now().name == OTHER_CLIENT


@aio
async def test_somebody_whom_it_follows_is_not_the_agents() -> None:
    async with Rig(READY).running() as rig:
        await rig.send(Follow(type=1), "robot/Follow")
        await rig.turn_to_another_robot()
        await rig.push(RobotState(), {"state": 7})
        assert rig.watch.who_drives.now() == Driver(OTHER_CLIENT, "the robot is following somebody")


@aio
async def test_it_does_not_roll_out_after_a_velocity_of_the_former_one() -> None:
    async with Rig(READY).running() as rig:
        await rig.send(FORWARD, "cmd_vel")
        await rig.turn_to_another_robot()
        await rig.push(PoseSpeed(), MOVING)
        assert "another client" in rig.watch.who_drives.now().detail


@aio
async def test_it_stands_until_it_reports_that_it_moves() -> None:
    async with Rig(READY).running() as rig:
        await rig.push(PoseSpeed(), MOVING)
        await rig.turn_to_another_robot({**READY, "poseSpeed": MOVING})
        assert rig.watch.who_drives.now() == Driver("nobody")


@aio
async def test_velocities_to_two_robots_are_not_simultaneous() -> None:
    async with Rig(READY).running() as rig:
        await rig.send(FORWARD, "cmd_vel")
        await rig.turn_to_another_robot()
        await rig.send(FORWARD, "robot/Twist")
        assert rig.watch.velocities.simultaneous == ()


@aio
async def test_simultaneous_velocities_are_forgotten(caplog: pytest.LogCaptureFixture) -> None:
    async with Rig(READY).running() as rig:
        await rig.send(FORWARD, "cmd_vel")
        await rig.send(FORWARD, "robot/Twist")
        assert rig.watch.velocities.simultaneous
        await rig.turn_to_another_robot()
        assert rig.watch.velocities.simultaneous == ()
        await rig.send(FORWARD, "cmd_vel")
        await rig.send(FORWARD, "robot/Twist")
    assert len(warnings(caplog, "at the same time")) == 2


@aio
async def test_a_robot_that_does_not_move_is_reported_for_each(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(standstill, "LIMIT", 0.3)
    async with Rig(READY).running() as rig:
        await rig.send(FORWARD, "cmd_vel")
        await eventually(lambda: rig.watch.standstill.warning)
        await rig.turn_to_another_robot()
        assert rig.watch.standstill.warning == ""
        await rig.send(FORWARD, "cmd_vel")
        await eventually(lambda: rig.watch.standstill.warning)
    assert len(warnings(caplog, "the robot does not move")) == 2


@aio
async def test_codes_are_logged_for_each(caplog: pytest.LogCaptureFixture) -> None:
    async with Rig({**READY, "abnormalCodes": {"scs": [NOT_AUTOMATIC]}}).running() as rig:
        await rig.push(StatusCode(), HOT)
        await rig.turn_to_another_robot()
        await rig.push(StatusCode(), HOT)
    assert len(warnings(caplog, "110301000042")) == 2
    assert len(warnings(caplog, "140801000081")) == 2


@aio
async def test_refusals_are_logged_for_each(caplog: pytest.LogCaptureFixture) -> None:
    async with Rig(READY).running() as rig:
        rig.refusal = "Request failed"
        for _ in range(2):
            await rig.send(FORWARD, "robot/Twist")
            await eventually(lambda: not rig.watch.refusal_log.pending)
        await rig.turn_to_another_robot()
        await rig.send(FORWARD, "robot/Twist")
        await eventually(lambda: not rig.watch.refusal_log.pending)
    assert len(warnings(caplog, "refused robot/Twist")) == 2


@aio
async def test_its_codes_do_not_explain_refusals_of_the_former_one(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(refusals, "CODE_DELAY", TIMEOUT / 2)
    async with Rig(READY).running() as rig:
        rig.refusal = "Request failed"
        await rig.send(FORWARD, "robot/Twist")
        assert rig.watch.refusal_log.pending
        await rig.turn_to_another_robot()
        await rig.push(StatusCode(), NOT_AUTOMATIC)
        await eventually(lambda: not rig.watch.refusal_log.pending, timeout=TIMEOUT / 4)
        await rig.send(FORWARD, "robot/Twist")
        await rig.push(StatusCode(), NOT_AUTOMATIC)
        await eventually(lambda: not rig.watch.refusal_log.pending, timeout=TIMEOUT / 4)
    former, new = warnings(caplog, "refused robot/Twist")
    assert "status code" not in former
    assert "status code 140801000081" in new
