"""Several robots in one process: the agents do not affect each other."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import rclpy
from geometry_msgs.msg import PoseStamped
from rcl_interfaces.srv import GetParameters
from rclpy.context import Context

from tests.harness import TIMEOUT, Client, Program, wait_until
from tests.node.fleet.robots import NAMES, ROBOTS, logger_of, running_fleet, write_parameters
from tests.node.goals import EXECUTING, SUCCEEDED, slow_down, stop_time, task
from tests.node.test_process import TWIST, drive
from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.ros.fleet import Fleet
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.testing.agents import domain_variables
from woosh_robot_msgs.msg import PoseSpeed
from woosh_robot_msgs.srv import Speak

SPEAK = "woosh.robot.Speak"

NO_TIMEOUT = """<?xml version="1.0" encoding="UTF-8"?>
<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <participant profile_name="agent" is_default_profile="true">
    <rtps><builtin><discovery_config>
      <leaseDuration><sec>3600</sec></leaseDuration>
    </discovery_config></builtin></rtps>
  </participant>
</profiles>
"""
"""Profile of Fast DDS: others believe for an hour that a process exists that has vanished."""


def test_each_agent_has_its_own_chassis_frames_and_parameters_and_ends_with_the_others(
    fleet: Program,
    chassis: dict[str, SimulatorThread],
    clients: dict[str, Client],
) -> None:
    poses = {name: client.echo(PoseSpeed, "robot/PoseSpeed") for name, client in clients.items()}
    found = {}
    for name, client in clients.items():
        assert client.call(Speak, "robot/Speak").ok
        assert chassis[name].counts[SPEAK] == 1
        drive(client, 0.1)
        poses[name].wait(lambda message: message.twist.linear > 0)
        drive(client, 0.0)
        assert chassis[name].counts[TWIST] == 2, name
        values = client.call(
            GetParameters, "agent/get_parameters", names=["frame_prefix", "robots"]
        ).values
        found[name] = (values[0].string_value, list(values[1].string_array_value))
    assert found == {ROBOTS[0]: ("r1/", NAMES), ROBOTS[1]: ("hall/r2/", NAMES)}
    wanted = {f"{name}/agent" for name in ROBOTS}
    # DDS shows a killed process of an earlier test in this domain for 20 s
    wait_until(lambda: _agents(clients["/r1"]) == wanted, "the names of the nodes", timeout=30.0)
    for name, simulator in chassis.items():
        lines = [line for line in fleet.lines if f":{simulator.port}" in line]
        assert len(lines) == 1, lines
        assert logger_of(name) in lines[0]
    # a signal ends both
    at_work, driven = ROBOTS
    slow_down(chassis[at_work])
    goal = task(clients[at_work], mark="A23")
    goal.feedback.wait(lambda fb: fb.state.value == EXECUTING)
    stop_time(chassis[at_work])
    drive(clients[driven])
    fleet.end()
    assert not chassis[driven].last(TWIST).ListFields(), "it is stopped"
    assert chassis[at_work].counts[TWIST] == 2, "it stood"
    goal.wait_aborted("stopping")
    assert chassis[at_work].call(lambda sim: sim.chassis.tasks.active), "the task is the robot's"
    wait_until(lambda: not any(simulator.connections for simulator in chassis.values()))


def _agents(client: Client) -> set[str]:
    nodes = client.node.get_node_names_and_namespaces()
    return {f"{space}/{name}" for name, space in nodes if name == "agent"}


def test_what_happens_to_one_robot_affects_no_other(
    tmp_path: Path,
    chassis: dict[str, SimulatorThread],
    clients: dict[str, Client],
    capfd: pytest.CaptureFixture[str],
) -> None:
    one, other = ROBOTS
    said = ""

    def lines(*texts: str) -> list[str]:
        """Return the lines logged so far that have one of these texts."""
        nonlocal said
        said += capfd.readouterr().err
        return [line for line in said.splitlines() if any(text in line for text in texts)]

    with running_fleet(tmp_path, chassis):
        # calls without an answer
        chassis[one].mute(SPEAK)
        waiting = [clients[one].call_async(Speak, "robot/Speak") for _ in range(200)]
        for _ in range(10):
            assert clients[other].call(Speak, "robot/Speak").ok
        limit = LinkConfig().max_in_flight
        chassis[one].wait_received(SPEAK, limit)
        wait_until(lambda: sum(not each.done() for each in waiting) == limit)
        # a lost link
        goal = task(clients[other])
        goal.feedback.wait(lambda fb: fb.state.value == EXECUTING)
        chassis[one].stop()
        wait_until(lambda: not clients[one].call(Speak, "robot/Speak").ok)
        assert clients[other].call(Speak, "robot/Speak").ok
        assert goal.result()[0] == SUCCEEDED
        # logged once, with the name of the affected robot
        told = wait_until(lambda: lines("cannot connect", "lost the link"))
        assert all(logger_of(one) in line for line in told), told
        assert len(set(told)) == len(told)
        # a goal pose outside of the map
        message = PoseStamped()
        message.header.frame_id = "woosh_robot/hall/r2/map"
        message.pose.position.x = 500.0
        message.pose.orientation.w = 1.0
        clients[other].publisher(PoseStamped, "goal_pose").publish(message)
        (line,) = wait_until(lambda: lines("goal_pose was not reached"))
        assert logger_of(other) in line


def test_an_error_is_logged_by_the_robot_that_has_it(
    tmp_path: Path,
    chassis: dict[str, SimulatorThread],
    clients: dict[str, Client],
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """Errors in the executor thread and in the link thread are both attributed."""
    with running_fleet(tmp_path, chassis) as fleet:
        failing, other = ROBOTS
        agent, second = fleet.agents

        def fail(*_arguments: Any) -> None:
            raise ZeroDivisionError

        monkeypatch.setattr(agent.robot.requests, "make", fail)
        send = second.robot.chassis.send

        def fail_to_speak(message: Any, *rest: Any, **named: Any) -> Any:
            is_it = type(message).__name__ == "Speak"
            return fail() if is_it else send(message, *rest, **named)

        monkeypatch.setattr(second.robot.chassis, "send", fail_to_speak)
        assert "ZeroDivisionError" in clients[failing].call(Speak, "robot/Speak").msg
        assert "ZeroDivisionError" in clients[other].call(Speak, "robot/Speak").msg
        told = capfd.readouterr().err.splitlines()
    for name, text in ((failing, "a service callback failed"), (other, "a background task failed")):
        lines = [each for each in told if text in each]
        assert len(lines) == 1, "\n".join(told)
        assert logger_of(name) in lines[0]


def test_a_failing_shutdown_of_one_robot_still_stops_the_others(
    tmp_path: Path,
    chassis: dict[str, SimulatorThread],
    clients: dict[str, Client],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with running_fleet(tmp_path, chassis) as fleet:
        for client in clients.values():
            drive(client)

        async def fail(_timeout: float) -> None:
            raise ZeroDivisionError

        monkeypatch.setattr(fleet.agents[0].robot.gate, "close", fail)
    assert not chassis[ROBOTS[1]].last(TWIST).ListFields()
    wait_until(lambda: not any(simulator.connections for simulator in chassis.values()))


def test_program_runs_without_standard_streams(
    domain: int, chassis: dict[str, SimulatorThread], tmp_path: Path
) -> None:
    own = {name: {"ip": "127.0.0.1", "port": each.port} for name, each in chassis.items()}
    file = write_parameters(tmp_path, list(ROBOTS), {}, **own)
    command = [sys.executable, "-m", "woosh_robot_agent.agent", "--ros-args"]
    program = subprocess.Popen(
        ["bash", "-c", 'exec "$@" <&- >&- 2>&-', "bash", *command, "--params-file", str(file)],
        env={**os.environ, **domain_variables(domain)},
    )
    wait_until(
        lambda: all(each.connections for each in chassis.values()) or program.poll() is not None
    )
    program.send_signal(signal.SIGINT)
    assert program.wait(TIMEOUT) == 0
    assert not any(each.bad_frames for each in chassis.values())


def test_a_signal_during_the_start_ends_it(
    domain: int, chassis: dict[str, SimulatorThread], tmp_path: Path
) -> None:
    own = {name: {"ip": "127.0.0.1", "port": each.port} for name, each in chassis.items()}
    file = write_parameters(tmp_path, list(ROBOTS), {}, **own)
    context = Context()
    rclpy.init(args=["--ros-args", "--params-file", str(file)], context=context, domain_id=domain)
    signals = iter([False, True])  # none while the nodes are created
    fleet = Fleet(lambda: next(signals), context=context)
    assert [agent.node.get_namespace() for agent in fleet.agents] == [ROBOTS[0]]
    fleet.close(lambda: None)
    rclpy.shutdown(context=context)
    assert not chassis[ROBOTS[1]].received


def test_with_a_frozen_chassis_the_other_is_stopped_and_all_endpoints_are_withdrawn(
    start_fleet: Callable[..., Program],
    chassis: dict[str, SimulatorThread],
    clients: dict[str, Client],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The program exits without destroying them, so others must not depend on a timeout."""
    profile = tmp_path / "no_timeout.xml"
    profile.write_text(NO_TIMEOUT)
    for variable in ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"):
        monkeypatch.setenv(variable, str(profile))
    fleet = start_fleet(frame_prefix="same/")
    said = [line for line in fleet.lines if "frame_prefix" in line]
    assert len(said) == 1, "a warning of colliding frames"
    assert logger_of(ROBOTS[1]) in said[0]
    for client in clients.values():
        drive(client)
    frozen, other = ROBOTS
    chassis[frozen].inject("half_open")
    fleet.end()
    assert not chassis[other].last(TWIST).ListFields()
    node = clients[frozen].node
    wait_until(
        lambda: not set(ROBOTS) & {names[1] for names in node.get_node_names_and_namespaces()}
    )
    wait_until(lambda: not node.get_publishers_info_by_topic(f"{ROBOTS[0]}/robot/PoseSpeed"))
