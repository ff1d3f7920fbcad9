"""The documented commands in their order, on one robot as the simulator has it by default."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.harness import Client, wait_until
from tests.ros2_commands import Command, documented, parse
from woosh_robot_agent.simulator import SimulatorConfig, SimulatorThread
from woosh_robot_msgs.srv import RobotInfo

SUCCEEDED = 4
PAGE = Path(__file__).parents[2] / "docs" / "documented_commands.md"
CANCEL = (
    "ros2 service call /woosh_robot/robot/ActionOrder woosh_robot_msgs/srv/ActionOrder "
    '"{arg:{order:{value: 4}}}"'
)
"""The command by which the page lets line 63 work."""


@pytest.fixture
def simulator() -> Iterator[SimulatorThread]:
    with SimulatorThread(SimulatorConfig(port=0, tcp_port=0, speed=2.0, seed=1)) as running:
        yield running


def refusal(client: Client, command: Command) -> str:
    """Run a command, and return why it is refused; empty if it is not."""
    if command.verb == "topic echo":
        return ""
    filled = command.filled()
    if command.verb == "service call":
        fields = {"arg": filled.arg} if hasattr(filled, "arg") else {}
        answer = client.call(command.cls, command.name, **fields)
        return "" if getattr(answer, "ok", True) else str(answer.msg)
    status, ret = client.send_goal(command.cls, command.name, filled).result(60.0)
    return "" if status == SUCCEEDED else str(ret.msg)


def task_id(client: Client) -> int:
    return int(client.call(RobotInfo, "robot/RobotInfo").info.task_proc.robot_task_id)


def test_lines_that_the_running_task_forbids_are_those_that_the_page_names(
    simulator, agent, client
):
    commands = documented()
    refused: dict[int, str] = {}
    for number, command in enumerate(commands, start=1):
        if reason := refusal(client, command):
            refused[number] = reason
    assert set(refused) == {46, 63}
    assert all("Task is excuting" in reason for reason in refused.values())
    page = PAGE.read_text()
    assert "lines 46 and 63" in page
    assert CANCEL in page
    assert refusal(client, parse(CANCEL)) == ""
    wait_until(lambda: not task_id(client), "the end of the task")
    assert refusal(client, commands[63 - 1]) == ""
