"""Nav2's interfaces as a whole: what there is, and when they are off or not possible."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable

import pytest
from rcl_interfaces.srv import GetParameters
from std_srvs.srv import Trigger

from tests.harness import HUMBLE, Client, RunningAgent, wait_until
from tests.node.goals import slow_down
from tests.node.nav2.goals import Nav2Client, go
from woosh_robot_agent.ros.standard_endpoints import NAV2, Kind
from woosh_robot_agent.simulator import SimulatorThread

nav2_actions = pytest.importorskip("nav2_msgs.action")
nav2_services = pytest.importorskip("nav2_msgs.srv")


def services(client: Client) -> dict[str, str]:
    """Return the services of the agent, with their types."""
    prefix = f"{client.namespace}/"
    return {
        name.removeprefix(prefix): types[0].replace("/srv/", "/").replace("/action/", "/")
        for name, types in client.node.get_service_names_and_types()
        if name.startswith(prefix)
    }


def test_there_is_everything_in_the_table(client: Client, agent: RunningAgent) -> None:
    wait_until(lambda: "map_server/load_map" in services(client), "the services")
    found = services(client)

    def topics() -> dict[str, list[str]]:
        return dict(client.node.get_topic_names_and_types())

    for each in NAV2:
        package, _, name = each.type.partition("/")
        if each.kind is Kind.ACTION:
            there = f"{each.name}/_action/send_goal" in found
            assert there is hasattr(nav2_actions, name), each.name
        elif "service" in each.kind.value:
            there = package != "nav2_msgs" or hasattr(nav2_services, name)
            assert found.get(each.name) == (each.type if there else None), each.name
        else:
            wait_until(lambda: client.path(each.name) in topics(), each.name)  # noqa: B023
            assert topics()[client.path(each.name)] == [f"{package}/msg/{name}"]


def test_there_are_the_definitions_that_basic_navigator_imports() -> None:
    """They are those of this repository if ROS has none."""
    actions, services = ["FollowPath", "SmoothPath"], ["ClearEntireCostmap", "GetCostmap"]
    if not HUMBLE:
        actions.append("FollowGPSWaypoints")
        services += ["ClearCostmapAroundRobot", "ClearCostmapExceptRegion"]
    if os.environ["ROS_DISTRO"] == "kilted":
        actions += ["ComputeRoute", "ComputeAndTrackRoute"]
    assert [name for name in actions if not hasattr(nav2_actions, name)] == []
    assert [name for name in services if not hasattr(nav2_services, name)] == []


def test_it_is_off_by_default(client: Client, connect: Callable[..., RunningAgent]) -> None:
    connect()
    wait_until(lambda: "agent/get_parameters" in services(client), "the agent")
    client.wait_known(GetParameters, client.path("agent/get_parameters"))
    assert not {each.name for each in NAV2} & set(services(client))
    assert not [name for name in services(client) if "navigate" in name]


def test_without_its_definitions_there_is_one_clear_line(
    client: Client,
    connect: Callable[..., RunningAgent],
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(sys.modules, "nav2_msgs", None)
    connect(nav2=True)
    wait_until(lambda: "agent/get_parameters" in services(client), "the agent")
    assert not {each.name for each in NAV2} & set(services(client))
    said = capfd.readouterr().err
    assert said.count("nav2_msgs is not installed: apt install") == 1


def test_an_agent_that_observes_sends_no_goals(
    client: Client, simulator: SimulatorThread, connect: Callable[..., RunningAgent]
) -> None:
    connect(nav2=True, observe_only=True)
    for goal in (go(client, 1.0), Nav2Client(client, "spin", target_yaw=1.0)):
        goal.wait_aborted("only observes")
    assert simulator.counts["woosh.ros.CallAction"] == 0


def test_a_lost_link_aborts_a_goal(
    client: Client, simulator: SimulatorThread, connect: Callable[..., RunningAgent]
) -> None:
    connect(nav2=True, goal_link_timeout=0.2)
    slow_down(simulator)
    goal = go(client, 5.0)
    goal.feedback.wait(lambda _: True)
    simulator.inject("off")
    assert not client.call(Trigger, "stop").success
    goal.wait_aborted("the link was lost", "the robot may still be executing it")
