"""The list of robots, and the parameters of each of them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import rclpy
from rclpy.context import Context
from rclpy.exceptions import ParameterException

from tests.harness import NAMESPACE
from tests.node.fleet.robots import fleet_of_file, write_parameters
from woosh_robot_agent.ros.fleet import Fleet, namespaces
from woosh_robot_agent.ros.releases import error_text
from woosh_robot_agent.simulator import SimulatorThread

A, B = ({"ip": "127.0.0.1", "port": port} for port in (1, 2))


@contextmanager
def parameter_file(folder: Path, domain: int, robots: Any, *args: Any, **own: Any) -> Iterator[Any]:
    """A context whose nodes get their parameters from a file; see `write_parameters`."""
    file = write_parameters(folder, robots, *args, **own)
    context = Context()
    arguments = ["--ros-args", "-r", f"__ns:={NAMESPACE}", "--params-file", str(file)]
    rclpy.init(args=arguments, context=context, domain_id=domain)
    try:
        yield context
    finally:
        rclpy.try_shutdown(context=context)


@pytest.mark.parametrize(
    ("robots", "common", "own", "complaints"),
    [
        (["/a", "/b"], {}, {"/a": A}, ["/b", "ip", "/b/agent"]),
        (["/a", "/b"], {"ip": "127.0.0.1"}, {}, ["/a and /b", "127.0.0.1", "ip or port"]),
        (["/a", "/b"], A, {"/a": {"robot_id": 1}, "/b": {"robot_id": 2}}, ["its own ip or port"]),
        (["/a", "/b"], {}, {"/a": A, "/b": {**B, "ip": "a b"}}, ["/b", "ip", "a b"]),
        (["/a", "/b"], {}, {"/a": A, "/b": {**B, "port": "x"}}, ["/b", "port"]),
        (["a", "/woosh_robot/a"], {}, {"/woosh_robot/a": A}, ["/woosh_robot/a", "its own name"]),
        (["/a", "/b c"], {}, {"/a": A}, ["b c", "robots"]),
        (["/a", ""], {}, {"/a": A}, ["''", "robots"]),
        ([1, 2], {}, {}, ["robots"]),
    ],
)
def test_an_invalid_list_is_refused(
    domain: int,
    tmp_path: Path,
    robots: Any,
    common: dict[str, Any],
    own: dict[str, Any],
    complaints: list[str],
) -> None:
    with (
        parameter_file(tmp_path, domain, robots, common, **own) as context,
        pytest.raises((ValueError, ParameterException)) as caught,
    ):
        Fleet(context=context)
    said = error_text(caught.value)
    for complaint in complaints:
        assert complaint in said


def test_an_empty_list_means_one_robot(domain: int, tmp_path: Path) -> None:
    """ROS takes no empty list from a file, so the list has one empty name."""
    with parameter_file(tmp_path, domain, [""], A) as context:
        fleet = Fleet(context=context)
        assert [agent.node.get_namespace() for agent in fleet.agents] == [NAMESPACE]
        fleet.close(lambda: None)


def test_robot_names_may_be_relative_or_absolute() -> None:
    assert namespaces(["a", "b/c", "/d"], "/") == {"a": "/a", "b/c": "/b/c", "/d": "/d"}
    assert namespaces(["a", "/d"], "/hall") == {"a": "/hall/a", "/d": "/d"}


@pytest.mark.usefixtures("domain")
def test_the_example_file_works(tmp_path: Path, chassis: dict[str, SimulatorThread]) -> None:
    """config/robots.yaml, with the ports of the chassis."""
    text = (Path(__file__).parents[3] / "config/robots.yaml").read_text()
    for wanted, each in zip(("5480", "5490"), chassis.values(), strict=True):
        text, found = re.subn(rf"\bport: {wanted}\b", f"port: {each.port}", text)
        assert found == 1
    file = tmp_path / "robots.yaml"
    file.write_text(text)
    with fleet_of_file(file) as fleet:
        assert [agent.node.get_namespace() for agent in fleet.agents] == ["/r1", "/r2"]
        assert [each.connections for each in chassis.values()] == [1, 1]
