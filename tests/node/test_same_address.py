"""After a reconnect, a robot with another id or serial number answers at the same address."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile

from tests.harness import Client, Collector, RunningAgent
from tests.node.cmd_vel import Sender
from tests.node.goals import ABORTED, EXECUTING, SUCCEEDED, short_task, task
from tests.node.test_twist import speeds
from woosh_robot_agent.simulator import SimulatorConfig, SimulatorThread
from woosh_robot_msgs.srv import RobotInfo

TWIST = "woosh.robot.Twist"
NEW = 30002
"""Id, and serial number, of the robot that replaces the simulator."""


@pytest.fixture
def swap(simulator: SimulatorThread) -> Iterator[Callable[[], SimulatorThread]]:
    """Function that puts another robot at the address of the simulator."""

    def swap() -> SimulatorThread:
        port = simulator.port
        simulator.stop()
        replacement = SimulatorThread(
            SimulatorConfig(port=port, tcp_port=0, speed=20, seed=1, robot_id=NEW)
        )
        replacement.start()
        started.append(replacement)
        return replacement

    started: list[SimulatorThread] = []
    yield swap
    for each in started:
        each.stop()


def test_everything_is_forgotten(
    agent: RunningAgent,
    client: Client,
    swap: Callable[[], SimulatorThread],
    logs: Collector,
) -> None:
    odoms = client.echo_with(Odometry, "odom", QoSProfile(depth=100))
    assert short_task(client, 1.0).result()[0] == SUCCEEDED
    odoms.wait(lambda m: m.pose.pose.position.x > 0.5)
    goal = task(client)
    goal.feedback.wait(lambda fb: fb.state.value == EXECUTING)
    swap()
    logs.wait(lambda r: "another robot answers now: robot 30002" in r.getMessage())
    status, ret = goal.result()
    assert (status, "another robot" in ret.msg) == (ABORTED, True), ret
    agent.wait_connected(2)
    odoms.messages.clear()
    pose = odoms.wait_count(1)[0].pose.pose
    assert (pose.position.x, pose.position.y) == (0.0, 0.0)
    assert client.call(RobotInfo, "robot/RobotInfo").info.genral.serial_number == NEW


def test_no_zero_for_the_former_robot_reaches_the_new_one(
    agent: RunningAgent,
    client: Client,
    simulator: SimulatorThread,
    swap: Callable[[], SimulatorThread],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("woosh_robot_agent.motion.gate.DRIVING", 3600.0)
    Sender(client).send(x=0.3)
    simulator.wait_received(TWIST)
    new = swap()
    agent.wait_connected(2)
    client.call(RobotInfo, "robot/RobotInfo")
    agent.close()
    assert speeds(new) == []
