"""The monitor over ROS: what it shows is what the simulated chassis says to the agent."""

from __future__ import annotations

import asyncio
import math
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from tests.harness import NAMESPACE, wait_until
from tests.node.goals import SUCCEEDED, step
from woosh_robot_agent.pb.robot.robot_pb2 import Battery, Mode, PoseSpeed
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.pb.util.common_pb2 import Pose2D
from woosh_robot_agent.tools import ros_source
from woosh_robot_agent.tools.ros_source import RosSource
from woosh_robot_agent.tools.screen import draw
from woosh_robot_agent.tools.view import LinkReport, View

TIMEOUT = 60.0
PROGRAM = [sys.executable, "-m", "woosh_robot_agent.tools.monitor"]


class Watching:
    """The monitor's source in an event loop of its own, looked at from a test."""

    def __init__(self, domain: int, namespace: str = NAMESPACE) -> None:
        import threading

        self.source = RosSource(namespace, domain=domain)
        self.loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self.loop.run_forever, daemon=True)
        self._thread.start()
        self.run(self.source.start())

    def run(self, work: Any) -> Any:
        return asyncio.run_coroutine_threadsafe(work, self.loop).result(TIMEOUT)

    def ask(self, question: Callable[[View], Any]) -> Any:
        async def answer() -> Any:
            return question(self.source.view)

        return self.run(answer())

    def wait(self, condition: Callable[[View], Any], what: str = "") -> Any:
        return wait_until(lambda: self.ask(condition), what, TIMEOUT)

    def wait_link(self, condition: Callable[[LinkReport], Any]) -> LinkReport:
        wait_until(lambda: condition(self.source.link()), "the link's state", TIMEOUT)
        return self.source.link()

    def close(self) -> None:
        self.run(self.source.close())
        self.loop.call_soon_threadsafe(self.loop.stop)
        self._thread.join(TIMEOUT)
        self.loop.close()


@pytest.fixture
def watching(domain: int) -> Iterator[Watching]:
    running = Watching(domain)
    yield running
    running.close()


def test_first_values_and_changes(watching, agent, simulator):
    watching.wait(lambda view: view.complete, "RobotInfo")
    truth = simulator.state.info
    shown = watching.ask(lambda view: (view.info.mode, view.info.pose_speed.pose, view.info.genral))
    assert shown == (truth.mode, truth.pose_speed.pose, truth.genral)
    simulator.push(Mode(ctrl=robot.kManual))
    watching.wait(lambda view: view.info.mode.ctrl == robot.kManual, "the push")
    assert watching.source.link().good
    asked = {each.type for each in simulator.received}
    of_plan = {"woosh.robot.NavPath"}  # the agent's own, at the start of each link
    assert asked - of_plan == {"woosh.Subscription", "woosh.robot.RobotInfo"}


def test_progress_of_an_action(watching, agent, client):
    watching.wait(lambda view: view.complete, "RobotInfo")
    agent_topic = client.path("ros/StepControl/_action/feedback")
    wait_until(lambda: agent.agent.node.count_subscribers(agent_topic) > 0, "the monitor")
    ends = []
    for _ in range(10):  # the first feedbacks can come before DDS has brought the two together
        goal = step(client, 0.2)
        ends.append(goal.result()[0])
        if watching.ask(lambda view: "StepControl" in view.actions):
            break
    assert set(ends) == {SUCCEEDED}
    watching.wait(lambda view: view.actions["StepControl"].state == 1, "its success")


def test_the_agent_comes_and_goes(watching, start_agent, simulator):
    assert "no agent in /woosh_robot" in watching.source.link().text
    agent = start_agent(ip="127.0.0.1", port=simulator.port, backoff_min=0.1)
    watching.wait(lambda view: view.complete, "RobotInfo")
    link = watching.wait_link(lambda link: link.good and "127.0.0.1" in link.text)
    assert f"127.0.0.1:{simulator.port} by websocket" in link.text
    agent.close()
    watching.wait_link(lambda link: not link.good and "no agent" in link.text)
    known = simulator.counts["woosh.robot.RobotInfo"]
    start_agent(ip="127.0.0.1", port=simulator.port)
    watching.wait_link(lambda link: link.good and "is connected to" in link.text)
    # once by the agent itself, and once by the monitor
    wait_until(lambda: simulator.counts["woosh.robot.RobotInfo"] >= known + 2, "another RobotInfo")


def test_an_agent_that_hangs(watching, agent):
    watching.wait_link(lambda link: link.good)
    agent._spinner.stop()
    link = watching.wait_link(lambda link: not link.good)
    assert re.search(r"the agent has not answered for \d+ s", link.text)


def test_the_link_of_the_agent(watching, agent, simulator):
    """As its topic `connected` says it, also to who comes later."""
    watching.wait_link(lambda link: link.good and "is connected to" in link.text)
    simulator.stop_listening()
    link = watching.wait_link(lambda link: not link.good)
    assert "the agent has lost 127.0.0.1" in link.text
    simulator.listen()
    watching.wait_link(lambda link: link.good and "is connected to" in link.text)


def test_the_link_of_an_agent_that_was_there_before(domain, agent, monkeypatch):
    """What its latched topic says comes before the monitor looks for it."""
    monkeypatch.setattr(ros_source, "_LOOK_EVERY", 2.0)
    watching = Watching(domain)
    try:
        watching.wait_link(lambda link: "is connected to" in link.text)
    finally:
        watching.close()


def test_values_that_are_no_numbers(watching, agent, simulator):
    """They end nothing, and are said."""
    watching.wait(lambda view: view.complete, "RobotInfo")
    simulator.push(PoseSpeed(pose=Pose2D(x=math.nan)))
    link = watching.wait_link(lambda link: "could not be read" in link.detail)
    assert "1 messages could not be read, the last because of pose.x" in link.detail
    simulator.push(Battery(power=7))
    watching.wait(lambda view: view.info.battery.power == 7, "the next push")


def test_it_can_be_drawn(watching, agent):
    watching.wait(lambda view: view.complete, "RobotInfo")
    assert draw(watching.source.name, watching.source.link(), watching.source.view)


@pytest.mark.parametrize(
    "arguments",
    [
        ["--namespace", NAMESPACE],
        ["--namespace", "/else", "--ros-args", "-r", f"__ns:={NAMESPACE}"],
    ],
)
def test_once(domain: int, agent: Any, simulator: Any, arguments: list[str]) -> None:
    done = subprocess.run(
        [*PROGRAM, "--once", "--timeout", str(TIMEOUT), *arguments],
        capture_output=True,
        text=True,
        timeout=3 * TIMEOUT,
        env={**os.environ, "ROS_DOMAIN_ID": str(domain), "COLUMNS": "200"},
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "robot at /woosh_robot" in done.stdout
    assert "would be taken" in done.stdout
    assert f"x {simulator.state.pose.x:.3f} m" in done.stdout


def test_once_without_an_agent(domain: int) -> None:
    done = subprocess.run(
        [*PROGRAM, "--once", "--timeout", "1"],
        capture_output=True,
        text=True,
        timeout=3 * TIMEOUT,
        env={**os.environ, "ROS_DOMAIN_ID": str(domain), "COLUMNS": "200"},
    )
    assert (done.returncode, done.stderr) == (1, "")
    assert "no agent in /woosh_robot" in done.stdout


def test_wrong_namespace(domain: int) -> None:
    done = subprocess.run(
        [*PROGRAM, "--once", "--namespace", "a b"],
        capture_output=True,
        text=True,
        timeout=3 * TIMEOUT,
        env={**os.environ, "ROS_DOMAIN_ID": str(domain)},
    )
    assert done.returncode == 2
    assert "monitor: error:" in done.stderr


def test_signals(domain: int) -> None:
    process = subprocess.Popen(
        [*PROGRAM, "--interval", "0.1"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "ROS_DOMAIN_ID": str(domain), "COLUMNS": "200"},
    )
    try:
        assert process.stdout is not None
        assert any("no agent" in line for line in process.stdout)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=TIMEOUT)
        assert (process.returncode, err) == (0, "")
    finally:
        process.kill()
        process.communicate()
