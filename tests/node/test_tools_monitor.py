"""`monitor` over ROS, with an agent and a simulated chassis."""

from __future__ import annotations

import asyncio
import io
import math
import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import closing
from typing import Any

import pytest
from rich.console import Console

from tests.harness import NAMESPACE, wait_until
from tests.node.goals import SUCCEEDED, step
from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.endpoints import TOPICS
from woosh_robot_agent.pb.robot.robot_pb2 import Battery, Mode, PoseSpeed
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.pb.util.common_pb2 import Pose2D
from woosh_robot_agent.ros.qos import latched
from woosh_robot_agent.tools.monitor import ros_source
from woosh_robot_agent.tools.monitor.program import main, print_once
from woosh_robot_agent.tools.monitor.ros_source import RosSource
from woosh_robot_agent.tools.robot_view import LinkReport, RobotView
from woosh_robot_agent.tools.ros_node import NodeThread

TIMEOUT = 60.0
PROGRAM = [sys.executable, "-m", "woosh_robot_agent.tools", "monitor"]


class Watching:
    """A `RosSource` in its own event loop, used from the test's thread."""

    def __init__(self, domain: int) -> None:
        self.source = RosSource(NAMESPACE, domain=domain)
        self.loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self.loop.run_forever, daemon=True)
        self._thread.start()
        self.run(self.source.start())

    def run(self, work: Any) -> Any:
        return asyncio.run_coroutine_threadsafe(work, self.loop).result(TIMEOUT)

    def ask(self, question: Callable[[RobotView], Any]) -> Any:
        async def answer() -> Any:
            return question(self.source.view)

        return self.run(answer())

    def wait(self, condition: Callable[[RobotView], Any], what: str = "") -> Any:
        return wait_until(lambda: self.ask(condition), what, TIMEOUT)

    def wait_complete(self) -> None:
        """Wait until the view is complete, when `monitor --once` would print it."""
        source = self.source
        wait_until(lambda: source.link().good and source.is_complete(), "first values", TIMEOUT)

    def wait_link(self, condition: Callable[[LinkReport], Any]) -> LinkReport:
        try:
            wait_until(lambda: condition(self.source.link()), "the link's state", TIMEOUT)
        except AssertionError as error:
            raise AssertionError(f"{error}: {self.source.link()}") from None
        return self.source.link()

    def close(self) -> None:
        self.run(self.source.close())
        self.loop.call_soon_threadsafe(self.loop.stop)
        self._thread.join(TIMEOUT)
        self.loop.close()


@pytest.fixture
def watching(domain: int) -> Iterator[Watching]:
    with closing(Watching(domain)) as running:
        yield running


def test_first_values_changes_and_the_progress_of_an_action_are_shown(
    watching, agent, client, simulator
):
    watching.wait_complete()
    truth = simulator.state.info
    shown = watching.ask(lambda view: (view.info.mode, view.info.pose_speed.pose, view.info.genral))
    assert shown == (truth.mode, truth.pose_speed.pose, truth.genral)
    simulator.push(Mode(ctrl=robot.kManual))
    watching.wait(lambda view: view.info.mode.ctrl == robot.kManual, "the push")
    assert watching.source.link().good
    simulator.push(PoseSpeed(pose=Pose2D(x=math.nan)))  # is skipped
    link = watching.wait_link(lambda link: "unreadable" in link.detail)
    assert "1 unreadable messages, the last one because of pose.x" in link.detail
    simulator.push(Battery(power=7))
    watching.wait(lambda view: view.info.battery.power == 7, "the next push")
    asked = {each.type for each in simulator.received}
    of_the_agent = {"woosh.robot.NavPath", "woosh.ros.Feedbacks"}  # requested by the agent itself
    assert asked - of_the_agent == {"woosh.Subscription", "woosh.robot.RobotInfo"}

    agent_topic = client.path("ros/StepControl/_action/feedback")
    wait_until(lambda: agent.agent.node.count_subscribers(agent_topic) > 0, "the monitor")
    ends = []
    for _ in range(10):  # DDS may discover the subscription only after the first feedback messages
        goal = step(client, 0.2)
        ends.append(goal.result()[0])
        if watching.ask(lambda view: "StepControl" in view.actions):
            break
    assert set(ends) == {SUCCEEDED}
    watching.wait(lambda view: view.actions["StepControl"].state == 1, "its success")


def test_start_and_end_of_the_agent_are_noticed(watching, start_agent, simulator):
    assert "no agent found in namespace /woosh_robot" in watching.source.link().text
    agent = start_agent(ip="127.0.0.1", port=simulator.port, backoff_min=0.1)
    watching.wait_complete()
    link = watching.wait_link(lambda link: link.good and "127.0.0.1" in link.text)
    assert f"127.0.0.1:{simulator.port} over websocket" in link.text
    agent.close()
    watching.wait_link(lambda link: not link.good and "no agent found" in link.text)
    known = simulator.counts["woosh.robot.RobotInfo"]
    start_agent(ip="127.0.0.1", port=simulator.port)
    watching.wait_link(lambda link: link.good and "is connected to" in link.text)
    watching.wait_complete()
    # One request comes from the agent itself, and one from the monitor.
    wait_until(lambda: simulator.counts["woosh.robot.RobotInfo"] >= known + 2, "another RobotInfo")


def test_an_agent_that_hangs_is_noticed(watching, agent):
    watching.wait_link(lambda link: link.good)
    released = threading.Event()
    agent.agent.node.executor.create_task(released.wait)
    try:
        link = watching.wait_link(lambda link: not link.good)
        assert re.search(r"the agent has not answered for \d+ s", link.text)
    finally:
        released.set()


def test_the_link_of_an_agent_that_started_earlier_is_shown(domain, agent, simulator, monkeypatch):
    """The message on `connected` arrives before the monitor has discovered the agent."""
    monkeypatch.setattr(ros_source, "_DISCOVERY_PERIOD", 2.0)
    with closing(Watching(domain)) as watching:
        watching.wait_link(lambda link: link.good and "is connected to" in link.text)
        simulator.stop_listening()
        link = watching.wait_link(lambda link: not link.good)
        assert "the agent is not connected to 127.0.0.1" in link.text
        assert f"doctor --ip 127.0.0.1:{simulator.port}`" in link.detail
        simulator.listen()
        watching.wait_link(lambda link: link.good and "is connected to" in link.text)


def test_an_internal_error_is_not_blamed_on_the_agent(watching, agent, simulator, monkeypatch):
    watching.wait_complete()
    monkeypatch.setattr(watching.source, "_loop", None)  # which the next message needs
    simulator.push(Mode(ctrl=robot.kManual))
    link = watching.wait_link(lambda link: not link.good)
    assert link.text.startswith("the monitor receives nothing more: internal error: Attribute")


def test_a_node_without_the_parameters_of_an_agent_is_watched_too(watching, domain):
    """For example `ros2 bag play`, with a recording of `record --ros`."""
    topic = TOPICS[0]
    player = NodeThread("player", NAMESPACE, domain=domain)
    publisher = player.node.create_publisher(
        class_of(topic.msg, "msg"), topic.name, latched(topic.depth)
    )
    with closing(player):
        player.start(pytest.fail)
        publisher.publish(class_of(topic.msg, "msg")())
        watching.wait(lambda view: not view.is_empty, "the message")
        watching.wait_link(lambda link: link.good and "is connected to the robot" in link.detail)


def test_once_works_with_an_agent_that_does_not_publish_connected(watching, connect):
    connect(disabled_parts=["connected"])
    file = io.StringIO()
    console = Console(file=file, width=200, color_system=None)
    status = watching.run(print_once(watching.source, console, asyncio.Event(), TIMEOUT))
    assert "it is unknown whether it is connected to 127.0.0.1" in file.getvalue()
    assert "disabled_parts" in file.getvalue()
    assert status == 0


def test_once_prints_the_state(domain: int, agent: Any, simulator: Any) -> None:
    done = subprocess.run(
        [*PROGRAM, "--once", "--timeout", str(TIMEOUT)]
        + ["--namespace", "/else", "--ros-args", "-r", f"__ns:={NAMESPACE}"],
        capture_output=True,
        text=True,
        timeout=3 * TIMEOUT,
        env={**os.environ, "ROS_DOMAIN_ID": str(domain), "COLUMNS": "200"},
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "robot at /woosh_robot" in done.stdout
    assert "would be accepted" in done.stdout
    assert f"x {simulator.state.pose.x:.3f} m" in done.stdout


def test_once_without_an_agent_fails(watching: Watching) -> None:
    file = io.StringIO()
    console = Console(file=file, width=200, color_system=None)
    assert watching.run(print_once(watching.source, console, asyncio.Event(), 1.0)) == 1
    assert "no agent found in namespace /woosh_robot" in file.getvalue()


def test_an_invalid_namespace_is_refused(domain: int, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["--namespace", "a b"])
    assert ended.value.code == 2
    assert "monitor: error:" in capsys.readouterr().err


def test_ctrl_c_ends_it(domain: int) -> None:
    process = subprocess.Popen(
        PROGRAM,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "ROS_DOMAIN_ID": str(domain), "COLUMNS": "200"},
    )
    try:
        assert process.stdout is not None
        assert any("no agent found" in line for line in process.stdout)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=TIMEOUT)
        assert (process.returncode, err) == (0, "")
    finally:
        process.kill()
        process.communicate()
