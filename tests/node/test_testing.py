"""`woosh_robot_agent.testing`: the documented example, the fixtures and the context managers."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy

from woosh_robot_agent.ros.releases import this_computer_only
from woosh_robot_agent.testing import (
    own_domain,
    running_agent,
    running_chassis,
    spinning,
    wait_until,
)
from woosh_robot_msgs.srv import PoseSpeed

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
EXAMPLES = [
    DOCS / "examples" / name
    for name in ("conftest.py", "park_when_low.py", "test_park_when_low.py")
]


def run_pytest(folder: Path, *arguments: str) -> tuple[int, str]:
    """Run pytest outside this repository, as users do; return its exit status and output."""
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "--strict-markers", "--strict-config", *arguments],
        cwd=folder,
        env={**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTEST_ADDOPTS": ""},
        capture_output=True,
        text=True,
        timeout=100,
    )
    return done.returncode, done.stdout + done.stderr


MARKED = """
import pytest
pytestmark = pytest.mark.woosh_chassis(speed=3, robot_id=7)

@pytest.mark.woosh_chassis(speed=4)
@pytest.mark.woosh_agent(process=True, namespace="/r7", poll_timeout=1234)
def test_it(ros_domain, woosh_agent, simulated_chassis):
    assert simulated_chassis.call(lambda simulator: simulator.speed) == 4
    assert simulated_chassis.state.info.robot_id == 7
    assert woosh_agent.domain == ros_domain
    assert woosh_agent.namespace == "/r7"
    assert woosh_agent.process.args[-1] == "poll_timeout:=1234"

@pytest.mark.woosh_chassis(4)
def test_positional(simulated_chassis):
    pass
"""
"""Tests whose marks configure the fixtures; the second one is wrong."""


def test_the_documented_example_passes_and_marks_configure_the_fixtures(tmp_path: Path) -> None:
    """In one run of pytest, because each takes long."""
    for file in EXAMPLES:
        shutil.copy(file, tmp_path)
    (tmp_path / "test_marked.py").write_text(MARKED)
    with (tmp_path / "conftest.py").open("a") as conftest:
        conftest.write("from woosh_robot_agent.testing import *\n")
    status, said = run_pytest(tmp_path)
    assert status == 1, said
    assert "4 passed, 1 error" in said
    assert "warning" not in said
    assert "woosh_chassis takes keyword arguments only: (4,)" in said


@pytest.mark.parametrize("file", [EXAMPLES[0], EXAMPLES[2]], ids=lambda file: str(file.name))
def test_the_docs_show_the_example_unchanged(file: Path) -> None:
    assert f"```python\n{file.read_text()}```" in (DOCS / "testing.md").read_text()


@contextlib.contextmanager
def ros_node() -> Iterator[Any]:
    rclpy.init()
    try:
        yield rclpy.create_node("visitor")
    finally:
        rclpy.shutdown()


def test_a_node_of_the_test_can_call_the_agent_which_connects_again() -> None:
    """The documented example has an agent in the process of the test."""
    with (
        running_chassis() as chassis,
        running_agent(chassis, process=True) as agent,
        ros_node() as node,
    ):
        client = node.create_client(PoseSpeed, f"{agent.namespace}/robot/PoseSpeed")
        wait_until(client.service_is_ready, "the service")

        def ask() -> Any:
            """Return the response; None if the agent, which did not know the client, dropped it."""
            answer = client.call_async(PoseSpeed.Request())
            with contextlib.suppress(AssertionError):
                wait_until(answer.done, timeout=2.0)
            return answer.result() if answer.done() else None

        with spinning(node):
            response = wait_until(ask, "the answer")
        assert response.info.pose.x == pytest.approx(4.23, abs=0.1)
        chassis.drop()
        agent.wait_connected(2)


@pytest.mark.parametrize("process", [False, True])
def test_the_error_of_an_agent_that_cannot_start_reaches_the_test(process: bool) -> None:
    with (
        running_chassis() as chassis,
        pytest.raises((ValueError, AssertionError), match="encoding"),
        running_agent(chassis, process=process, encoding="xml"),
    ):
        pass


def test_two_robots_can_share_a_domain() -> None:
    """One of them connects over TCP. Chassis answer without delay by default."""
    with (
        own_domain() as domain,
        running_chassis(robot_id=1) as one,
        running_chassis(robot_id=2, profile="tr200") as two,
        running_agent(one, domain=domain, namespace="/one", transport="tcp"),
        running_agent(two, domain=domain, namespace="/two"),
    ):
        assert (one.connections, two.connections) == (1, 1)
        profiles = [each.call(lambda inner: inner.chassis.profile.name) for each in (one, two)]
        assert profiles == ["instant", "tr200"]


def test_domains_differ_and_the_environment_is_restored(monkeypatch: Any) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "77")
    ((variable, value),) = this_computer_only().items()
    monkeypatch.delenv(variable, raising=False)
    with own_domain() as one, own_domain() as two:
        assert one != two
        assert os.environ["ROS_DOMAIN_ID"] == str(two)
        assert os.environ[variable] == value
    assert os.environ["ROS_DOMAIN_ID"] == "77"
    assert variable not in os.environ


def test_an_agent_that_a_killed_test_leaves_behind_keeps_its_domain(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "sleeper.py").write_text("import time; time.sleep(600)")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    script = """
import os
from woosh_robot_agent.testing import agents
class Agent(agents.AgentProcess):
    module = "sleeper"
with agents.own_domain() as domain:
    agent = Agent(domain)
    print(agents._LOCK_PORT + domain, agent.process.pid, flush=True)
    os._exit(1)
"""
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE) as killed:
        assert killed.stdout is not None  # not read to its end: the agent has it too
        port, process = map(int, killed.stdout.readline().split())
    try:
        with socket.socket() as lock, pytest.raises(OSError):
            lock.bind(("127.0.0.1", port))
    finally:
        os.kill(process, signal.SIGKILL)


def test_the_exception_of_a_callback_reaches_the_test() -> None:
    called = []

    def fail() -> None:
        called.append(True)
        raise ZeroDivisionError

    with own_domain(), ros_node() as node:
        node.create_timer(0.01, fail)
        with pytest.raises(ZeroDivisionError), spinning(node):
            wait_until(lambda: called, "the timer")


def test_the_chassis_fixture_works_without_ros(tmp_path: Path) -> None:
    (tmp_path / "conftest.py").write_text(
        "import sys\n"
        "sys.modules['rclpy'] = None\n"  # an import of it fails
        "from woosh_robot_agent.testing import pytest_configure, simulated_chassis\n"
    )
    (tmp_path / "test_it.py").write_text(
        "import pytest\n"
        "from websockets.sync.client import connect\n"
        "from woosh_robot_agent.testing import running_chassis, wait_until\n"
        "@pytest.mark.woosh_chassis(robot_id=7)\n"
        "def test_it(simulated_chassis):\n"
        "    with connect(f'ws://127.0.0.1:{simulated_chassis.port}'):\n"
        "        wait_until(lambda: simulated_chassis.connections)\n"
        "    assert simulated_chassis.state.info.robot_id == 7\n"
        "    with running_chassis(), pytest.raises(ImportError):\n"
        "        from woosh_robot_agent.testing import running_agent\n"
    )
    status, said = run_pytest(tmp_path)
    assert status == 0, said
