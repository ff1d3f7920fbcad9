"""observe_only: everything can be read, and nothing is sent that changes or moves anything.

The simulated chassis records every frame that it receives.
"""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable
from typing import Any

import pytest
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, Twist
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.qos import QoSProfile
from sensor_msgs.msg import LaserScan
from std_srvs.srv import Trigger

from tests.harness import Client, Collector, RunningAgent, wait_until
from tests.node.goals import ABORTED, EXECUTING, stop_time, task
from tests.node.test_parameters import change
from tests.node.test_states import diagnostics
from tests.quick_chassis import set_speed
from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.endpoints import ACTIONS, COMMANDS, OWN_READS, QUERIES, TOPICS
from woosh_robot_agent.motion import velocity_driver
from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode
from woosh_robot_agent.pb.robot.robot_pb2 import TaskProc
from woosh_robot_agent.ros.standard.endpoints import STANDARD, Kind
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_msgs.srv import RobotWiFi, Speak
from woosh_robot_msgs.srv import Twist as TwistSrv

READS = {
    "woosh.Subscription",
    "woosh.robot.CountData",
    *OWN_READS,
    *(query.request for query in QUERIES),
    *(command.request for command in COMMANDS if command.reads),
}
WIFI = "woosh.robot.RobotWiFi"
SPEAK = "woosh.robot.Speak"
TWIST = "woosh.robot.Twist"
REASON = "only observes the robot"
REMEDY = "ros2 param set /woosh_robot/agent observe_only false"


@pytest.fixture
def observer(simulator: SimulatorThread, start_agent: Callable[..., RunningAgent]) -> RunningAgent:
    """An agent that only observes."""
    agent = start_agent(
        ip="127.0.0.1", port=simulator.port, backoff_min=0.1, observe_only=True, publish_tf=True
    )
    agent.wait_connected()
    return agent


def publish(client: Client, name: str, message: Any) -> Any:
    """Publish a message to the agent; return the publisher, with which to repeat it."""
    publisher = client.node.create_publisher(type(message), client.path(name), 10)
    wait_until(lambda: publisher.get_subscription_count(), name)
    publisher.publish(message)
    return publisher


def received(simulator: SimulatorThread) -> set[str]:
    return {each.type for each in simulator.received}


def logged(logs: Collector, text: str) -> list[str]:
    """Return the log messages at INFO and above that contain `text`."""
    return [r.getMessage() for r in logs.messages if text in r.getMessage() and r.levelno >= 20]


def initial_pose() -> PoseWithCovarianceStamped:
    message = PoseWithCovarianceStamped()
    message.header.frame_id = "map"
    message.pose.pose.orientation.w = 1.0
    return message


def goal_pose() -> PoseStamped:
    message = PoseStamped()
    message.header.frame_id = "map"
    message.pose.orientation.w = 1.0
    return message


def velocity(linear: float) -> Twist:
    message = Twist()
    message.linear.x = linear
    return message


def test_only_reads_reach_the_chassis_whatever_clients_send(
    observer: RunningAgent, client: Client, simulator: SimulatorThread, logs: Collector
) -> None:
    for query in QUERIES:
        client.call(class_of(query.srv, "srv"), query.name)
        assert simulator.counts[query.request], query.name
    for command in COMMANDS:
        response = client.call(class_of(command.srv, "srv"), command.name)
        if command.request in READS:
            assert REASON not in response.msg, command.name
            assert simulator.counts[command.request], command.name
            continue
        assert not response.ok, command.name
        assert REASON in response.msg, command.name
        assert REMEDY in response.msg, command.name
    for action in ACTIONS:
        action_class = class_of(action.action, "action")
        goal = action_class.Goal()
        if hasattr(goal.arg, "action"):
            goal.arg.action.value = 1  # execute; 0 would be a cancel, which is tried below
        status, ret = client.send_goal(action_class, action.name, goal).result()
        assert (status, REASON in ret.msg) == (ABORTED, True), ret
        status, ret = client.send_goal(action_class, action.name, action_class.Goal()).result()
        assert (status, REASON in ret.msg) == (ABORTED, True), ret
    inputs = {
        "cmd_vel": [velocity(0.5), velocity(0.0)],
        "initialpose": [initial_pose()],
        "goal_pose": [goal_pose()],
    }
    assert set(inputs) == {each.name for each in STANDARD if each.kind is Kind.INPUT}
    for name, messages in inputs.items():
        for message in messages:
            publisher = publish(client, name, message)
            for _ in range(3):
                publisher.publish(message)
        logs.wait(lambda r, name=name: f"{name} is ignored" in r.getMessage())
    stopped = client.call(Trigger, "stop")
    assert not stopped.success
    assert REASON in stopped.message
    assert not client.call(Trigger, "cancel").success
    # every topic is subscribed to, and those that need requests are served
    for topic in TOPICS:
        client.echo(class_of(topic.msg, "msg"), topic.name)
    assert client.echo(OccupancyGrid, "map").wait_count(1)
    assert client.echo_with(LaserScan, "scan", QoSProfile(depth=1)).wait_count(1)
    assert client.echo_with(Odometry, "odom", QoSProfile(depth=1)).wait_count(1)
    observer.close()
    assert received(simulator) <= READS, received(simulator) - READS
    for name in inputs:
        assert len(logged(logs, f"{name} is ignored")) == 1, "it is logged once"


def test_the_wifi_list_is_read_and_no_other_order_is_sent(
    observer: RunningAgent, client: Client, simulator: SimulatorThread
) -> None:
    arg = RobotWiFi.Request().arg
    for order in range(7):
        arg.order.value = order
        response = client.call(RobotWiFi, "robot/RobotWiFi", arg=arg)
        assert response.ok == (order == arg.order.K_WI_FI_LIST), response
    assert [each.message.order for each in simulator.received if each.type == WIFI] == [
        arg.order.K_WI_FI_LIST
    ]
    arg.order.value = arg.order.K_WI_FI_LIST
    arg.enable = True  # its meaning in this order is not known
    assert not client.call(RobotWiFi, "robot/RobotWiFi", arg=arg).ok


def test_diagnostics_show_it(observer: RunningAgent, client: Client) -> None:
    def link(message: Any) -> Any:
        return next(s for s in message.status if s.name.endswith(": link"))

    seen = diagnostics(client)
    status = link(seen.wait_count(1)[0])
    assert status.message == "observes only: commands are refused"
    assert {v.key: v.value for v in status.values}["observe only"] == "yes"
    assert change(client, observe_only=False) == (True, "")
    seen.wait(lambda m: {v.key: v.value for v in link(m).values}["observe only"] == "no")


def test_what_others_do_is_observed(
    observer: RunningAgent, client: Client, simulator: SimulatorThread, logs: Collector
) -> None:
    seen = diagnostics(client)
    simulator.push(StatusCode(code=110301000042, level=StatusCode.kWarn))
    logs.wait(lambda r: "left motor is too hot" in r.getMessage())
    simulator.push(TaskProc(robot_task_id=5, state=EXECUTING))
    motion = seen.wait(lambda m: "another client: task 5" in [s.message for s in m.status])
    assert all(s.level == s.OK for s in motion.status if s.name.endswith((": motion", ": agents")))
    observer.close()
    assert received(simulator) <= READS


def test_the_task_of_a_goal_goes_on_when_it_is_turned_on(
    agent: RunningAgent, client: Client, simulator: SimulatorThread
) -> None:
    set_speed(simulator, 1.0)
    goal = task(client, task_id=7)
    goal.feedback.wait(lambda fb: fb.state.value == EXECUTING)
    assert change(client, observe_only=True) == (True, "")
    goal.result()
    text = "a goal: task 7; the goal has ended, but the robot continues"
    diagnostics(client).wait(lambda m: text in [s.message for s in m.status])


def test_commands_are_sent_again_when_it_is_turned_off(
    observer: RunningAgent, client: Client, simulator: SimulatorThread
) -> None:
    assert not client.call(Speak, "robot/Speak").ok
    assert change(client, observe_only=False) == (True, "")
    assert client.call(Speak, "robot/Speak").ok
    assert change(client, observe_only=True) == (True, "")
    assert REASON in client.call(Speak, "robot/Speak").msg
    assert simulator.counts[SPEAK] == 1
    assert simulator.counts["woosh.robot.RobotInfo"] == 1, "it does not reconnect"


def test_a_driving_robot_is_stopped_when_it_is_turned_on(
    agent: RunningAgent, client: Client, simulator: SimulatorThread, monkeypatch: Any
) -> None:
    monkeypatch.setattr("woosh_robot_agent.motion.gate.DRIVING", 3600.0)
    arg = TwistSrv.Request().arg
    arg.linear = 0.3
    assert client.call(TwistSrv, "robot/Twist", arg=arg).ok
    assert change(client, observe_only=True) == (True, "")
    simulator.wait_received(TWIST, 2)
    assert simulator.last(TWIST).linear == 0.0  # type: ignore[union-attr]
    assert not client.call(TwistSrv, "robot/Twist", arg=arg).ok
    agent.close()
    assert simulator.counts[TWIST] == 2, "an observer sends no zero at its end"


def test_open_goals_end_when_it_is_turned_on(
    agent: RunningAgent, client: Client, simulator: SimulatorThread
) -> None:
    stop_time(simulator)
    goal = task(client)
    wait_until(lambda: simulator.counts["woosh.robot.ExecTask"])
    assert change(client, observe_only=True) == (True, "")
    status, ret = goal.result()
    assert status == ABORTED
    assert REASON in ret.msg
    assert "may still be executing" in ret.msg
    assert simulator.counts["woosh.robot.ActionOrder"] == 0


@pytest.mark.usefixtures("observer")
def test_a_stream_of_velocities_does_not_drive_when_it_is_turned_off(
    client: Client,
    simulator: SimulatorThread,
    logs: Collector,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(velocity_driver, "_PAUSE", 3600.0)  # however slow the machine is
    publisher = publish(client, "cmd_vel", velocity(0.5))
    logs.wait(lambda r: "cmd_vel is ignored: this agent only observes" in r.getMessage())
    assert change(client, observe_only=False) == (True, "")
    publisher.publish(velocity(0.5))
    logs.wait(lambda r: "not permitted until now; send a zero" in r.getMessage())
    assert simulator.counts[TWIST] == 0
    speeds = itertools.cycle([0.0, 0.5])
    wait_until(
        lambda: publisher.publish(velocity(next(speeds))) or simulator.counts[TWIST], "a velocity"
    )


def test_turning_it_on_precedes_the_velocity_that_follows(
    agent: RunningAgent, client: Client, simulator: SimulatorThread, logs: Collector
) -> None:
    """Also if the link thread is busy while both arrive."""
    publisher = publish(client, "cmd_vel", velocity(0.0))
    released = threading.Event()
    agent.agent._thread.call(released.wait)
    try:
        assert change(client, observe_only=True) == (True, "")
        publisher.publish(velocity(0.5))
        change(client, observe_only=True)  # meanwhile, the velocity arrives
    finally:
        released.set()
    logs.wait(lambda r: "cmd_vel is ignored: this agent only observes" in r.getMessage())
    assert simulator.counts[TWIST] == 0


def test_each_robot_of_a_process_has_its_own(
    domain: int, simulator: SimulatorThread, start_agent: Callable[..., RunningAgent]
) -> None:
    for namespace, observe_only in (("/r1", True), ("/r2", False)):
        start_agent(
            namespace=namespace, ip="127.0.0.1", port=simulator.port, observe_only=observe_only
        ).wait_connected()
    for namespace, ok in (("/r1", False), ("/r2", True)):
        user = Client(domain, namespace)
        try:
            response = user.call(Speak, "robot/Speak")
            assert response.ok == ok
            assert ok or "ros2 param set /r1/agent observe_only false" in response.msg
        finally:
            user.close()
