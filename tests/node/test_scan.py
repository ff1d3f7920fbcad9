"""scan: requested on demand, as REP 117 requires, and consistent with the walls."""

from __future__ import annotations

import itertools
import math
import random
import time
from collections.abc import Callable
from typing import Any

import pytest
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import LaserScan
from tf2_msgs.msg import TFMessage

from tests.harness import wait_until
from woosh_robot_agent.pb.robot.robot_pb2 import ScannerData
from woosh_robot_agent.pb.util.common_pb2 import Vector3
from woosh_robot_agent.ros.standard import scan as scan_part
from woosh_robot_agent.simulator import Outgoing, SimulatorThread
from woosh_robot_agent.simulator.world.laser import Laser

SCANNER = "woosh.robot.ScannerData"


def scans(client: Any) -> Any:
    return client.echo_with(LaserScan, "scan", qos_profile_sensor_data)


def change_scans(simulator: SimulatorThread, change: Callable[[Any], None]) -> None:
    """Change each scan before the chassis sends it."""

    def intercept(frame: Outgoing) -> list[Outgoing]:
        if frame.request == SCANNER:
            change(frame.body)
        return [frame]

    simulator.intercept(intercept)


def test_no_stamp_is_before_the_beginning_of_simulated_time(connect, client):
    """rclcpp::Time refuses a negative stamp, which ends the node that reads it."""
    connect(use_sim_time=True)  # without a clock
    stamp = scans(client).wait_count(1)[0].header.stamp
    assert (stamp.sec, stamp.nanosec) == (0, 0)


def test_scan_is_requested_only_while_there_are_subscribers(simulator, agent, client):
    wait_until(lambda: client.publishers("scan"), "the agent")
    odom = client.echo_with(Odometry, "odom", QoSProfile(depth=100))
    odom.wait_count(10)  # meanwhile, five scans are due
    assert simulator.counts[SCANNER] == 0
    subscription = client.node.create_subscription(
        LaserScan, client.path("scan"), lambda _scan: None, qos_profile_sensor_data
    )
    simulator.wait_received(SCANNER, 3)
    client.unsubscribe(subscription)
    wait_until(lambda: not client.node.count_subscribers(client.path("scan")))
    seen = -1

    def quiet() -> bool:
        nonlocal seen
        before, seen = seen, simulator.counts[SCANNER]
        odom.wait_count(len(odom.messages) + 10)
        return simulator.counts[SCANNER] == before

    wait_until(quiet, "an end of the questions")


def test_a_slow_chassis_gets_one_request_at_a_time(simulator, start_agent, client):
    start_agent(ip="127.0.0.1", port=simulator.port, poll_timeout=600_000)
    simulator.inject("lose_answer", type=SCANNER, count=1)  # which does not end the requests
    requested = []

    def note(frame: Outgoing) -> list[Outgoing]:
        if frame.request == SCANNER:
            requested.append(time.monotonic())
        return [frame]

    simulator.intercept(note)
    simulator.delay(SCANNER, 0.3)
    scans(client).wait_count(3)  # 0.1 s is the period of scan_rate
    answered = list(requested)  # before the count, which goes on
    gaps = [after - before for before, after in itertools.pairwise(answered)]
    assert min(gaps) > 0.29
    assert simulator.counts[SCANNER] > len(answered)


def test_scan_shows_the_walls(simulator: SimulatorThread, agent, client):
    scan = scans(client).wait_count(1)[0]
    assert scan.header.frame_id == "laser"

    def truth(sim: Any) -> list[float]:
        exact = Laser(noise=0.0)
        chassis = sim.chassis
        return exact.scan(chassis.base.pose, chassis.map.walls, random.Random(1))

    walls = simulator.call(truth)
    assert len(scan.ranges) == len(walls) == 881
    for seen, wall in zip(scan.ranges, walls, strict=True):
        assert seen == wall or abs(seen - wall) < 0.02
    assert scan.angle_min + 880 * scan.angle_increment == pytest.approx(scan.angle_max, abs=1e-3)


def test_ranges_out_of_range_are_infinite(simulator, agent, client, logs):
    data = ScannerData(
        angle_min=-1.0,
        angle_max=1.0,
        angle_increment=0.4,
        range_min=0.1,
        range_max=10.0,
        ranges=[math.nan, math.inf, 0.0, 0.05, 5.0, 10.5],
    )

    change_scans(simulator, lambda scan: scan.CopyFrom(data))
    received = scans(client)
    scan = received.wait_count(1)[0]
    assert math.isnan(scan.ranges[0])
    assert list(scan.ranges[1:]) == pytest.approx([math.inf, math.inf, -math.inf, 5.0, math.inf])
    # without a maximum, all would become +inf, which means that nothing is in the way
    change_scans(simulator, lambda scan: scan.ClearField("range_max"))
    logs.wait_text("no scan, range_max is not above range_min: 0 and 0.1")
    simulator.wait_received(SCANNER, simulator.counts[SCANNER] + 3)
    assert all(each.range_max for each in received.messages)


def test_tf_has_the_pose_of_the_laser(simulator, start_agent, client, monkeypatch):
    monkeypatch.setattr(scan_part, "_RETRY_DELAY", 0.1)
    change_scans(simulator, lambda scan: scan.offset.CopyFrom(Vector3(x=0.1, y=0.2, z=0.3)))
    simulator.refuse(SCANNER, "the laser is being started")
    start_agent(ip="127.0.0.1", port=simulator.port, publish_tf=True, frame_prefix="a/")
    static = client.echo(TFMessage, "/tf_static")
    simulator.wait_received(SCANNER, 2)
    simulator.accept(SCANNER)
    (transform,) = static.wait_count(1)[0].transforms
    assert (transform.header.frame_id, transform.child_frame_id) == ("a/base_link", "a/laser")
    shift = transform.transform.translation
    assert (shift.x, shift.y, shift.z) == pytest.approx((0.1, 0.2, 0.3))
    assert transform.transform.rotation.w == 1.0
    asked = simulator.counts[SCANNER]
    odom = client.echo_with(Odometry, "odom", QoSProfile(depth=100))
    odom.wait_count(10)  # meanwhile, five scans are due
    assert simulator.counts[SCANNER] == asked, "one good answer is enough"


def test_the_pose_of_the_laser_is_not_requested_more_often_after_each_lost_link(
    simulator, start_agent, client, monkeypatch
):
    monkeypatch.setattr(scan_part, "_RETRY_DELAY", 3600.0)
    simulator.refuse(SCANNER, "the laser is broken")
    agent = start_agent(ip="127.0.0.1", port=simulator.port, publish_tf=True)
    simulator.wait_received(SCANNER, 1)
    simulator.drop()
    agent.wait_connected(2)
    client.echo_with(Odometry, "odom", QoSProfile(depth=100)).wait_count(10)
    assert simulator.counts[SCANNER] == 1


def test_tf_has_no_laser_if_the_chassis_does_not_report_its_pose(
    simulator, start_agent, client, logs
):
    """A refusal of the scan is logged once."""
    simulator.refuse(SCANNER, "the laser is broken")
    start_agent(ip="127.0.0.1", port=simulator.port, publish_tf=True)
    static = client.echo(TFMessage, "/tf_static")
    received = scans(client)
    simulator.wait_received(SCANNER, 3)
    assert len(logs.with_text("broken", "WARNING")) == 1
    change_scans(simulator, lambda scan: scan.ClearField("offset"))
    simulator.accept(SCANNER)
    received.wait_count(2)
    assert not static.messages
