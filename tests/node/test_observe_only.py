"""observe_only: everything can be read, and nothing is sent that changes or moves anything.

The simulated chassis records every frame that it receives.
"""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Iterator
from contextlib import closing
from typing import Any

import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.qos import QoSProfile
from sensor_msgs.msg import LaserScan
from std_srvs.srv import Trigger

from tests.harness import Client, Logs, Robot, RunningAgent, wait_until
from tests.node.goals import EXECUTING, stop_time, task
from tests.node.nav2.goals import pose
from tests.node.test_parameters import change
from tests.node.test_states import diagnostics
from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.endpoints import ACTIONS, COMMANDS, OWN_READS, QUERIES, TOPICS
from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode
from woosh_robot_agent.pb.robot.robot_pb2 import TaskProc
from woosh_robot_agent.ros.standard_endpoints import STANDARD, Kind
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_msgs.srv import Speak

READS = {
    "woosh.Subscription",
    "woosh.robot.CountData",
    *OWN_READS,
    *(query.request for query in QUERIES),
    *(command.request for command in COMMANDS if command.reads),
}
SPEAK = "woosh.robot.Speak"
TWIST = "woosh.robot.Twist"
REASON = "only observes the robot"
REMEDY = "ros2 param set /woosh_robot/agent observe_only false"


@pytest.fixture
def observer(simulator: SimulatorThread, connect: Callable[..., RunningAgent]) -> Iterator[Robot]:
    """An agent that only observes."""
    with closing(Robot(connect(observe_only=True, publish_tf=True), simulator)) as running:
        yield running


def publish(client: Client, name: str, message: Any) -> Any:
    """Publish a message to the agent; return the publisher, with which to repeat it."""
    publisher = client.publisher(type(message), name)
    publisher.publish(message)
    return publisher


def received(simulator: SimulatorThread) -> set[str]:
    return {each.type for each in simulator.received}


def velocity(linear: float) -> Twist:
    message = Twist()
    message.linear.x = linear
    return message


def test_only_reads_reach_the_chassis_whatever_clients_send(observer: Robot, logs: Logs) -> None:
    for query in QUERIES:
        observer.call(class_of(query.srv, "srv"), query.name)
        assert observer.chassis.counts[query.request], query.name
    for command in COMMANDS:
        response = observer.call(class_of(command.srv, "srv"), command.name)
        if command.request in READS:
            assert REASON not in response.msg, command.name
            assert observer.chassis.counts[command.request], command.name
            continue
        assert not response.ok, command.name
        assert REASON in response.msg, command.name
        assert REMEDY in response.msg, command.name
    for action in ACTIONS:
        action_class = class_of(action.action, "action")
        goal = action_class.Goal()
        if hasattr(goal.arg, "action"):
            goal.arg.action.value = 1  # execute; 0 would be a cancel, which is tried below
        observer.send_goal(action_class, action.name, goal).wait_aborted(REASON)
        observer.send_goal(action_class, action.name, action_class.Goal()).wait_aborted(REASON)
    there = pose(0.0, 0.0)
    initial_pose = PoseWithCovarianceStamped(header=there.header)
    initial_pose.pose.pose = there.pose
    inputs = {
        "cmd_vel": [velocity(0.5), velocity(0.0)],
        "initialpose": [initial_pose],
        "goal_pose": [there],
    }
    assert set(inputs) == {each.name for each in STANDARD if each.kind is Kind.INPUT}
    for name, messages in inputs.items():
        for message in messages:
            publisher = publish(observer, name, message)
            for _ in range(3):
                publisher.publish(message)
        logs.wait_text(f"{name} is ignored")
    stopped = observer.call(Trigger, "stop")
    assert not stopped.success
    assert REASON in stopped.message
    assert not observer.call(Trigger, "cancel").success
    # every topic is subscribed to, and those that need requests are served
    for topic in TOPICS:
        observer.echo(class_of(topic.msg, "msg"), topic.name)
    assert observer.echo(OccupancyGrid, "map").wait_count(1)
    assert observer.echo_with(LaserScan, "scan", QoSProfile(depth=1)).wait_count(1)
    assert observer.echo_with(Odometry, "odom", QoSProfile(depth=1)).wait_count(1)
    observer.agent.close()
    assert received(observer.chassis) <= READS, received(observer.chassis) - READS
    for name in inputs:
        told = [record.levelname for record in logs.with_text(f"{name} is ignored")]
        assert [level for level in told if level != "DEBUG"] == ["WARNING"], "it is logged once"


def test_diagnostics_show_it_and_what_others_do(observer: Robot, logs: Logs) -> None:
    def link(message: Any) -> Any:
        return next(s for s in message.status if s.name.endswith(": link"))

    seen = diagnostics(observer)
    # what others do is observed, too
    observer.chassis.push(StatusCode(code=110301000042, level=StatusCode.kWarn))
    logs.wait_text("left motor is too hot")
    observer.chassis.push(TaskProc(robot_task_id=5, state=EXECUTING))
    motion = seen.wait(lambda m: "another client: task 5" in [s.message for s in m.status])
    assert all(s.level == s.OK for s in motion.status if s.name.endswith((": motion", ": agents")))
    assert received(observer.chassis) <= READS
    status = link(motion)
    assert status.message == "observes only: commands are refused"
    assert {v.key: v.value for v in status.values}["observe only"] == "yes"
    assert not observer.call(Speak, "robot/Speak").ok
    assert change(observer, observe_only=False) == (True, "")
    assert observer.call(Speak, "robot/Speak").ok
    assert observer.chassis.counts[SPEAK] == 1
    assert observer.chassis.counts["woosh.robot.RobotInfo"] == 1, "it does not reconnect"
    seen.wait(lambda m: {v.key: v.value for v in link(m).values}["observe only"] == "no")


def test_a_driving_robot_is_stopped_when_it_is_turned_on(robot: Robot) -> None:
    robot.set_motion_timing(driving=3600.0)
    assert robot.command("robot/Twist", linear=0.3).ok
    assert change(robot, observe_only=True) == (True, "")
    robot.chassis.wait_received(TWIST, 2)
    assert robot.chassis.last(TWIST).linear == 0.0  # type: ignore[union-attr]
    assert not robot.command("robot/Twist", linear=0.3).ok
    robot.agent.close()
    assert robot.chassis.counts[TWIST] == 2, "an observer sends no zero at its end"


def test_open_goals_end_when_it_is_turned_on(robot: Robot) -> None:
    stop_time(robot.chassis)
    goal = task(robot)
    wait_until(lambda: robot.chassis.counts["woosh.robot.ExecTask"])
    assert change(robot, observe_only=True) == (True, "")
    goal.wait_aborted(REASON, "may still be executing")
    assert robot.chassis.counts["woosh.robot.ActionOrder"] == 0


def test_a_stream_of_velocities_does_not_drive_when_it_is_turned_off(
    observer: Robot, logs: Logs
) -> None:
    observer.set_motion_timing(pause=3600.0)  # however slow the machine is
    publisher = publish(observer, "cmd_vel", velocity(0.5))
    logs.wait_text("cmd_vel is ignored: this agent only observes")
    assert change(observer, observe_only=False) == (True, "")
    publisher.publish(velocity(0.5))
    logs.wait_text("not permitted until now; send a zero")
    assert observer.chassis.counts[TWIST] == 0
    speeds = itertools.cycle([0.0, 0.5])
    wait_until(
        lambda: publisher.publish(velocity(next(speeds))) or observer.chassis.counts[TWIST],
        "a velocity",
    )


def test_turning_it_on_precedes_the_velocity_that_follows(robot: Robot, logs: Logs) -> None:
    """Also if the link thread is busy while both arrive."""
    publisher = publish(robot, "cmd_vel", velocity(0.0))
    released = threading.Event()
    robot.agent.agent.robot.thread.call(released.wait)
    try:
        assert change(robot, observe_only=True) == (True, "")
        publisher.publish(velocity(0.5))
        change(robot, observe_only=True)  # meanwhile, the velocity arrives
    finally:
        released.set()
    logs.wait_text("cmd_vel is ignored: this agent only observes")
    assert robot.chassis.counts[TWIST] == 0
