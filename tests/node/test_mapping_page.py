"""docs/mapping.md: its commands, in its order, lead from a new map to a goal in it."""

from __future__ import annotations

import math
import re
import shlex
import subprocess
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import yaml
from nav_msgs.msg import OccupancyGrid
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from tests.harness import Client, RunningAgent, wait_until
from tests.node.test_maps_page import execute
from tests.ros2_commands import NAMESPACE, set_message_fields
from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.simulator import SimulatorConfig, SimulatorThread
from woosh_robot_agent.simulator.body.base import Velocity
from woosh_robot_agent.simulator.world.geometry import Pose
from woosh_robot_agent.tools.maps.program import main as maps
from woosh_robot_msgs.srv import Deployment

PAGE = Path(__file__).parent.parent.parent / "docs" / "mapping.md"
ROBOT = "169.254.128.2"
"""Address of the robot on the page."""
SPEED = 4.0
"""Simulated seconds per real second.

The robot stops if it gets no velocity for 0.5 s of its time. At a higher speed it would need
velocities more often than the agent sends them."""


def commands() -> list[str]:
    """Return the commands on the page, one a line."""
    blocks = re.findall(r"```bash\n(.*?)```", PAGE.read_text(), re.DOTALL)
    return [line for block in blocks for line in block.replace("\\\n", "").splitlines()]


class Terminal:
    """Executes the commands of the page as the shell and the `ros2` tool do.

    Attributes:
        responses: responses of the services and results of the actions, oldest first.
    """

    def __init__(
        self,
        client: Client,
        simulator: SimulatorThread,
        start_agent: Callable[..., RunningAgent],
        folder: Path,
    ) -> None:
        self.responses: list[Any] = []
        self._client = client
        self._simulator = simulator
        self._start_agent = start_agent
        self._folder = folder

    def run(self, line: str) -> None:
        words = shlex.split(line)
        handlers = {
            "sed": lambda: subprocess.run(words, cwd=self._folder, check=True),
            "ros2 run woosh_robot_agent agent": lambda: self._agent(words[4:]),
            "ros2 run woosh_robot_agent maps": lambda: self._maps(words[4:]),
            "ros2 topic echo": lambda: self._echo(words[3:]),
            "ros2 topic pub": lambda: self._pub(words[3:]),
        }
        for start, handle in handlers.items():
            if line.startswith(f"{start} "):
                handle()
                return
        self.responses.append(execute(self._client, line))

    def _agent(self, words: list[str]) -> None:
        parameters = dict(each.split(":=") for each in words if ":=" in each)
        assert parameters.pop("__ns") == NAMESPACE.rstrip("/")
        assert parameters.pop("ip") == ROBOT
        values = {name: yaml.safe_load(value) for name, value in parameters.items()}
        self._start_agent(ip="127.0.0.1", port=self._simulator.port, **values).wait_connected()

    def _maps(self, words: list[str]) -> None:
        assert words[:2] == ["--ip", ROBOT]
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(self._folder)
            assert maps(["--ip", f"127.0.0.1:{self._simulator.port}", *words[2:]]) == 0

    def _echo(self, words: list[str]) -> None:
        assert "--once" in words
        *_, topic, kind = words
        options = dict(pairwise(words))
        # Without these options, the tool chooses by the publishers that it happens to know.
        qos = QoSProfile(
            depth=1,
            durability=DurabilityPolicy.get_from_short_key(
                options.get("--qos-durability", "volatile")
            ),
            reliability=ReliabilityPolicy.get_from_short_key(
                options.get("--qos-reliability", "best_effort")
            ),
        )
        name = topic.removeprefix(NAMESPACE)
        seen = self._client.echo_with(class_of(kind.replace("/msg", ""), "msg"), name, qos)
        seen.wait(lambda m: eval(options.get("--filter", "True"), {"m": m}))

    def _odometry(self) -> Pose:
        return self._simulator.call(lambda inner: inner.chassis.base.odometry)

    def _pub(self, words: list[str]) -> None:
        """Publish at the command's rate in simulated time.

        This ends when the robot has driven or turned as far as the command says. On a busy machine
        that takes more messages, because the robot stops when one comes too late.
        """
        *_, topic, kind, values = words
        options = dict(pairwise(words))
        rate, times = float(options["-r"]), int(options["-t"])
        message = class_of(kind.replace("/msg", ""), "msg")()
        set_message_fields(message, yaml.safe_load(values))
        node = self._client.node
        publisher = node.create_publisher(type(message), topic, 10)
        wait_until(publisher.get_subscription_count, f"a subscriber of {topic}")
        start = self._odometry()
        wanted = times / rate * max(abs(message.linear.x), abs(message.angular.z))
        for _ in range(20 * times):
            now = self._odometry()
            gone = math.hypot(now.x - start.x, now.y - start.y) + abs(now.theta - start.theta)
            if gone >= wanted:
                break
            publisher.publish(message)
            time.sleep(1.0 / rate / SPEED)
        self._client.in_executor(lambda: node.destroy_publisher(publisher))
        wait_until(lambda: self._simulator.state.velocity == Velocity(), "the robot to stand")


@pytest.fixture
def simulator() -> Any:
    """A simulated chassis with the answer times of a real robot."""
    config = SimulatorConfig(port=0, tcp_port=0, speed=SPEED, seed=1, profile="tr200")
    with SimulatorThread(config) as running:
        yield running


def known_cells(grid: Any) -> int:
    """Return the number of cells that are free or occupied."""
    return len(grid.data) - grid.data.count(-1)


@pytest.mark.timeout(300)
def test_the_commands_of_the_page_make_a_map_and_drive_in_it(
    client, simulator, start_agent, tmp_path
):
    grids = client.echo(OccupancyGrid, "map")
    terminal = Terminal(client, simulator, start_agent, tmp_path)
    seen = []
    """Number of received maps after each command."""
    for line in commands():
        terminal.run(line)
        seen.append(len(grids.messages))

    turn, *_ = (number for number, line in enumerate(commands()) if "topic pub" in line)
    save = next(number for number, line in enumerate(commands()) if "{value: 4}}}" in line)
    growing = grids.messages[seen[turn] : seen[save - 1]]
    assert len(growing) > 1
    assert known_cells(growing[-1]) > known_cells(growing[0])
    # some cells become unknown again, because later scans say the opposite of earlier ones
    assert known_cells(grids.messages[-1]) > 0.99 * known_cells(growing[-1])

    info = simulator.state.info
    assert (info.scene.scene_name, info.scene.map_name) == ("hall", "ground")
    assert simulator.call(lambda inner: set(inner.chassis.map.marks)) == {"A1", "A2"}
    first, second = (
        each.ret.markers[0].pose
        for each in terminal.responses
        if isinstance(each, Deployment.Response)
    )
    assert math.hypot(first.x - second.x, first.y - second.y) > 0.3
    here = info.pose_speed.pose
    assert math.hypot(first.x - here.x, first.y - here.y) < 0.05
