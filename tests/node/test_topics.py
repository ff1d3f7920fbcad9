"""Topics: each push of the chassis is published once and in order; AgentInfo."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import pytest
from google.protobuf.message import Message

from tests.convert.random_messages import random_proto
from tests.harness import Client, Collector, Robot, RunningAgent, wait_until
from woosh_robot_agent.convert import converter
from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.endpoints import AGENT_INFO, TOPICS
from woosh_robot_agent.link.protos import message_type
from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode
from woosh_robot_agent.pb.robot.robot_pack_pb2 import BuildMapData
from woosh_robot_agent.pb.robot.robot_pb2 import Battery, PoseSpeed, RobotInfo, RobotState, TaskProc
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_msgs.msg import AgentInfo
from woosh_robot_msgs.msg import Battery as BatteryMsg
from woosh_robot_msgs.msg import BuildMapData as BuildMapDataMsg
from woosh_robot_msgs.msg import StatusCode as StatusCodeMsg
from woosh_robot_msgs.msg import TaskProc as TaskProcMsg

INFO = "woosh.robot.RobotInfo"
BATTERY = "woosh.robot.Battery"
POSE_SPEED = "woosh.robot.PoseSpeed"
TASK_PROC = "woosh.robot.TaskProc"
QUIET = ("StatusCode", "NavPath", *(t.name.partition("/")[2] for t in TOPICS if t.extra))
"""Topics whose values are not part of RobotInfo and only come as pushes."""


@pytest.fixture
def push(simulator: Any) -> Callable[[Message], None]:
    """Function that pushes a message. The chassis sends no other pushes."""
    ours: list[Message] = []

    def only_ours(frame: Any) -> list[Any]:
        return [frame] if frame.request or any(frame.body is each for each in ours) else []

    def push(message: Message) -> None:
        ours.append(message)
        simulator.push(message)

    simulator.intercept(only_ours)
    return push


@pytest.fixture
def connect(simulator: Any, start_agent: Any) -> Callable[..., Any]:
    """Function that starts an agent; its argument changes the chassis's answer to RobotInfo."""

    def connect(answer: Callable[[Any], Any] | None = None) -> Any:
        if answer:
            simulator.intercept(lambda f: answer(f) if f.request == INFO else [f])
        agent = start_agent(ip="127.0.0.1", port=simulator.port, backoff_min=0.1)
        agent.wait_connected()
        simulator.wait_received("woosh.Subscription")
        return agent

    return connect


def holding(info: RobotInfo) -> Callable[[Any], Any]:
    def change(frame: Any) -> list[Any]:
        frame.body.CopyFrom(info)
        return [frame]

    return change


def echo_all(client: Any, simulator: Any) -> dict[str, Any]:
    """Subscribe to all topics, and wait until the chassis is asked for all pushes."""
    echoes = {topic.push: client.echo(class_of(topic.msg, "msg"), topic.name) for topic in TOPICS}
    wait_until(lambda: set(echoes) <= subscribed(simulator), "all subscriptions at the chassis")
    return echoes


def subscribed(simulator: Any) -> set[str]:
    """Return the types that the agent has subscribed to at the chassis."""
    found: set[str] = set()
    for each in simulator.received:
        if each.type == "woosh.Subscription":
            change = found.update if each.message.sub else found.difference_update
            change(each.message.topics)
    return found


def wait_matched(client: Any) -> None:
    """Wait until the client has discovered a publisher for each of its subscriptions."""
    names = [subscription.topic_name for subscription in client.node.subscriptions]
    count = client.node.count_publishers
    wait_until(lambda: sum(map(count, names)) >= len(TOPICS), "the agent's publishers")


def test_late_subscribers_get_the_newest_messages(connect, client, push):
    connect()
    for number in range(1, 61):
        push(StatusCode(code=number))
        push(TaskProc(robot_task_id=number))
        push(Battery(power=number))
    for msg, name, field, depth in (
        (StatusCodeMsg, "robot/StatusCode", "code", 50),
        (TaskProcMsg, "robot/TaskProc", "robot_task_id", 10),
        (BatteryMsg, "robot/Battery", "power", 1),
    ):
        early = client.echo(msg, name)
        early.wait(lambda m, field=field: getattr(m, field) == 60)
        late = client.echo(msg, name)
        late.wait(lambda m, field=field: getattr(m, field) == 60)
        assert [getattr(m, field) for m in late.messages] == list(range(61 - depth, 61))


def test_first_values_come_from_robot_info(connect, client, push, simulator):
    info = simulator.state.info
    connect()
    for topic in TOPICS:
        short = topic.name.partition("/")[2]
        if short in QUIET:
            continue
        first = client.echo(class_of(topic.msg, "msg"), topic.name).wait_count(1)[0]
        field = "".join(f"_{c.lower()}" if c.isupper() else c for c in short).lstrip("_")
        said = RobotState(state=info.state) if short == "RobotState" else getattr(info, field)
        assert first == converter(type(first), type(said)).to_ros(said), topic.name


def test_each_push_is_published_once_and_in_order(connect, client, push, simulator):
    connect(holding(RobotInfo()))
    echoes = echo_all(client, simulator)
    wait_matched(client)
    echoes[TASK_PROC].wait_count(1)  # RobotInfo says that there is no task
    echoes[TASK_PROC].messages.clear()
    rng = random.Random(3)
    sent: dict[str, list[Any]] = {topic.push: [] for topic in TOPICS}
    for _ in range(4):
        for topic in TOPICS:
            cls = class_of(topic.msg, "msg")
            message = random_proto(rng, message_type(topic.push), cls)
            push(message)
            sent[topic.push].append(converter(cls, type(message)).to_ros(message))
            echoes[topic.push].wait_count(len(sent[topic.push]))
    for topic in TOPICS:
        assert echoes[topic.push].messages == sent[topic.push], topic.name


def test_pushes_are_ordered_with_robot_info(connect, client, simulator):
    """A push before the answer to RobotInfo is older than it, a push after it is newer."""

    def surround(frame: Any) -> list[Any]:
        frame.body.task_proc.robot_task_id = 2
        around = [type(frame)(TASK_PROC, TaskProc(robot_task_id=i)) for i in (1, 3)]
        return [around[0], frame, around[1]]

    simulator.intercept(lambda f: [] if f.type == TASK_PROC and f.body.robot_task_id > 3 else [f])
    agent = connect(surround)
    echo = client.echo(TaskProcMsg, "robot/TaskProc")
    assert [m.robot_task_id for m in echo.wait_count(3)] == [1, 2, 3]
    wait_until(lambda: agent.agent.robot.last_known.get(TASK_PROC).robot_task_id == 3)


def test_nothing_is_published_until_the_chassis_is_back(connect, client, push, simulator):
    powers = iter((50, 49))

    def count_down(frame: Any) -> list[Any]:
        frame.body.CopyFrom(RobotInfo(battery=Battery(power=next(powers))))
        return [frame]

    agent = connect(count_down)
    echoes = echo_all(client, simulator)
    echoes[BATTERY].wait_count(1)
    push(PoseSpeed(mileage=3))
    echoes[POSE_SPEED].wait_count(1)
    simulator.drop()
    agent.wait_connected(2)
    battery = echoes[BATTERY]
    assert [m.power for m in battery.wait_count(2)] == [50, 49]
    push(PoseSpeed(mileage=4))
    assert [m.mileage for m in echoes[POSE_SPEED].wait_count(2)] == [3, 4]
    others = echoes.keys() - {BATTERY, POSE_SPEED, TASK_PROC}  # RobotInfo says: no task
    assert not any(echoes[name].messages for name in others)


# Topics with large pushes: the chassis is asked for them only while somebody listens

ON_DEMAND = [topic for topic in TOPICS if topic.on_demand]
BUILD_MAP_DATA = "robot/BuildMapData"
PUSH = "woosh.robot.BuildMapData"


def echo_on_demand(client: Client, simulator: SimulatorThread) -> Collector:
    """Subscribe to the topic, and wait until the agent has subscribed at the chassis."""
    collector = client.echo(BuildMapDataMsg, BUILD_MAP_DATA)
    wait_until(lambda: PUSH in subscribed(simulator), "the subscription at the chassis")
    return collector


def stop_listening(client: Client) -> None:
    for subscription in list(client.node.subscriptions):
        if subscription.topic_name == client.path(BUILD_MAP_DATA):
            client.unsubscribe(subscription)


def test_the_chassis_is_asked_until_the_last_subscriber_leaves_and_again_on_a_new_link(
    robot: Robot,
) -> None:
    """test_each_push_is_published_once_and_in_order subscribes to each of these topics."""
    robot.chassis.wait_received("woosh.Subscription")
    assert not {topic.push for topic in ON_DEMAND} & subscribed(robot.chassis)
    first = echo_on_demand(robot, robot.chassis)
    second = robot.echo(BuildMapDataMsg, BUILD_MAP_DATA)
    wait_until(lambda: robot.node.count_subscribers(robot.path(BUILD_MAP_DATA)) == 2)
    robot.chassis.push(BuildMapData(width=1))
    for collector in (first, second):
        collector.wait(lambda m: m.width == 1)
    stop_listening(robot)
    wait_until(lambda: PUSH not in subscribed(robot.chassis), "the end of the subscription")
    late = echo_on_demand(robot, robot.chassis)
    assert late.wait_count(1)[0].width == 1, "the last value is kept"
    robot.chassis.drop()
    robot.agent.wait_connected(2)
    last = [each for each in robot.chassis.received if each.type == "woosh.Subscription"][-1]
    assert PUSH in last.message.topics
    robot.chassis.push(BuildMapData(width=2))
    late.wait(lambda m: m.width == 2)


# AgentInfo, which says if the agent has a link


def test_agent_info_follows_the_link_and_late_subscribers_get_it(
    start_agent: Callable[..., RunningAgent], simulator: SimulatorThread, client: Client
) -> None:
    simulator.stop_listening()
    address = {"ip": "127.0.0.1", "port": simulator.port, "backoff_min": 0.1}
    agent = start_agent(**address, disabled_parts=["connected"])
    early = client.echo(AgentInfo, AGENT_INFO.name)
    assert [m.online for m in early.wait_count(1)] == [False]
    simulator.listen()
    early.wait_count(2)
    simulator.stop_listening()
    simulator.drop()
    early.wait_count(3)
    assert not client.echo(AgentInfo, AGENT_INFO.name).wait_count(1)[0].online
    simulator.listen()
    early.wait_count(4)
    agent.close()
    assert [m.online for m in early.wait_count(5)] == [False, True, False, True, False]


# Bursts of status codes

FIRST = 110301000042
COUNT = 308
"""Number of codes in the greatest burst that a real robot has sent within a second."""


def test_every_code_of_a_burst_arrives_in_order(robot: Robot) -> None:
    """At each subscriber that keeps up."""
    sent: list[tuple[int, int]] = []

    def record(frame: Any) -> list[Any]:
        if isinstance(frame.body, StatusCode) and not frame.is_answer:
            sent.append((frame.body.code, frame.body.time))
        return [frame]

    robot.chassis.intercept(record)
    codes = robot.echo(StatusCodeMsg, "robot/StatusCode", depth=1000)
    robot.chassis.push(StatusCode(code=FIRST))  # the publisher keeps it for late subscribers
    codes.wait(lambda each: each.code == FIRST)  # now it has discovered this one
    for burst in range(1, 3):
        robot.chassis.inject("code_burst", count=COUNT, rate=0)
        codes.wait_count(1 + burst * COUNT)
    assert [(each.code, each.time) for each in codes.messages] == sent
    assert len({code for code, _ in sent}) < 10  # the same ones again and again
