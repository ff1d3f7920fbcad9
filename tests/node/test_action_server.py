"""The protocol of ROS actions: ids, which goals a cancel means, states, and results."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from action_msgs.msg import GoalInfo, GoalStatus, GoalStatusArray
from action_msgs.srv import CancelGoal
from builtin_interfaces.msg import Time
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from unique_identifier_msgs.msg import UUID

from tests.harness import Client, Logs, Robot, RunningAgent, wait_future
from tests.node.goals import ABORTED, CANCELED, SUCCEEDED, hurry, step, step_goal, stop_time
from woosh_robot_agent.simulator import SimulatorThread
from woosh_ros_msgs.action import StepControl

NAME = "ros/StepControl"
EXECUTING = GoalStatus.STATUS_EXECUTING


def send(client: Client, number: int) -> Any:
    """Send a goal with a given id; return the response."""
    service = StepControl.Impl.SendGoalService
    request = service.Request(goal_id=UUID(uuid=[number] * 16), goal=step_goal(20.0))
    return wait_future(client.service(service, f"{NAME}/_action/send_goal").call_async(request))


def cancel(client: Client, number: int = 0, stamp: Any = None) -> tuple[int, list[int]]:
    """Request a cancel; return the code and the ids of the goals that are being cancelled."""
    info = GoalInfo(goal_id=UUID(uuid=[number] * 16))
    if stamp is not None:
        info.stamp = stamp
    response = client.call(CancelGoal, f"{NAME}/_action/cancel_goal", goal_info=info)
    return response.return_code, [goal.goal_id.uuid[0] for goal in response.goals_canceling]


def result(client: Client, number: int) -> int:
    """Wait for the result of a goal; return its status."""
    service = StepControl.Impl.GetResultService
    request = service.Request(goal_id=UUID(uuid=[number] * 16))
    future = client.service(service, f"{NAME}/_action/get_result").call_async(request)
    return int(wait_future(future).status)


def test_a_cancel_says_if_a_goal_is_unknown_or_has_ended_and_a_used_id_is_refused(
    robot: Robot,
) -> None:
    assert cancel(robot) == (CancelGoal.Response.ERROR_NONE, [])
    assert cancel(robot, 3) == (CancelGoal.Response.ERROR_UNKNOWN_GOAL_ID, [])
    assert result(robot, 3) == GoalStatus.STATUS_UNKNOWN
    hurry(robot.chassis)
    send(robot, 3)
    assert result(robot, 3) == SUCCEEDED
    assert cancel(robot, 3) == (CancelGoal.Response.ERROR_GOAL_TERMINATED, [])
    stop_time(robot.chassis)
    started = robot.chassis.counts["woosh.ros.CallAction"]
    assert send(robot, 1).accepted
    assert not send(robot, 1).accepted
    assert robot.chassis.counts["woosh.ros.CallAction"] <= started + 1
    assert cancel(robot, 1) == (CancelGoal.Response.ERROR_NONE, [1])
    assert result(robot, 1) == CANCELED
    assert not send(robot, 1).accepted


def test_a_goal_whose_client_cannot_be_told_is_not_executed(robot: Robot, logs: Logs) -> None:
    """Its client cannot get the response, as one that the agent has not discovered yet."""
    service = StepControl.Impl.SendGoalService
    other = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    client = robot.node.create_client(
        service, robot.path(f"{NAME}/_action/send_goal"), qos_profile=other
    )
    robot.wait_known(StepControl.Impl.GetResultService, robot.path(f"{NAME}/_action/get_result"))
    client.call_async(service.Request(goal_id=UUID(uuid=[1] * 16), goal=step_goal(20.0)))
    logs.wait_text(f"{NAME}: a goal is not executed", "send the goal again")
    assert send(robot, 2).accepted
    robot.chassis.wait_received("woosh.ros.CallAction")
    assert robot.chassis.counts["woosh.ros.CallAction"] == 1
    assert result(robot, 1) == GoalStatus.STATUS_UNKNOWN


def test_cancel_up_to_a_time_means_goals_accepted_until_then(robot: Robot) -> None:
    stop_time(robot.chassis)
    former = send(robot, 1)
    robot.chassis.wait_received("woosh.ros.CallAction", 1)
    send(robot, 2)
    code, canceling = cancel(robot, stamp=former.stamp)
    assert code == CancelGoal.Response.ERROR_NONE
    # the newer goal may have replaced the former one already
    assert canceling in ([1], [])
    assert result(robot, 1) in (CANCELED, ABORTED)
    assert cancel(robot, 2, former.stamp) == (CancelGoal.Response.ERROR_NONE, [2])
    assert result(robot, 2) == CANCELED


def test_cancel_up_to_a_time_means_goals_accepted_before_the_clock_was_set_back(
    connect: Callable[..., RunningAgent], simulator: SimulatorThread, client: Client
) -> None:
    connect(use_sim_time=True)
    stop_time(simulator)
    clock, now = client.publisher(Clock, "/clock"), Clock(clock=Time(sec=100))
    # a message is lost if the agent has not discovered the publisher yet
    client.in_executor(lambda: client.node.create_timer(0.1, lambda: clock.publish(now)))
    odom = client.echo_with(Odometry, "odom", QoSProfile(depth=10))
    odom.wait(lambda message: message.header.stamp.sec == 100)
    assert send(client, 1).stamp == Time(sec=100)
    assert cancel(client, stamp=Time(sec=90)) == (CancelGoal.Response.ERROR_NONE, [])
    now.clock.sec = 90
    odom.wait(lambda message: message.header.stamp.sec == 90)
    assert cancel(client, stamp=Time(sec=90)) == (CancelGoal.Response.ERROR_NONE, [1])
    assert result(client, 1) == CANCELED


def test_cancel_of_an_id_means_no_other_goal_although_simulated_time_is_0(
    connect: Callable[..., RunningAgent], simulator: SimulatorThread, client: Client
) -> None:
    connect(use_sim_time=True)  # without a clock, so all goals are accepted at the time 0
    stop_time(simulator)
    assert send(client, 1).stamp == Time()
    assert cancel(client, 2) == (CancelGoal.Response.ERROR_UNKNOWN_GOAL_ID, [])
    assert cancel(client, 1) == (CancelGoal.Response.ERROR_NONE, [1])
    assert result(client, 1) == CANCELED


def test_states_are_published_for_late_subscribers_too(robot: Robot) -> None:
    stop_time(robot.chassis)
    states = robot.echo(GoalStatusArray, f"{NAME}/_action/status")
    first = step(robot, 20.0)
    states.wait(lambda each: [goal.status for goal in each.status_list] == [EXECUTING])
    first.cancel()
    assert first.result()[0] == CANCELED
    second = step(robot, 20.0)
    late = robot.echo(GoalStatusArray, f"{NAME}/_action/status")
    late.wait(lambda each: [goal.status for goal in each.status_list] == [CANCELED, EXECUTING])
    second.cancel()
    late.wait(lambda each: [goal.status for goal in each.status_list] == [CANCELED, CANCELED])
