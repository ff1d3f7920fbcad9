"""Faults of the robot itself, and bursts of what it reports."""

from __future__ import annotations

import time

import pytest

from tests.simulator.sim_wait import wait_until
from tests.simulator.sim_wire import JsonClient, TcpClient, subscription
from woosh_robot_agent.simulator import SimulatorConfig, SimulatorThread

POSE_SPEED = "woosh.robot.PoseSpeed"
CODES = "woosh.robot.count.AbnormalCodes"
SCANNER = "woosh.robot.ScannerData"


def abnormal(client: JsonClient) -> list[str]:
    return [code["msg"] for code in client.ask(CODES)["scs"]]


def ahead(client: JsonClient) -> float:
    """What the laser sees straight ahead, in m."""
    ranges = client.ask(SCANNER)["ranges"]
    return float(ranges[len(ranges) // 2])


def test_emergency_stop(simulator: SimulatorThread, client: JsonClient) -> None:
    client.subscribe(CODES)
    fault = simulator.inject("emergency_stop")
    assert client.push(CODES)["scs"][0]["msg"] == "emergency stop pressed"
    assert "emergency stop" in client.refused("woosh.robot.Twist", {"linear": 0.2})
    fault.clear()
    assert client.push(CODES)["scs"] == []
    client.ask("woosh.robot.Twist", {"linear": 0.2})


def test_emergency_stop_ends_by_itself(simulator: SimulatorThread, client: JsonClient) -> None:
    begun = simulator.state.elapsed
    fault = simulator.inject("emergency_stop", for_=5)
    wait_until(lambda: not fault.active)
    assert simulator.state.elapsed >= begun + 5
    assert abnormal(client) == []


def test_a_button_that_was_pressed_before_stays_so(
    simulator: SimulatorThread, client: JsonClient
) -> None:
    simulator.set_emergency_stop(True)
    simulator.inject("emergency_stop")
    simulator.clear_faults()
    assert abnormal(client) == ["emergency stop pressed"]


def test_lost_localisation(simulator: SimulatorThread, client: JsonClient) -> None:
    client.subscribe(CODES)
    simulator.inject("lost_localisation")
    assert client.push(CODES)["scs"]
    assert "localisation" in client.refused("woosh.robot.ExecTask", {"markNo": "A2"})
    simulator.clear_faults()
    assert client.push(CODES)["scs"] == []


def test_lost_localisation_is_cured_by_a_client(
    simulator: SimulatorThread, client: JsonClient
) -> None:
    pose = client.ask(POSE_SPEED)["pose"]
    simulator.inject("lost_localisation")
    client.ask("woosh.robot.SetRobotPose", {"pose": pose})
    wait_until(lambda: abnormal(client) == [])
    simulator.clear_faults()
    assert abnormal(client) == []


def test_obstacle_ahead(simulator: SimulatorThread, client: JsonClient) -> None:
    free = ahead(client)
    far = simulator.inject("obstacle", ahead=1.5, radius=0.2)
    near = simulator.inject("obstacle", ahead=1.0, radius=0.2, for_=1000)
    # The laser sits 0.25 m in front of the base's centre.
    assert ahead(client) == pytest.approx(1.0 - 0.2 - 0.25, abs=0.05)
    near.clear()
    assert ahead(client) == pytest.approx(1.5 - 0.2 - 0.25, abs=0.05)
    far.clear()
    assert ahead(client) == pytest.approx(free, abs=0.05)
    assert simulator.call(lambda simulated: simulated.chassis.obstacles.names) == ()


def test_obstacle_at_a_place(simulator: SimulatorThread, client: JsonClient) -> None:
    pose = client.ask(POSE_SPEED)["pose"]
    simulator.inject("obstacle", x=pose["x"] + 3, y=pose["y"])
    walls = simulator.call(lambda simulated: simulated.chassis.obstacles.walls)
    assert min(wall.x1 for wall in walls) == pytest.approx(pose["x"] + 2.7, abs=0.02)
    simulator.call(lambda simulated: simulated.chassis.obstacles.clear())
    simulator.clear_faults()  # though it is gone already


def test_burst(simulator: SimulatorThread, client: JsonClient) -> None:
    client.subscribe(POSE_SPEED)
    fault = simulator.inject("burst")
    for _ in range(1000):
        client.push(POSE_SPEED)
    wait_until(lambda: not fault.active)
    assert client.taken(POSE_SPEED) == []
    assert fault.hits == 1000


@pytest.mark.parametrize("type_name", ["woosh.robot.TaskProc", "woosh.robot.count.StatusCode"])
def test_burst_of_events(simulator: SimulatorThread, client: JsonClient, type_name: str) -> None:
    client.subscribe(type_name)
    simulator.inject("burst", type=type_name, count=7)
    for _ in range(7):
        client.push(type_name)


def test_burst_spares_those_who_read() -> None:
    """Far more than may wait for one client; who does not read at all is dropped as always."""
    config = SimulatorConfig(port=0, tcp_port=0, max_outbox=100)
    with SimulatorThread(config) as simulator:
        quick, slow = TcpClient(simulator.tcp_port), TcpClient(simulator.tcp_port)
        for each in (quick, slow):
            each.send(subscription("woosh.robot.Scene"))
            assert each.request("woosh.robot.Mode").ok
        simulator.inject("burst", count=3000, type="woosh.robot.Scene")
        for _ in range(3000):
            assert quick.receive().type == "woosh.robot.Scene"
        assert quick.request("woosh.robot.Mode").ok
        quick.close()
        slow.close()


def test_burst_at_a_rate(simulator: SimulatorThread, client: JsonClient) -> None:
    client.subscribe(POSE_SPEED)
    begun = time.monotonic()
    simulator.inject("burst", count=11, rate=50)
    for _ in range(11):
        client.push(POSE_SPEED)
    assert time.monotonic() - begun >= 0.19


def test_burst_can_be_ended(simulator: SimulatorThread, client: JsonClient) -> None:
    client.subscribe(POSE_SPEED)
    fault = simulator.inject("burst", rate=0.1)
    client.push(POSE_SPEED)
    fault.clear()
    assert not fault.active
    assert fault.hits == 1
