"""What the agent observes, in /diagnostics and in its log."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.srv import GetParameters

from tests.harness import HUMBLE, Client, Collector, wait_until
from tests.node.cmd_vel import Sender
from tests.node.test_states import diagnostics, values
from woosh_robot_agent.pb.robot.robot_count_pb2 import AbnormalCodes, StatusCode
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed
from woosh_robot_agent.ros import second_agent
from woosh_robot_msgs.msg import Twist as TwistMsg
from woosh_robot_msgs.srv import RobotInfo, Twist

pytestmark = pytest.mark.usefixtures("frequent")

WARN, ERROR = DiagnosticStatus.WARN, DiagnosticStatus.ERROR


@pytest.fixture(autouse=True)
def frequent_checks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(second_agent, "_PERIOD", 0.5)


@pytest.fixture
def arrays(client: Client) -> Collector:
    return diagnostics(client)


def find(array: Any, name: str) -> Any:
    """Return a status; an empty one if it is missing, as most are before the first link."""
    found = [each for each in array.status if each.name.endswith(f": {name}")]
    return found[0] if found else DiagnosticStatus()


def wait_message(arrays: Collector, name: str, *texts: str) -> Any:
    """Wait for a status whose message has all these texts."""
    array = arrays.wait(lambda a: all(text in find(a, name).message for text in texts))
    return find(array, name)


@pytest.fixture
def publish(domain: int) -> Iterator[Callable[[str, float], Sender]]:
    """Function that starts a node that repeats a velocity on cmd_vel; takes its name and speed."""
    with ExitStack() as stack:

        def start(name: str, linear: float) -> Sender:
            sender = Sender(stack.enter_context(closing(Client(domain, name=name))))
            stack.callback(sender.pause)
            sender.repeat(20.0, x=linear)
            return sender

        yield start


def test_who_drives_is_shown_and_two_at_the_same_time_are_a_warning(
    simulator, agent, client, arrays, publish, logs
):
    assert find(arrays.wait_count(1)[0], "motion").message == "nobody"
    joystick = publish("joystick", 0.1)
    status = wait_message(arrays, "motion", "cmd_vel")
    assert values(status)["driver"] == "cmd_vel"
    assert status.level == DiagnosticStatus.OK
    assert client.call(Twist, "robot/Twist", arg=TwistMsg(linear=0.2)).ok
    status = wait_message(arrays, "motion", "cmd_vel and robot/Twist command velocities")
    assert status.level == WARN
    logs.wait_text("cmd_vel and robot/Twist command")
    joystick.pause()
    wait_until(lambda: find(arrays.messages[-1], "motion").message == "nobody")


@pytest.mark.skipif(HUMBLE, reason="rclpy of Humble does not tell the numbers of messages")
def test_two_publishers_of_cmd_vel_are_named(connect, client, arrays, publish):
    connect()
    publish("joystick", 0.0)
    publish("navigation", 0.2)
    status = wait_message(arrays, "motion", "/joystick (on cmd_vel) and /navigation (on cmd_vel)")
    assert status.level == WARN


def test_two_clients_of_the_service_are_a_warning(simulator, agent, client, arrays):
    callers = [client.node.create_client(Twist, client.path("robot/Twist")) for _ in range(2)]
    for caller in callers:
        wait_until(caller.service_is_ready, "the service")
    client.wait_known(GetParameters, client.path("agent/get_parameters"))

    def call(caller: Any, linear: float) -> None:
        future = caller.call_async(Twist.Request(arg=TwistMsg(linear=linear)))
        wait_until(future.done, "the answer")

    for _ in range(4):
        call(callers[0], 0.1)
    assert "command velocities" not in find(arrays.wait_count(1)[-1], "motion").message

    for _ in range(4):
        call(callers[0], 0.1)
        call(callers[1], -0.1)
    wait_message(arrays, "motion", "a client of robot/Twist and another client of robot/Twist")


def test_a_velocity_that_moves_nothing_is_a_warning_until_the_robot_moves(
    simulator, agent, client, arrays, logs
):
    end = simulator.intercept(
        lambda frame: [] if frame.type == "woosh.robot.PoseSpeed" else [frame]
    )
    assert client.call(Twist, "robot/Twist", arg=TwistMsg(linear=0.05)).ok
    text = "robot/Twist was accepted, but the robot does not move: perhaps the key switch"
    assert wait_message(arrays, "motion", text).level == WARN
    logs.wait_text(text)
    end()
    simulator.push(PoseSpeed(map_id=3))
    wait_until(lambda: find(arrays.messages[-1], "motion").level == DiagnosticStatus.OK)


def test_a_code_gets_its_meaning_and_a_pose_without_a_map_a_warning(
    simulator, agent, client, arrays, logs
):
    assert values(find(arrays.wait_count(1)[0], "chassis"))["map id"] == "3"
    codes = [StatusCode(code=110201000013, level=StatusCode.kFault)]
    codes.append(StatusCode(code=110301000042, level=StatusCode.kWarn, msg="左电机过热"))
    simulator.push(AbnormalCodes(scs=codes))
    texts = (
        "110201000013: emergency stop 1 was pressed",
        "110301000042: 左电机过热 (left motor is too hot)",
    )
    assert wait_message(arrays, "abnormal codes", *texts).level == ERROR
    for text in texts:
        logs.wait_text(text)
    simulator.push(PoseSpeed(map_id=0))
    assert wait_message(arrays, "chassis", "the pose may mean nothing").level == WARN


def test_a_clock_that_is_off_is_a_warning(simulator, agent, arrays):
    """The simulated clock begins in 2023 if the simulator has a seed."""
    status = wait_message(arrays, "clock", "days behind this computer's", "not affected")
    assert status.level == WARN
    offset = float(values(status)["offset"].removesuffix(" s"))
    stamp = arrays.messages[-1].header.stamp.sec
    assert abs(stamp - time.time()) < abs(offset) / 2


def test_a_second_agent_is_named_until_it_ends(
    simulator, agent, client, arrays, start_agent, logs, domain
):
    assert find(arrays.wait_count(1)[0], "agents").message == "OK"
    second = start_agent(ip="127.0.0.1", port=simulator.port)
    texts = ("another agent runs", "node /woosh_robot/agent. Both", "observe_only")
    assert wait_message(arrays, "agents", *texts).level == WARN
    logs.wait_text("node /woosh_robot/agent")
    second.close()
    for _ in range(2):  # another node with the same services; logged again when it comes back
        wait_until(lambda: find(arrays.messages[-1], "agents").message == "OK", "its end")
        logs.messages.clear()
        with closing(Client(domain, name="impostor")) as other:
            name = other.path("robot/RobotInfo")
            other.node.create_service(RobotInfo, name, lambda _, response: response)
            logs.wait_text("node /impostor")
            wait_until(
                lambda: "node /impostor" in find(arrays.messages[-1], "agents").message,
                "the warning",
            )
