"""What the page tells of tasks: those that it gave, and all others."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import pytest

from tests.asynchronous import eventually
from tests.quick_chassis import edit_bodies, quick_config
from tests.tools.dashboard.pages import Page, controlled, dashboard, is_emergency_stopped, page
from woosh_robot_agent.link import ChassisClient, LinkConfig
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ExecTask
from woosh_robot_agent.pb.robot.robot_pb2 import RobotInfo, TaskProc
from woosh_robot_agent.pb.util import action_pb2 as action
from woosh_robot_agent.pb.util import task_pb2 as task
from woosh_robot_agent.pb.util.common_pb2 import Pose2D
from woosh_robot_agent.robot.who_drives import Driver
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.tools.dashboard.parts import Parts
from woosh_robot_agent.tools.dashboard.robot import Robot
from woosh_robot_agent.tools.dashboard.tasks import TaskLog


@pytest.fixture
def real_chassis() -> Iterator[SimulatorThread]:
    """A chassis that reports the end of a task for a few milliseconds, as a real one does."""
    with SimulatorThread(quick_config(port=0, tcp_port=0, profile="tr200", speed=5)) as running:
        yield running


async def newest(viewer: Page, **wanted: Any) -> dict[str, Any]:
    """Wait until the newest task has these values; return it."""

    def has(parts: dict[str, Any]) -> Any:
        found = parts["tasks"][0]
        return all(found[name] == value for name, value in wanted.items()) and found

    found: dict[str, Any] = await viewer.until(has)
    return found


async def test_the_page_sees_what_becomes_of_a_task(real_chassis: SimulatorThread) -> None:
    async with dashboard(real_chassis, control=True) as running, page(running) as viewer:
        await viewer.ready()
        assert viewer.parts["tasks"] == []
        await viewer.give("goMark", mark="A2", type="carry", direction="feeding")
        begun = await newest(viewer, to="A2", state="executing", running=True)
        assert (begun["type"], begun["by"]) == ("carry", viewer.parts["hello"]["you"])
        wanted = {"mark": "A2", "type": "carry", "direction": "feeding"}
        version = viewer.parts["robot"]["version"]
        place = {"scene": "wooshmap", "map": "wooshmap", "version": version}
        assert {name: begun[name] for name in place} == place
        assert begun["command"] == {"name": "goMark", "args": {**wanted, **place}}
        done = await newest(viewer, id=begun["id"], state="completed", running=False)
        assert 0 < begun["begun"] == done["begun"] < done["changed"] <= time.time() * 1000
        await viewer.give("go", x=500.0, y=500.0, theta=0.0)
        failed = await newest(viewer, state="failed")
        await viewer.until(
            lambda parts: "navigation did not succeed" in parts["tasks"][0]["code"]["meaning"]
        )
        real_chassis.set_emergency_stop(True)
        await viewer.until(is_emergency_stopped)
        assert not (await viewer.command("goMark", mark="A2"))[0]
        assert viewer.parts["tasks"][0]["id"] == failed["id"]  # a refused one is no task
        async with page(running) as later:
            assert (await newest(later))["changed"] == failed["changed"]


async def test_what_became_of_a_task_while_the_link_was_lost(
    real_chassis: SimulatorThread,
) -> None:
    async with controlled(real_chassis) as viewer:
        await viewer.give("goMark", mark="A2")
        await newest(viewer, state="executing")
        real_chassis.stop_listening()
        await viewer.until(lambda parts: not parts["link"]["good"])
        await eventually(
            lambda: real_chassis.call(lambda simulator: simulator.chassis.tasks.history)
        )
        real_chassis.listen()
        await newest(viewer, to="A2", state="completed")


async def test_a_lost_link_leaves_in_the_list_what_the_page_knows_of_a_task(
    real_chassis: SimulatorThread,
) -> None:
    ended = [TaskProc(robot_task_id=each, state=task.kCompleted) for each in range(1, 51)]
    real_chassis.call(lambda simulator: simulator.chassis.tasks.history.extend(ended))
    async with controlled(real_chassis) as viewer:
        await viewer.give("goMark", mark="A2")
        given = await newest(viewer, state="executing")
        real_chassis.stop_listening()
        await viewer.until(lambda parts: not parts["link"]["good"])
        real_chassis.listen()
        await viewer.until(lambda parts: parts["link"]["good"])
        later = await newest(viewer, id=given["id"])
        assert [later[name] for name in ("by", "command")] == [given["by"], given["command"]]


async def test_a_task_whose_end_was_not_seen(chassis: SimulatorThread) -> None:
    async with controlled(chassis) as viewer:
        await viewer.give("goMark", mark="A2")
        known = await newest(viewer, state="executing")
        chassis.push(TaskProc(robot_task_id=17, state=task.kExecuting))

        def ended(parts: dict[str, Any]) -> Any:
            found = (each for each in parts["tasks"] if each["id"] == known["id"])
            return next((each for each in found if each["state"] == "unseen"), None)

        assert (await viewer.until(ended))["type"] == known["type"] == "pick"


@pytest.mark.parametrize(
    ("end", "begins"), [(task.kCompleted, True), (task.kCanceled, True), (task.kFailed, False)]
)
async def test_a_task_whose_id_comes_again_begins_anew(
    chassis: SimulatorThread, end: task.State, begins: bool
) -> None:
    """Sets repeat the ids of their tasks. A task that failed may be retried."""
    async with controlled(chassis) as viewer:
        chassis.push(TaskProc(robot_task_id=66601, state=task.kExecuting))
        first = await newest(viewer, id="66601", running=True)
        chassis.push(TaskProc(robot_task_id=66601, state=end))
        ended = await newest(viewer, running=False)
        await eventually(lambda: time.time() * 1000.0 > ended["changed"] + 1)
        chassis.push(TaskProc(robot_task_id=66601, state=task.kExecuting))
        again = await newest(viewer, running=True)
        assert (again["begun"] > first["begun"]) == begins

        def tell_both(info: RobotInfo) -> None:
            info.task_proc.CopyFrom(TaskProc(robot_task_id=66601, state=task.kExecuting))
            info.task_history.tes.add(robot_task_id=66601, state=end)

        edit_bodies(chassis, RobotInfo, tell_both)
        chassis.stop_listening()
        await viewer.until(lambda parts: not parts["link"]["good"])
        chassis.listen()
        await viewer.until(lambda parts: parts["link"]["good"])
        same = await newest(viewer, running=True)
        # who has begun it is noted later
        assert (same["id"], same["begun"]) == (again["id"], again["begun"])


@pytest.mark.parametrize(
    ("doing", "shown"),
    [
        (action.kSuspend, "paused"),
        (action.kRosWarning, "held up"),  # an obstacle
        (action.kTraffiCtrl, "held up"),
    ],
)
async def test_a_task_that_drives_on_by_itself_is_not_paused(
    chassis: SimulatorThread, doing: action.State, shown: str
) -> None:
    async with controlled(chassis) as viewer:
        step = TaskProc.Action(type=action.kNav, state=doing)
        chassis.push(TaskProc(robot_task_id=17, state=task.kPaused, action=step))
        await newest(viewer, id="17", state=shown, running=True)
        await viewer.until(lambda parts: parts["robot"]["task"]["state"] == shown)


async def test_tasks_of_others_and_of_earlier_are_in_the_list(
    real_chassis: SimulatorThread,
) -> None:
    config = LinkConfig("127.0.0.1", real_chassis.port)
    async with ChassisClient(config=config) as client:
        await client.request(ExecTask(task_id=7, type=task.kPick, mark_no="A2"))
        await eventually(
            lambda: real_chassis.call(lambda simulator: simulator.chassis.tasks.history)
        )
        async with dashboard(real_chassis) as running, page(running) as viewer:
            await newest(viewer, id="7", to="A2", state="completed", by="", command={})
            await client.request(ExecTask(task_id=8, type=task.kParking, mark_no="P1"))
            await newest(viewer, id="8", type="parking", running=True, by="another client")


@pytest.mark.parametrize("by", ["page", "other"])
async def test_where_a_task_to_a_place_goes(chassis: SimulatorThread, by: str) -> None:
    async with controlled(chassis) as viewer:
        if by == "page":
            await viewer.give("go", x=1.0, y=-6.0, theta=0.0)
        else:
            config = LinkConfig("127.0.0.1", chassis.port)
            async with ChassisClient(config=config) as client:
                pose = Pose2D(x=1.0, y=-6.0)
                await client.request(ExecTask(task_id=7, type=task.kPick, pose=pose))
        task_ = await viewer.until(
            lambda parts: (
                parts["tasks"][0]["place"] and parts["tasks"][0]["running"] and parts["tasks"][0]
            )
        )
        assert (task_["to"], task_["place"]) == ("", pytest.approx([1.0, -6.0], abs=0.1))
        place = await viewer.until(lambda parts: parts["fleet"][0]["task"]["place"])
        assert place == task_["place"]


async def test_the_answer_to_a_task_that_the_log_has_already_removed_is_ignored() -> None:
    def driver() -> Driver:
        raise AssertionError("no task of another program is reported")

    log = TaskLog(Robot(LinkConfig("127.0.0.1"), Parts(), control=True, scan_rate=1.0), driver)
    for task_id in range(1, 102):
        log.given(task_id, "1 (127.0.0.1)", "charge", {})
    log.answered(1, True)
    assert log.running() is None
    log.answered(101, True)
