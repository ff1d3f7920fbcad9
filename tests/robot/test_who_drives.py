"""The source that drives the robot."""

from __future__ import annotations

from typing import Any

import pytest

from tests.robot.rig import READY, Rig, StoppedClock
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ExecPreTask, ExecTask, Follow, Twist
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed, RobotState, TaskProc
from woosh_robot_agent.pb.ros.ros_pack_pb2 import Feedbacks
from woosh_robot_agent.pb.task.woosh_task_pb2 import RepeatTask
from woosh_robot_agent.robot import who_drives
from woosh_robot_agent.robot.who_drives import Driver

FORWARD, ZERO = Twist(linear=0.2), Twist()
MOVING = {"pose": {"x": 1.1}, "twist": {"linear": 0.2}}
NAVIGATING = {"robotTaskId": "17", "type": 1, "state": 3, "action": {"type": 1, "state": 1}}


@pytest.mark.parametrize("source", ["cmd_vel", "robot/Twist"])
async def test_velocities(source: str) -> None:
    async with Rig(READY).running() as rig:
        await rig.send(FORWARD, source)
        assert rig.watch.who_drives.now() == Driver(source)
        await rig.push(PoseSpeed(), MOVING)
        await rig.send(ZERO, source)
        assert rig.watch.who_drives.now() == Driver(source, "the robot is rolling to a stop")
        await rig.push(PoseSpeed(), {**MOVING, "twist": {}})
        assert rig.watch.who_drives.now() == Driver("nobody")


async def test_velocities_that_override_a_task():
    async with Rig(READY).running() as rig:
        await rig.push(TaskProc(), NAVIGATING)
        await rig.send(FORWARD, "cmd_vel")
        assert rig.watch.who_drives.now() == Driver("cmd_vel")


def repeat_task(number: int, order: int) -> RepeatTask:
    request = RepeatTask(order=order)
    request.task_set.base.id = number
    return request


async def test_tasks(monkeypatch: pytest.MonkeyPatch) -> None:
    StoppedClock(monkeypatch, who_drives)  # the robot does not rest
    drivers = {
        "18": Driver("another client", "task 18"),
        "19": Driver("robot/ExecTask", "task 19"),
        "2003": Driver("robot/ExecPreTask", "task 2003"),
        "2103": Driver("task/RepeatTask", "task 2103"),
        "2203": Driver("another client", "task 2203"),
        "2303": Driver("a goal", "task 2303"),
        "17": Driver("a goal", "task 17"),
    }
    async with Rig(READY).running() as rig:
        await rig.send(ExecTask(task_id=17))
        await rig.send(ExecPreTask(task_set_id=23))
        await rig.send(ExecTask(task_id=19), "robot/ExecTask")
        await rig.send(ExecPreTask(task_set_id=20), "robot/ExecPreTask")
        await rig.send(repeat_task(21, RepeatTask.kExec), "task/RepeatTask")
        await rig.send(repeat_task(22, RepeatTask.kPut), "task/RepeatTask")
        for task, driver in drivers.items():
            rig.goals = ["task 17", "task set 23"]
            await rig.push(TaskProc(), {**NAVIGATING, "robotTaskId": task})
            assert rig.watch.who_drives.now() == driver
            rig.goals = []
            await rig.push(TaskProc(), {"action": {}})
            assert rig.watch.who_drives.now() == Driver("nobody")


async def test_a_task_whose_id_the_robot_has_chosen() -> None:
    number = 172724740253
    async with Rig(READY).running() as rig:
        await rig.send(ExecTask(type=3), "robot/ExecTask")
        await rig.push(TaskProc(), {"action": {}})
        for name in ("robot/ExecTask", "the robot itself"):  # the second task is of nobody else
            report = {**NAVIGATING, "robotTaskId": str(number), "type": 3, "time": number // 100}
            await rig.push(TaskProc(), report)
            assert rig.watch.who_drives.now().name == name
            number += 100


async def test_a_task_that_outlives_its_goal_is_not_of_another_client() -> None:
    async with Rig(READY).running() as rig:
        await rig.send(ExecTask(task_id=17))
        await rig.push(TaskProc(), NAVIGATING)
        driver = rig.watch.who_drives.now()
        assert driver == Driver("a goal", "task 17; the goal has ended, but the robot continues")


@pytest.mark.parametrize(
    ("number", "kind", "driver"),
    [
        (172724740253, 2, Driver("the robot itself", "parking, task 172724740253")),
        (172724740253, 3, Driver("the robot itself", "charging, task 172724740253")),
        (172724740253, 1, Driver("another client", "task 172724740253")),
        (172724730253, 2, Driver("another client", "task 172724730253")),
        (1727247402531, 2, Driver("another client", "task 1727247402531")),
    ],
)
async def test_tasks_of_the_robot_itself(number: int, kind: int, driver: Driver) -> None:
    """The numbers and times are those of a real robot."""
    report = {**NAVIGATING, "robotTaskId": str(number), "type": kind}
    async with Rig(READY).running() as rig:
        await rig.push(TaskProc(), {**report, "time": 1727247403})
        assert rig.watch.who_drives.now() == driver
        await rig.push(TaskProc(), {**report, "time": 1727247503})
        assert rig.watch.who_drives.now() == driver


@pytest.mark.parametrize(
    ("number", "name"),
    [
        (172724740253, "the robot itself"),
        (172724740201, "another client"),
        (172715000053, "another client"),  # more than a day ago
    ],
)
async def test_tasks_of_the_robot_itself_that_began_before_the_link(number: int, name: str) -> None:
    proc = {**NAVIGATING, "robotTaskId": str(number), "type": 3, "time": 1727247525}
    async with Rig({**READY, "taskProc": proc}).running() as rig:
        assert rig.watch.who_drives.now().name == name
        await rig.push(TaskProc(), {**proc, "time": 1727247700})
        assert rig.watch.who_drives.now().name == name


async def test_actions():
    step = {"action": "woosh.ros.action.StepControl", "state": 2}
    async with Rig(READY).running() as rig:
        await rig.push(Feedbacks(), {"fbs": [step]})
        assert rig.watch.who_drives.now() == Driver("another client", "StepControl")
        rig.goals = ["woosh.ros.action.StepControl"]
        assert rig.watch.who_drives.now() == Driver("a goal", "woosh.ros.action.StepControl")


@pytest.mark.parametrize(
    ("source", "name"), [("robot/Follow", "robot/Follow"), ("", "another client")]
)
async def test_following(source: str, name: str) -> None:
    async with Rig(READY).running() as rig:
        if source:
            await rig.send(Follow(type=True), source)
        await rig.push(RobotState(), {"state": 7})
        assert rig.watch.who_drives.now() == Driver(name, "the robot is following somebody")


@pytest.mark.parametrize(
    ("command", "source", "state"),
    [
        (Follow(type=True), "robot/Follow", 7),
        (ExecTask(task_id=17), "robot/ExecTask", 4),
        (ExecPreTask(task_set_id=20), "robot/ExecPreTask", 4),
    ],
)
async def test_who_started_something_is_forgotten_when_the_robot_has_rested(
    command: Any, source: str, state: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another client may do the same later, e.g. run the same set of tasks."""
    clock = StoppedClock(monkeypatch, who_drives)
    number = "2003" if isinstance(command, ExecPreTask) else "17"
    async with Rig(READY).running() as rig:
        await rig.send(command, source)
        # a robot is idle for a moment between two tasks of a set
        for rest, name in ((0.0, source), (1.0, source), (60.0, "another client")):
            clock.now += rest
            await rig.push(RobotState(), {"state": state})
            if state == 4:
                await rig.push(TaskProc(), {**NAVIGATING, "robotTaskId": number})
            assert rig.watch.who_drives.now().name == name
            clock.now += 60.0
            await rig.push(TaskProc(), {"action": {}})
            await rig.push(RobotState(), {"state": 2})
        await rig.send(command, source)
        await rig.push(RobotState(), {"state": 2})  # late, from what was before
        await rig.push(RobotState(), {"state": state})
        if state == 4:
            await rig.push(TaskProc(), {**NAVIGATING, "robotTaskId": number})
        assert rig.watch.who_drives.now().name == source


async def test_a_movement_that_the_agent_does_not_know(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = StoppedClock(monkeypatch, who_drives)
    async with Rig(READY).running() as rig:
        await rig.push(PoseSpeed(), MOVING)
        driver = rig.watch.who_drives.now()
        assert driver.name == "unknown"
        assert "another client may drive it" in driver.detail
        clock.now += who_drives.REPORT_GAP + 0.1
        assert rig.watch.who_drives.now() == Driver("nobody")


async def test_a_task_that_is_not_reported_yet():
    info: Any = {**READY, "state": 4}
    async with Rig(info).running() as rig:
        await rig.push(PoseSpeed(), MOVING)
        assert "has not reported yet" in rig.watch.who_drives.now().detail
