"""robot/AgentInfo: whether the agent has a link to the chassis."""

from __future__ import annotations

from collections.abc import Callable

from tests.harness import Client, Robot, RunningAgent
from woosh_robot_msgs.msg import AgentInfo

NAME = "robot/AgentInfo"


def test_it_is_false_before_the_first_link(
    start_agent: Callable[..., RunningAgent], client: Client
) -> None:
    start_agent(ip="127.0.0.1", port=1, disabled_parts=["connected"])
    assert [m.online for m in client.echo(AgentInfo, NAME).wait_count(1)] == [False]


def test_it_follows_the_link_and_late_subscribers_get_it(robot: Robot) -> None:
    early = robot.echo(AgentInfo, NAME)
    early.wait(lambda m: m.online)
    robot.chassis.stop_listening()
    robot.chassis.drop()
    early.wait(lambda m: not m.online)
    assert not robot.echo(AgentInfo, NAME).wait_count(1)[0].online
    robot.chassis.listen()
    robot.agent.wait_connected(2)
    early.wait_count(3)
    assert [m.online for m in early.messages][-3:] == [True, False, True]


def test_it_is_false_when_the_agent_ends(robot: Robot) -> None:
    echo = robot.echo(AgentInfo, NAME)
    echo.wait(lambda m: m.online)
    robot.agent.close()
    echo.wait(lambda m: not m.online)
