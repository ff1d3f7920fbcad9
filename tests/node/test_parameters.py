"""Parameters: descriptions, refused values and their reasons, and effects of changes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from rcl_interfaces.msg import Parameter as ParameterMsg
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.parameter import Parameter

from tests.harness import Client, Logs, Robot, RunningAgent, wait_until
from tests.quick_chassis import quick_config
from woosh_robot_agent.parameters import PARAMETERS, check_names
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_msgs.srv import Mode, Speak

MODE = "woosh.robot.Mode"
ROBOT_INFO = "woosh.robot.RobotInfo"
DEFAULTS = {  # test_process.py has that of ip, and test_link_config.py that of port
    "transport": "websocket",
    "encoding": "json",
    "poll_timeout": 10000,
    "robot_id": 0,
    "goal_link_timeout": 15.0,
    "result_timeout": 60,
}


def messages(values: dict[str, Any]) -> list[ParameterMsg]:
    return [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]


def change(client: Client, **values: Any) -> tuple[bool, str]:
    """Set several parameters at once; return success and reason."""
    response = client.call(
        SetParametersAtomically, "agent/set_parameters_atomically", parameters=messages(values)
    )
    return response.result.successful, response.result.reason


def value(client: Client, name: str) -> Any:
    (found,) = client.call(GetParameters, "agent/get_parameters", names=[name]).values
    return Parameter.from_parameter_msg(ParameterMsg(name=name, value=found)).value


@pytest.fixture
def unconnected(start_agent: Callable[..., RunningAgent]) -> RunningAgent:
    return start_agent(ip="127.0.0.1", port=1)


@pytest.mark.usefixtures("unconnected")
def test_each_parameter_is_described_with_its_range(client: Client) -> None:
    names = [parameter.name for parameter in PARAMETERS]
    for name, default in DEFAULTS.items():
        assert value(client, name) == default
    listed = client.call(ListParameters, "agent/list_parameters").result.names
    assert set(names) <= set(listed)
    described = client.call(DescribeParameters, "agent/describe_parameters", names=names)
    for parameter, descriptor in zip(PARAMETERS, described.descriptors, strict=True):
        assert descriptor.description
        ranges = [*descriptor.integer_range, *descriptor.floating_point_range]
        assert len(ranges) == (type(parameter.default) in (int, float))


BAD = [
    ({"port": 65536}, "port"),
    ({"port": -1}, "port"),
    ({"port": "5480"}, "type"),
    ({"ip": ""}, "ip"),
    ({"ip": "a b"}, "ip"),
    ({"ip": "http://robot/"}, "ip"),
    ({"transport": "udp"}, "transport"),
    ({"encoding": "xml"}, "encoding"),
    ({"poll_timeout": 0}, "poll_timeout"),
    ({"poll_timeout": 1.5}, "type"),
    ({"robot_id": 2**32}, "robot_id"),
    ({"goal_link_timeout": -1.0}, "goal_link_timeout"),
    ({"goal_link_timeout": float("nan")}, "goal_link_timeout"),
    ({"goal_link_timeout": float("inf")}, "goal_link_timeout"),
    ({"goal_link_timeout": "long"}, "goal_link_timeout"),
    ({"goal_link_timeout": True}, "goal_link_timeout"),
    ({"max_frame_size": 0}, "max_frame_size"),
    ({"result_timeout": 5}, "read-only"),
]


@pytest.mark.usefixtures("unconnected")
def test_bad_value_is_refused_with_the_reason(client: Client) -> None:
    for values, reason in BAD:
        before = {name: value(client, name) for name in values}
        successful, told = change(client, **values)
        assert not successful, values
        assert reason in told, values
        assert {name: value(client, name) for name in values} == before


@pytest.mark.parametrize(
    ("parameter", "reason"),
    [
        ({"ip": "a b"}, "ip"),
        ({"encoding": "xml"}, "encoding"),
        ({"disabled_parts": ["scan", "gripper"]}, "no part 'gripper'; the parts are battery_state"),
        (
            {"enable_scan": False},
            r'no parameter enable_scan: list it in disabled_parts: \["scan"\]',
        ),
        ({"executor": "events"}, "no parameter executor: the agent has one executor"),
    ],
)
def test_bad_value_at_the_start_is_refused(
    start_agent: Callable[..., RunningAgent], parameter: dict[str, Any], reason: str
) -> None:
    with pytest.raises(ValueError, match=reason):
        start_agent(**parameter)


def test_misspelt_parameters_are_named() -> None:
    (misspelt,) = check_names(["publish_tff", "other_rate", "publish_tf"])
    assert misspelt.startswith("there is no parameter publish_tff")
    assert misspelt.endswith("did you mean publish_tf?")


def test_change_of_the_address_reconnects(robot: Robot) -> None:
    with SimulatorThread(quick_config(port=0, tcp_port=0, seed=1)) as other:
        assert change(robot, port=other.tcp_port, transport="tcp") == (True, "")
        other.wait_received(ROBOT_INFO)
        wait_until(lambda: robot.chassis.connections == 0)
        robot.agent.wait_connected()
        robot.call(Mode, "robot/Mode")
        assert (other.counts[MODE], robot.chassis.counts[MODE]) == (1, 0)


def test_only_changes_of_the_link_reconnect(robot: Robot) -> None:
    assert change(robot, poll_timeout=200, goal_link_timeout=1) == (True, ""), "an integer, too"
    assert change(robot, port=robot.chassis.port) == (True, ""), "the same as before"
    robot.chassis.mute("woosh.robot.Speak")
    assert "within 0.2 s" in robot.call(Speak, "robot/Speak").msg, "it counts at once"
    assert robot.chassis.counts[ROBOT_INFO] == 1
    assert change(robot, poll_timeout=10_000) == (True, "")
    for links, changed in ((2, {"ip": "localhost"}), (3, {"robot_id": 5})):
        assert change(robot, **changed) == (True, "")
        robot.agent.wait_connected(links)
        robot.call(Mode, "robot/Mode")
        for name in (ROBOT_INFO, MODE):
            assert robot.chassis.last(name).robot_id == changed.get("robot_id", 0)


def test_several_changes_at_once_are_checked_one_by_one(robot: Robot) -> None:
    """ROS tools set parameters one by one, so each change must be valid on its own."""
    response = robot.call(
        SetParameters,
        "agent/set_parameters",
        parameters=messages({"robot_id": 7, "encoding": "xml", "poll_timeout": 2000}),
    )
    assert [result.successful for result in response.results] == [True, False, True]
    assert "encoding" in response.results[1].reason
    robot.agent.wait_connected()
    assert robot.agent.agent.settings.link.request_timeout == 2.0
    assert robot.agent.agent.settings.link.robot_id == 7
    assert robot.agent.agent.settings.link.encoding == "json"


def test_a_change_that_is_taken_back_while_the_robot_is_stopped_has_no_effect(
    robot: Robot, logs: Logs
) -> None:
    """The link changes only after the robot was stopped, or has not answered the stop."""
    assert robot.command("robot/Twist", linear=0.3).ok
    robot.chassis.mute("woosh.robot.Twist")
    before = robot.chassis.counts["woosh.robot.Twist"]
    for port in (1, robot.chassis.port):
        robot.call(SetParameters, "agent/set_parameters", parameters=messages({"port": port}))
        wait_until(lambda: robot.chassis.counts["woosh.robot.Twist"] > before, "the stop begins")
    logs.wait_text("the robot was not stopped")
    wait_until(lambda: robot.agent.agent.debug()["state"] == "ready", "the link")
    assert robot.link.config.port == robot.chassis.port
