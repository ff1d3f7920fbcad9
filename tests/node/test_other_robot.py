"""Another robot: nothing that the former one reported is told as the new one's."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from geometry_msgs.msg import PolygonStamped
from nav_msgs.msg import OccupancyGrid, Odometry, Path
from rclpy.qos import QoSProfile
from sensor_msgs.msg import BatteryState, LaserScan
from std_msgs.msg import Bool
from tf2_msgs.msg import TFMessage

from tests.harness import Client, Collector, GoalClient, RunningAgent, wait_until
from tests.node.cmd_vel import Sender
from tests.node.goals import (
    ABORTED,
    COMPLETED,
    EXECUTING,
    SUCCEEDED,
    TASK_PROC,
    short_task,
    step,
    stop_time,
    task,
)
from tests.node.test_cancel import losing
from tests.node.test_parameters import change
from tests.node.test_services_queries import ask
from tests.node.test_states import diagnostics
from tests.node.test_topics import subscribed
from tests.node.test_twist import answers, drive, speeds
from tests.quick_chassis import set_speed
from woosh_robot_agent.convert import converter
from woosh_robot_agent.convert.mapping import class_of
from woosh_robot_agent.endpoints import QUERIES, TOPICS
from woosh_robot_agent.link.protos import message_type
from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode
from woosh_robot_agent.pb.robot.robot_pb2 import Battery, NavPath, TaskProc
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.testing import running_chassis
from woosh_robot_msgs.srv import RobotInfo, Speak

TWIST = "woosh.robot.Twist"
EXEC_TASK = "woosh.robot.ExecTask"
CALL_ACTION = "woosh.ros.CallAction"
ROBOT_INFO = "woosh.robot.RobotInfo"
FORMER, NEW = 30001, 30002
"""Ids, and serial numbers, of the two robots."""
NOWHERE = 1
"""A port at which nothing listens."""


@pytest.fixture
def other() -> Iterator[SimulatorThread]:
    """Another robot."""
    with running_chassis(robot_id=NEW, speed=20) as chassis:
        yield chassis


@pytest.fixture
def with_tf(simulator: SimulatorThread, start_agent: Callable[..., RunningAgent]) -> RunningAgent:
    agent = start_agent(ip="127.0.0.1", port=simulator.port, backoff_min=0.1, publish_tf=True)
    agent.wait_connected()
    return agent


def switch(client: Client, port: int) -> None:
    assert change(client, port=port) == (True, "")


def leave(client: Client) -> None:
    """Turn the agent to an address where there is no robot."""
    switch(client, NOWHERE)


def nav_path() -> NavPath:
    message = NavPath()
    message.path.poses.add(x=1.0)
    return message


def settled(client: Client) -> None:
    """Wait until messages that were latched for new subscriptions must have arrived."""
    client.echo(Bool, "connected").wait_count(1)
    diagnostics(client).wait_count(2)


def test_queries_without_a_link_do_not_answer_for_the_former_robot(
    agent: RunningAgent, client: Client
) -> None:
    for query in QUERIES:
        ask(client, query)
    leave(client)
    for query in QUERIES:
        value = ask(client, query)
        proto_class = message_type(query.request)
        assert converter(type(value), proto_class).to_proto(value) == proto_class(), query.name


def test_latched_topics_are_taken_back(
    agent: RunningAgent, client: Client, simulator: SimulatorThread
) -> None:
    simulator.push(StatusCode(code=7))
    simulator.push(TaskProc(robot_task_id=5))
    simulator.push(nav_path())
    topics = {topic.name: class_of(topic.msg, "msg") for topic in TOPICS}
    before = {name: client.echo(msg, name) for name, msg in topics.items()}
    wait_until(lambda: {topic.push for topic in TOPICS} <= subscribed(simulator))
    for topic in TOPICS:
        if topic.extra:  # without a first value
            simulator.push(message_type(topic.push)())
    for collector in before.values():
        collector.wait_count(1)
    leave(client)
    after = {name: client.echo(msg, name) for name, msg in topics.items()}
    settled(client)
    assert {name: c.messages for name, c in after.items() if c.messages} == {}


def test_latched_topics_tell_the_new_robot_to_old_and_new_subscribers(
    agent: RunningAgent, client: Client, other: SimulatorThread
) -> None:
    msg = class_of("woosh_robot_msgs/Battery", "msg")
    before = client.echo(msg, "robot/Battery")
    before.wait_count(1)
    other.push(Battery(power=11))
    switch(client, other.port)
    agent.wait_connected(2)
    before.wait_count(2)
    late = client.echo(msg, "robot/Battery")
    late.wait_count(1)
    other.push(Battery(power=12))
    for collector in (before, late):
        collector.wait(lambda m: m.power == 12)
    assert len(late.messages) == 2


def test_connected_is_false_at_once_and_true_with_the_new_robot(
    agent: RunningAgent, client: Client, other: SimulatorThread
) -> None:
    connected = client.echo(Bool, "connected")
    connected.wait(lambda m: m.data)
    switch(client, other.port)
    wait_until(lambda: [m.data for m in connected.messages] == [True, False, True])


def test_battery_plan_and_footprint_become_unknown(
    agent: RunningAgent, client: Client, simulator: SimulatorThread
) -> None:
    stop_time(simulator)
    batteries = client.echo(BatteryState, "battery_state")
    footprints = client.echo(PolygonStamped, "footprint")
    plans = client.echo(Path, "plan")
    batteries.wait_count(1)
    footprints.wait(lambda m: m.polygon.points)
    simulator.push(nav_path())
    plans.wait(lambda m: m.poses)
    leave(client)
    battery = batteries.wait(lambda m: math.isnan(m.percentage))
    assert battery.power_supply_status == BatteryState.POWER_SUPPLY_STATUS_UNKNOWN
    wait_until(lambda: not footprints.messages[-1].polygon.points)
    wait_until(lambda: not plans.messages[-1].poses)
    late = client.echo(BatteryState, "battery_state").wait_count(1)
    assert all(math.isnan(m.percentage) for m in late)
    assert not client.echo(Path, "plan").wait_count(1)[0].poses
    assert not client.echo(PolygonStamped, "footprint").wait_count(1)[0].polygon.points


def test_the_map_is_taken_back_and_that_of_the_new_robot_requested(
    agent: RunningAgent, client: Client, other: SimulatorThread
) -> None:
    grids = client.echo(OccupancyGrid, "map")
    grids.wait_count(1)
    leave(client)
    settled(client)  # DDS ends a publisher with event callbacks a little later
    late = client.echo(OccupancyGrid, "map")
    settled(client)
    assert late.messages == []
    switch(client, other.port)
    grids.wait_count(2)
    late.wait_count(1)
    assert other.counts["woosh.map.SceneData"] == 1


def test_odom_starts_anew(
    with_tf: RunningAgent, client: Client, simulator: SimulatorThread, other: SimulatorThread
) -> None:
    odoms = client.echo_with(Odometry, "odom", QoSProfile(depth=100))
    transforms = client.echo_with(TFMessage, "/tf", QoSProfile(depth=100))
    odoms.wait_count(1)
    assert short_task(client, 1.0).result()[0] == SUCCEEDED
    odoms.wait(lambda m: m.pose.pose.position.x > 0.5)
    switch(client, other.port)
    odoms.messages.clear()
    transforms.messages.clear()
    with_tf.wait_connected(2)
    pose = odoms.wait(lambda m: m.pose.pose.position.x < 0.1).pose.pose
    assert (pose.position.x, pose.position.y, pose.orientation.z) == (0.0, 0.0, 0.0)
    at = other.state.pose
    shift = (
        transforms.wait(lambda m: abs(m.transforms[0].transform.translation.x - at.x) < 0.01)
        .transforms[0]
        .transform.translation
    )
    assert (shift.x, shift.y) == pytest.approx((at.x, at.y), abs=0.01)


def test_odom_is_silent_until_the_new_robot_reports(agent: RunningAgent, client: Client) -> None:
    odoms = client.echo_with(Odometry, "odom", QoSProfile(depth=100))
    scans = client.echo_with(LaserScan, "scan", QoSProfile(depth=100))
    odoms.wait_count(1)
    scans.wait_count(1)
    leave(client)
    client.echo(Bool, "connected").wait(lambda m: not m.data)
    settled(client)
    odoms.messages.clear()
    scans.messages.clear()
    settled(client)
    assert (odoms.messages, scans.messages) == ([], [])


def test_the_pose_of_the_laser_is_taken_back_and_told_again(
    with_tf: RunningAgent, client: Client, other: SimulatorThread
) -> None:
    before = client.echo(TFMessage, "/tf_static")
    before.wait_count(1)
    leave(client)
    late = client.echo(TFMessage, "/tf_static")
    settled(client)
    assert late.messages == []
    switch(client, other.port)
    late.wait_count(1)
    before.wait_count(2)


def test_diagnostics_do_not_show_the_former_robot(
    agent: RunningAgent, client: Client, other: SimulatorThread
) -> None:
    seen = diagnostics(client)
    seen.wait(lambda m: m.status[0].hardware_id == str(FORMER))
    leave(client)
    gone = seen.wait(lambda m: not m.status[0].hardware_id)
    names = [f"woosh_robot/agent: {name}" for name in ("link", "agents")]
    assert [s.name for s in gone.status] == names
    assert {v.key: v.value for v in gone.status[0].values}["round trip"] == "unknown"
    switch(client, other.port)
    seen.wait(lambda m: m.status[0].hardware_id == str(NEW))


@pytest.mark.parametrize("start", [task, lambda client: step(client, 1.0)], ids=["task", "step"])
def test_open_goals_end_and_say_why(
    agent: RunningAgent,
    client: Client,
    simulator: SimulatorThread,
    other: SimulatorThread,
    start: Callable[[Client], GoalClient],
) -> None:
    stop_time(simulator)
    goal = start(client)
    wait_until(lambda: simulator.counts[EXEC_TASK] + simulator.counts[CALL_ACTION])
    switch(client, other.port)
    status, ret = goal.result()
    assert status == ABORTED
    assert "turned to another robot" in ret.msg
    assert simulator.counts["woosh.robot.ActionOrder"] == 0, "the task of the former robot goes on"


def test_an_accepted_goal_is_not_continued_by_reports_of_the_new_robot(
    agent: RunningAgent, client: Client, simulator: SimulatorThread, other: SimulatorThread
) -> None:
    set_speed(simulator, 1.0)
    goal = task(client, task_id=7)
    goal.feedback.wait(lambda fb: fb.state.value == EXECUTING)
    switch(client, other.port)
    agent.wait_connected(2)
    other.push(TaskProc(robot_task_id=7, state=7, msg="of the new robot"))
    status, ret = goal.result()
    assert (status, "may still be executing" in ret.msg) == (ABORTED, True), ret
    assert all(fb.msg != "of the new robot" for fb in goal.feedback.messages)


def test_a_goal_of_the_same_id_on_the_new_robot_succeeds(
    agent: RunningAgent, client: Client, other: SimulatorThread
) -> None:
    """The former robot's reports on the id must not count as those of an earlier goal."""
    assert short_task(client, 0.3, task_id=7).result()[0] == SUCCEEDED
    switch(client, other.port)
    agent.wait_connected(2)
    assert short_task(client, 0.3, task_id=7).result()[0] == SUCCEEDED
    assert other.counts[EXEC_TASK] == 1


def test_the_end_of_a_goal_is_found_in_the_history_of_a_robot_with_an_earlier_clock(
    agent: RunningAgent, client: Client
) -> None:
    """The time of the former robot's report on the id must not count."""
    assert short_task(client, 0.3, task_id=7).result()[0] == SUCCEEDED
    with running_chassis(robot_id=NEW, speed=20, profile="tr200", clock_offset=-9 * 3600.0) as late:
        late.intercept(losing(TASK_PROC, state=COMPLETED))
        switch(client, late.port)
        agent.wait_connected(2)
        status, ret = short_task(client, 0.3, task_id=7).result()
    assert status == SUCCEEDED, ret


def test_pending_commands_fail_and_name_the_former_address(
    agent: RunningAgent, client: Client, simulator: SimulatorThread
) -> None:
    simulator.mute("woosh.robot.Speak")
    pending = client.call_async(Speak, "robot/Speak")
    simulator.wait_received("woosh.robot.Speak")
    leave(client)
    (answer,) = answers([pending])
    assert not answer.ok
    assert f"lost the link to ws://127.0.0.1:{simulator.port}" in answer.msg
    assert "another robot" in answer.msg


class TestDriving:
    @pytest.fixture(autouse=True)
    def long_drive(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Let the robot count as driving for the whole test, even on a slow machine."""
        monkeypatch.setattr("woosh_robot_agent.motion.gate.DRIVING", 3600.0)

    @pytest.mark.parametrize("parameter", ["ip", "port", "robot_id"])
    def test_the_robot_that_is_left_gets_a_zero_and_the_new_one_nothing(
        self,
        agent: RunningAgent,
        client: Client,
        simulator: SimulatorThread,
        other: SimulatorThread,
        parameter: str,
    ) -> None:
        new = {"ip": "localhost", "port": other.port, "robot_id": 5}[parameter]
        answers([drive(client, 0.3)])
        assert change(client, **{parameter: new}) == (True, "")
        simulator.wait_received(TWIST, 2)
        agent.wait_connected(2)
        assert speeds(simulator) == [0.3, 0.0]
        agent.close()
        assert speeds(simulator) == [0.3, 0.0]
        assert speeds(other) == []

    def test_a_robot_that_stands_gets_none(
        self, agent: RunningAgent, client: Client, simulator: SimulatorThread
    ) -> None:
        answers([drive(client, 0.3), drive(client, 0.0)])
        leave(client)
        wait_until(lambda: simulator.connections == 0)
        assert speeds(simulator) == [0.3, 0.0]

    def test_a_robot_that_cannot_be_stopped_is_an_error(
        self,
        agent: RunningAgent,
        client: Client,
        simulator: SimulatorThread,
        logs: Collector,
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        monkeypatch.setattr("woosh_robot_agent.ros.node._ZERO_TIMEOUT", 3600.0)
        answers([drive(client, 0.3)])
        simulator.refuse(TWIST, "no speed control")
        leave(client)
        record = logs.wait(lambda r: r.levelname == "ERROR")
        assert (
            f"the robot at ws://127.0.0.1:{simulator.port} was not stopped" in record.getMessage()
        )
        assert "no speed control" in record.getMessage()

    def test_a_frozen_robot_does_not_keep_the_agent(
        self,
        agent: RunningAgent,
        client: Client,
        simulator: SimulatorThread,
        other: SimulatorThread,
        logs: Collector,
    ) -> None:
        answers([drive(client, 0.3)])
        simulator.inject("freeze")
        switch(client, other.port)
        agent.wait_connected(2)
        logs.wait(lambda r: r.levelname == "ERROR" and "was not stopped" in r.getMessage())
        assert client.call(RobotInfo, "robot/RobotInfo").info.genral.serial_number == NEW

    def test_while_the_zero_is_unanswered_nothing_of_the_former_robot_is_told(
        self, agent: RunningAgent, client: Client, simulator: SimulatorThread, monkeypatch: Any
    ) -> None:
        monkeypatch.setattr("woosh_robot_agent.ros.node._ZERO_TIMEOUT", 3600.0)
        batteries = client.echo(class_of("woosh_robot_msgs/Battery", "msg"), "robot/Battery")
        batteries.wait_count(1)
        answers([drive(client, 0.3)])
        simulator.mute(TWIST)
        leave(client)
        simulator.wait_received(TWIST, 2)
        simulator.push(Battery(power=11))
        assert client.call(RobotInfo, "robot/RobotInfo").info.genral.serial_number == 0
        assert not client.call(Speak, "robot/Speak").ok
        assert [m.power for m in batteries.messages if m.power == 11] == []
        simulator.drop()

    def test_a_stream_of_velocities_does_not_drive_the_new_robot(
        self,
        agent: RunningAgent,
        client: Client,
        simulator: SimulatorThread,
        other: SimulatorThread,
        logs: Collector,
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        monkeypatch.setattr("woosh_robot_agent.motion.velocity_driver._PAUSE", 3600.0)
        sender = Sender(client)
        sender.send(x=0.3)
        simulator.wait_received(TWIST)
        switch(client, other.port)
        agent.wait_connected(2)
        refusal = "the link turned to another robot; send a zero"
        wait_until(
            lambda: (
                sender.send(x=0.3)
                or any(refusal in record.getMessage() for record in logs.messages)
            ),
            refusal,
        )
        assert speeds(other) == []


def test_the_same_robot_over_another_encoding_is_not_forgotten(
    agent: RunningAgent, client: Client
) -> None:
    batteries = client.echo(class_of("woosh_robot_msgs/Battery", "msg"), "robot/Battery")
    batteries.wait_count(1)
    assert change(client, encoding="protobuf") == (True, "")
    agent.wait_connected(2)
    late = client.echo(class_of("woosh_robot_msgs/Battery", "msg"), "robot/Battery")
    assert late.wait_count(1)
    assert client.publishers("robot/Battery") == 1
