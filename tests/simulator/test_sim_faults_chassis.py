"""Faults of the robot itself, and bursts of pushes."""

from __future__ import annotations

import time
from itertools import pairwise

import pytest

from tests.simulator.sim_wire import ConnectTcp, Json, JsonClient, pass_time, subscription
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.testing import wait_until

POSE_SPEED = "woosh.robot.PoseSpeed"
CODES = "woosh.robot.count.AbnormalCodes"
STATUS_CODE = "woosh.robot.count.StatusCode"
SCANNER = "woosh.robot.ScannerData"
EMERGENCY_STOP = "110201000013"
TASK = ("woosh.robot.ExecTask", {"taskId": 4, "type": 1, "markNo": "A23"})
STEP = {"stepControl": {"action": 1, "steps": [{"mode": 1, "value": 1.0, "speed": 0.2}]}}
LIFT = {"liftControl": {"action": 1, "executeMode": 1}}
CALL = "woosh.ros.CallAction"


def abnormal_codes(client: JsonClient) -> list[str]:
    return [code["code"] for code in client.ask(CODES)["scs"]]


def distance_ahead(client: JsonClient) -> float:
    """Return the distance that the laser measures straight ahead, in metres."""
    ranges = client.ask(SCANNER)["ranges"]
    return float(ranges[len(ranges) // 2])


def test_emergency_stop_ends_after_its_duration(client: JsonClient) -> None:
    begun = client.simulator.state.elapsed
    fault = client.simulator.inject("emergency_stop", for_=5)
    wait_until(lambda: not fault.active)
    assert client.simulator.state.elapsed >= begun + 5
    assert abnormal_codes(client) == []
    # A button that was pressed before stays pressed.
    client.simulator.set_emergency_stop(True)
    client.simulator.inject("emergency_stop")
    client.simulator.clear_faults()
    assert abnormal_codes(client) == [EMERGENCY_STOP]


def test_obstacle_ahead_is_seen_until_cleared(client: JsonClient) -> None:
    free = distance_ahead(client)
    far = client.simulator.inject("obstacle", ahead=1.5, radius=0.2)
    near = client.simulator.inject("obstacle", ahead=1.0, radius=0.2, for_=1000)
    # The laser sits 0.25 m in front of the base's centre.
    assert distance_ahead(client) == pytest.approx(1.0 - 0.2 - 0.25, abs=0.05)
    near.clear()
    assert distance_ahead(client) == pytest.approx(1.5 - 0.2 - 0.25, abs=0.05)
    far.clear()
    assert distance_ahead(client) == pytest.approx(free, abs=0.05)
    assert client.simulator.call(lambda simulated: simulated.chassis.obstacles.names) == ()


@pytest.mark.chassis(speed=1, max_outbox=100)
def test_burst_does_not_drop_clients_that_read(
    simulator: SimulatorThread, connect_tcp: ConnectTcp
) -> None:
    """The burst is far longer than a client's queue. A client that does not read may be dropped."""
    quick, slow = connect_tcp(), connect_tcp()
    for each in (quick, slow):
        each.send(subscription("woosh.robot.Scene"))
        assert each.request("woosh.robot.Mode").ok
    simulator.inject("burst", count=1000, type="woosh.robot.Scene")
    for _ in range(1000):
        assert quick.receive().type == "woosh.robot.Scene"
    assert quick.request("woosh.robot.Mode").ok


def test_burst_pushes_its_count_at_its_rate_until_it_is_cleared(client: JsonClient) -> None:
    client.subscribe(POSE_SPEED)
    begun = time.monotonic()
    fault = client.simulator.inject("burst", count=11, rate=50)
    for _ in range(11):
        client.next_push(POSE_SPEED)
    assert time.monotonic() - begun >= 0.19
    wait_until(lambda: not fault.active)
    assert client.take_pushes(POSE_SPEED) == []
    assert fault.hits == 11
    for kind in ("woosh.robot.TaskProc", STATUS_CODE):
        client.subscribe(kind)
        fault = client.simulator.inject("burst", type=kind, rate=0.1)
        client.next_push(kind)
        fault.clear()
        assert (fault.active, fault.hits) == (False, 1)


@pytest.mark.parametrize(
    ("name", "body"),
    [
        TASK,
        (CALL, STEP),
        (CALL, LIFT),
        ("woosh.robot.Twist", {"linear": 0.5, "angular": 0.5}),
        ("woosh.robot.Follow", {"type": True}),
    ],
)
def test_key_switch_may_accept_requests_and_not_move(
    client: JsonClient, name: str, body: Json
) -> None:
    client.simulator.call(lambda s: s.chassis.obstacles.put("leader", -3.0, 0.0, 0.2))
    before = client.simulator.state
    fault = client.simulator.inject("key_switch", requests="accepted")
    answer = client.request(name, body)
    assert (answer["ok"], answer["msg"]) == (True, "Request succeed")
    pass_time(client.simulator, 5.0)
    after = client.simulator.state
    assert (after.pose, after.jack) == (before.pose, before.jack)
    assert not after.velocity.speed
    if name == CALL:
        (feedback,) = client.ask("woosh.ros.Feedbacks")["fbs"]
        assert feedback["state"] == 2  # it executes, and nothing moves
    fault.clear()
    if body == STEP:  # it begins when the key is turned back
        wait_until(lambda: client.simulator.state.pose != before.pose)


def test_key_switch_that_accepts_stops_a_moving_robot(client: JsonClient) -> None:
    client.subscribe(POSE_SPEED)
    client.ask(*TASK)
    client.next_push(POSE_SPEED, lambda body: body["twist"]["linear"] > 0.3)
    client.simulator.set_key_switch(True, accept=True)
    pass_time(client.simulator, 0.2)
    stopped = client.simulator.state.pose
    pass_time(client.simulator, 5.0)
    assert client.simulator.state.pose == stopped
    assert client.ask("woosh.robot.TaskProc")["state"] == 3


def test_code_burst_repeats_codes_in_order(client: JsonClient) -> None:
    client.subscribe(STATUS_CODE)
    fault = client.simulator.inject("code_burst", count=150, rate=0)
    wait_until(lambda: not fault.active)
    pushed = client.take_pushes(STATUS_CODE)
    assert len(pushed) == 150
    codes = [body["code"] for body in pushed]
    assert 2 <= len(set(codes)) <= 10
    assert sum(a == b for a, b in pairwise(codes)) > 75
    times = [int(body["time"]) for body in pushed]
    assert times == sorted(times)
    # The robot keeps the last 50.
    assert client.ask("woosh.robot.count.StatusCodes")["scs"] == pushed[-50:]
    assert client.ask("woosh.robot.RobotInfo")["statusCodes"]["scs"] == pushed[-50:]
    assert client.ask(STATUS_CODE) == pushed[-1]
