"""Tests of the node with a simulated robot, without mocks, sleeps or fixed ports."""

from collections.abc import Iterator

import pytest
import rclpy
from park_when_low import ParkWhenLow

from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.testing import RunningAgent, spinning, wait_until


@pytest.fixture
def node(woosh_agent: RunningAgent) -> Iterator[ParkWhenLow]:
    """The node under test, in the ROS domain of the agent."""
    rclpy.init()
    node = ParkWhenLow()
    with spinning(node):
        yield node
    node.destroy_node()
    rclpy.shutdown()


def set_battery(chassis: SimulatorThread, percent: float) -> None:
    chassis.call(lambda simulator: setattr(simulator.chassis.battery, "level", percent))


@pytest.mark.woosh_chassis(speed=50)
def test_parks_when_the_battery_is_low(
    simulated_chassis: SimulatorThread, node: ParkWhenLow
) -> None:
    set_battery(simulated_chassis, 15.0)
    assert wait_until(lambda: node.outcome) == "parked"
    assert simulated_chassis.state.pose.distance((10.5, -8.5)) < 0.1


def test_reports_why_it_does_not_park(
    simulated_chassis: SimulatorThread, node: ParkWhenLow
) -> None:
    simulated_chassis.set_emergency_stop(True)
    set_battery(simulated_chassis, 15.0)
    assert "emergency stop" in wait_until(lambda: node.outcome)


def test_parks_although_the_link_is_lost(
    simulated_chassis: SimulatorThread, woosh_agent: RunningAgent, node: ParkWhenLow
) -> None:
    set_battery(simulated_chassis, 15.0)
    simulated_chassis.wait_received("woosh.robot.ExecTask", timeout=15)
    simulated_chassis.drop()
    woosh_agent.wait_connected(2)
    assert wait_until(lambda: node.outcome) == "parked"
