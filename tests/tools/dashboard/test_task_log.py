"""The log of a robot's tasks, without a link."""

from __future__ import annotations

from tests.tools.waiting import aio
from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.robot.who_drives import Driver
from woosh_robot_agent.tools.dashboard.parts import Parts
from woosh_robot_agent.tools.dashboard.robot import Robot
from woosh_robot_agent.tools.dashboard.tasks import TaskLog


def _driver() -> Driver:
    raise AssertionError("no task of another program is reported")


@aio
async def test_the_answer_to_a_task_that_the_log_has_already_removed_is_ignored() -> None:
    log = TaskLog(Robot(LinkConfig("127.0.0.1"), Parts(), control=True, scan_rate=1.0), _driver)
    for task_id in range(1, 52):
        log.given(task_id, "1 (127.0.0.1)", "charge", {})
    log.answered(1, True)
    assert log.running() is None
    log.answered(51, True)
