"""The robots of the tests of several robots in one process."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rclpy
import yaml
from rclpy.context import Context

from tests.harness import Spinner, wait_until
from woosh_robot_agent.ros.executor import Executor
from woosh_robot_agent.ros.fleet import Fleet
from woosh_robot_agent.simulator import SimulatorThread

NAMES = ["/r1", "hall/r2"]
ROBOTS = ("/r1", "/woosh_robot/hall/r2")
"""Namespaces of the robots; the program is in /woosh_robot."""


def write_parameters(
    folder: Path, robots: Any, common: dict[str, Any], **own: dict[str, Any]
) -> Path:
    """Write a parameter file; the keys of `own` are namespaces."""
    tree: dict[str, Any] = {"/**": {"ros__parameters": {"robots": robots, **common}}}
    for name, values in own.items():
        tree[f"{name}/agent"] = {"ros__parameters": values}
    file = folder / "robots.yaml"
    file.write_text(yaml.safe_dump(tree, sort_keys=False))
    return file


def logger_of(namespace: str) -> str:
    """Return the name of an agent's logger."""
    return f"[{namespace.strip('/').replace('/', '.')}.agent"


@contextmanager
def running_fleet(folder: Path, chassis: dict[str, SimulatorThread]) -> Iterator[Fleet]:
    """The agents of all robots in this process."""
    own = {name: {"ip": "127.0.0.1", "port": each.port} for name, each in chassis.items()}
    with fleet_of_file(write_parameters(folder, list(ROBOTS), {}, **own)) as fleet:
        yield fleet


@contextmanager
def fleet_of_file(file: Path) -> Iterator[Fleet]:
    """The agents that a parameter file describes, in this process."""
    context = Context()
    rclpy.init(args=["--ros-args", "--params-file", str(file)], context=context)
    try:
        fleet = Fleet(context=context)
        executor = Executor(context=context)
        for agent in fleet.agents:
            executor.add_node(agent.node)
        spinner = Spinner(executor)
        try:
            for agent in fleet.agents:
                wait_until(
                    lambda agent=agent: agent.robot.chassis.state.value == "ready", "the link"
                )
            yield fleet
        finally:
            spinner.stop()
            fleet.close(lambda: executor.spin_once(timeout_sec=0.02))
    finally:
        rclpy.try_shutdown(context=context)
