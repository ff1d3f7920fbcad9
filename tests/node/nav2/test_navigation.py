"""navigate_to_pose, navigate_through_poses and follow_waypoints."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import pytest
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import PoseStamped
from std_srvs.srv import Trigger

from tests.harness import Client, Logs, Robot, RunningAgent, wait_until
from tests.node.goals import (
    CALL_ACTION,
    CANCEL,
    EXECUTING,
    START,
    Held,
    feedbacks,
    hurry,
    in_front,
    move_base,
    slow_down,
    stop_time,
    task,
    without_reports,
)
from tests.node.nav2.goals import (
    ABORTED,
    CANCELED,
    PREVENTIONS,
    SUCCEEDED,
    Nav2Client,
    ahead,
    error_code,
    go,
    pose,
    poses_field,
    stands,
)
from woosh_robot_agent.motion.requests import may_move
from woosh_robot_agent.pb.robot.robot_pb2 import NavPath
from woosh_robot_agent.pb.ros import action_pb2, ros_pack_pb2
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction
from woosh_robot_agent.pb.util.common_pb2 import Pose2D
from woosh_robot_agent.pb.util.navigation_pb2 import Path
from woosh_robot_agent.simulator import SimulatorThread

nav2_actions = pytest.importorskip("nav2_msgs.action")
pytestmark = pytest.mark.usefixtures("agent")

OUTSIDE = (1000.0, 1000.0)
"""A place outside of the map."""


def drives(simulator: SimulatorThread) -> list[int]:
    """Return what the chassis was commanded to do with MoveBase: 0 to cancel, 1 to execute."""
    return [
        int(each.message.move_base.action)
        for each in simulator.received
        if isinstance(each.message, CallAction) and each.message.HasField("move_base")
    ]


def distance_to(simulator: SimulatorThread, distance: float) -> float:
    """Return how far the robot is from a pose in front of its initial one, in metres."""
    x, y, theta = START
    here = simulator.state.pose
    return math.hypot(
        x + distance * math.cos(theta) - here.x, y + distance * math.sin(theta) - here.y
    )


def driving(
    client: Client, simulator: SimulatorThread, name: str = "navigate_to_pose", **fields: Any
) -> Nav2Client:
    """Start a goal, 5 m ahead by default, in real time, and wait until the robot drives."""
    slow_down(simulator)
    goal = Nav2Client(client, name, **(fields or {"pose": ahead(5.0)}))
    wait_until(lambda: not stands(simulator), "the robot drives")
    return goal


def test_the_robot_drives_to_the_pose(client: Client, simulator: SimulatorThread) -> None:
    goal = go(client, 1.0)
    status, result = goal.result()
    assert (status, error_code(result)) == (SUCCEEDED, 0)
    assert distance_to(simulator, 1.0) < 0.01
    assert drives(simulator) == [action_pb2.kExecute]


def test_feedback_falls_while_the_robot_drives(client: Client, simulator: SimulatorThread) -> None:
    slow_down(simulator)
    goal = go(client, 1.0)
    assert goal.result()[0] == SUCCEEDED
    feedback = goal.feedback.messages
    assert len(feedback) > 10
    rests = [each.distance_remaining for each in feedback]
    assert all(later < earlier + 0.001 for earlier, later in pairwise(rests))
    assert rests[0] == pytest.approx(1.0, abs=0.1)
    assert rests[-1] < 0.1
    times = [each.estimated_time_remaining for each in feedback]
    seconds = [each.sec + each.nanosec / 1e9 for each in times]
    assert all(later < earlier + 0.001 for earlier, later in pairwise(seconds))
    assert 1.0 < seconds[0] < 4.0
    assert feedback[-1].current_pose.header.frame_id == "map"
    assert feedback[-1].current_pose.pose.position.x > feedback[0].current_pose.pose.position.x
    assert feedback[-1].navigation_time.sec >= 1
    assert {each.number_of_recoveries for each in feedback} == {0}


def test_a_path_that_is_not_finite_does_not_end_the_drive(
    client: Client, simulator: SimulatorThread
) -> None:
    goal = driving(client, simulator)
    end = Pose2D(**in_front(5.0))
    simulator.push(NavPath(path=Path(poses=[end, Pose2D(x=math.nan), end])))
    goal.feedback.wait_count(len(goal.feedback.messages) + 5)
    hurry(simulator)
    assert goal.result()[0] == SUCCEEDED
    assert all(math.isfinite(each.distance_remaining) for each in goal.feedback.messages)


@pytest.mark.parametrize(
    ("name", "fields"),
    [
        ("navigate_to_pose", {"pose": ahead(5.0)}),
        ("follow_waypoints", {"poses": [ahead(5.0), ahead(1.0)]}),
    ],
)
def test_a_cancel_ends_cancelled_and_the_robot_stands(
    client: Client, simulator: SimulatorThread, name: str, fields: dict[str, Any]
) -> None:
    goal = driving(client, simulator, name, **fields)
    assert goal.cancel().goals_canceling
    status, result = goal.result()
    assert (status, error_code(result)) == (CANCELED, 0)
    assert stands(simulator)
    assert distance_to(simulator, 5.0) > 3.0
    assert drives(simulator) == [action_pb2.kExecute, action_pb2.kCancel]


def test_a_new_goal_replaces_the_running_one_without_a_stop(
    client: Client, simulator: SimulatorThread
) -> None:
    first = driving(client, simulator)
    second = go(client, 1.0)
    hurry(simulator)
    assert first.result()[0] == ABORTED
    assert second.result()[0] == SUCCEEDED
    assert drives(simulator) == [action_pb2.kExecute] * 2
    assert distance_to(simulator, 1.0) < 0.01


def test_goals_of_different_actions_replace_each_other(
    client: Client, simulator: SimulatorThread
) -> None:
    waypoints = driving(client, simulator, "follow_waypoints", poses=[ahead(4.0), ahead(1.0)])
    to_pose = go(client, 0.5)
    assert waypoints.result()[0] == ABORTED
    spin = Nav2Client(client, "spin", target_yaw=0.5)
    assert to_pose.result()[0] == ABORTED
    assert spin.result()[0] == SUCCEEDED
    assert drives(simulator) == [action_pb2.kExecute] * 2 + [action_pb2.kCancel]


def test_the_robot_stands_if_the_chassis_refuses_the_goal_that_replaces_another(
    client: Client, simulator: SimulatorThread
) -> None:
    first = driving(client, simulator)
    simulator.inject("refuse", type=CALL_ACTION, text="not there", count=1)
    go(client, 1.0).wait_aborted("not there")
    assert first.result()[0] == ABORTED
    assert stands(simulator)
    assert distance_to(simulator, 5.0) > 2.0


@pytest.mark.parametrize("both", [False, True], ids=["the new goal", "both goals"])
def test_a_cancel_does_not_wait_until_the_chassis_has_answered_the_goal(
    client: Client, simulator: SimulatorThread, both: bool
) -> None:
    """The goal replaces another one, and the chassis does not report the end of that either."""
    first = driving(client, simulator)
    simulator.intercept(without_reports)
    held = Held(simulator, CALL_ACTION)
    second = go(client, 4.0)
    wait_until(lambda: len(drives(simulator)) == 2, "the chassis gets both goals")
    if both:
        first.cancel()
    second.cancel()
    wait_until(
        lambda: action_pb2.kCancel in drives(simulator), "the chassis gets a cancel", timeout=6.0
    )
    held.release()
    assert second.result()[0] == CANCELED
    assert first.result()[0] == ABORTED


@pytest.mark.parametrize(
    ("cancel", "text"),
    [
        (lambda client, _: client.call(Trigger, "stop"), "cancelled by the service stop"),
        (lambda client, _: move_base(client, 0.0, CANCEL).result(), "cancelled by ros/MoveBase"),
        (
            lambda _, simulator: simulator.call(
                lambda sim: sim.chassis.actions.cancel("woosh.ros.action.MoveBase")
            ),
            "cancelled by the robot itself or another client of it",
        ),
    ],
    ids=["stop", "MoveBase", "another client"],
)
def test_a_cancel_of_others_is_explained(
    client: Client,
    simulator: SimulatorThread,
    cancel: Callable[[Client, SimulatorThread], Any],
    text: str,
) -> None:
    goal = driving(client, simulator)
    cancel(client, simulator)
    goal.wait_aborted(text)


def test_a_goal_of_the_agents_own_action_replaces_it(
    client: Client, simulator: SimulatorThread
) -> None:
    goal = driving(client, simulator)
    other = move_base(client, 1.0)
    goal.wait_aborted("newer goal")
    assert other.result()[0] == SUCCEEDED


def deploy(client: Client) -> None:
    """Switch the robot to deployment mode."""
    assert client.command("robot/SwitchWorkMode", mode=1).ok


@pytest.mark.parametrize(
    ("prevent", "reason"),
    [
        (lambda _, simulator: simulator.set_emergency_stop(True), "emergency stop"),
        (lambda _, simulator: simulator.set_key_switch(True), "manual mode"),
        (lambda client, _: deploy(client), "deployment mode"),
        (lambda _, simulator: simulator.lose_localisation(), "localisation"),
    ],
    ids=["emergency stop", "key switch", "deployment mode", "lost"],
)
def test_a_refusal_is_explained(
    client: Client,
    simulator: SimulatorThread,
    logs: Logs,
    prevent: Callable[[Client, SimulatorThread], None],
    reason: str,
) -> None:
    prevent(client, simulator)
    go(client, 1.0).wait_aborted(reason, code="UNKNOWN")
    logs.wait_text(reason)


def test_a_task_is_not_replaced(client: Client, simulator: SimulatorThread) -> None:
    """Neither one of the agent nor one of another program, such as the VDA 5050 connector."""
    slow_down(simulator)
    running = task(client, mark="A23", task_id=11)
    running.feedback.wait(lambda each: each.state.value == EXECUTING)
    go(client, 1.0).wait_aborted("task")
    assert not running.done
    running.cancel()


def test_all_goals_are_aborted_when_the_agent_stops(
    client: Client, simulator: SimulatorThread, agent: RunningAgent
) -> None:
    stop_time(simulator)
    goals = [
        Nav2Client(client, "follow_waypoints", poses=[ahead(4.0), ahead(1.0)]),
        Nav2Client(client, "wait", time=Duration(sec=100)),
    ]
    for goal in goals:
        goal.feedback.wait(lambda _: True)
    agent.close()
    for goal in goals:
        goal.wait_aborted("the agent is stopping")


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"x": math.nan}, "not finite"),
        ({"x": math.inf}, "not finite"),
        ({"x": 1e300}, "too large"),
    ],
)
def test_a_pose_that_is_none_is_refused(
    client: Client, simulator: SimulatorThread, logs: Logs, wrong: dict[str, float], text: str
) -> None:
    """What runs goes on."""
    stop_time(simulator)
    running = go(client, 5.0)
    wait_until(lambda: drives(simulator), "the robot gets the goal")
    target = ahead(1.0)
    for field, value in wrong.items():
        setattr(target.pose.position, field, value)
    assert text in Nav2Client(client, "navigate_to_pose", pose=target).refusal(logs)
    assert not running.done
    assert drives(simulator) == [action_pb2.kExecute]


def test_a_field_without_an_effect_is_said_once(client: Client, logs: Logs) -> None:
    for _ in range(2):
        assert go(client, 0.1, behavior_tree="tree.xml").result()[0] == SUCCEEDED
    said = logs.with_text("behavior_tree has no effect")
    assert len(said) == 1


def through_poses(client: Client, poses: list[Any]) -> Nav2Client:
    field = poses_field(nav2_actions.NavigateThroughPoses, "poses", poses)
    return Nav2Client(client, "navigate_through_poses", poses=field)


def test_the_robot_drives_through_poses(client: Client, simulator: SimulatorThread) -> None:
    goal = through_poses(client, [ahead(1.0), ahead(1.0, left=-1.0), ahead(2.0, left=-1.0)])
    status, result = goal.result()
    assert status == SUCCEEDED
    (command,) = [each.message for each in simulator.received if type(each.message) is CallAction]
    assert command.move_base.execution_mode == action_pb2.MoveBase.kOneByOne
    left = [each.number_of_poses_remaining for each in goal.feedback.messages]
    assert left == sorted(left, reverse=True)
    assert left[0] == 3
    if hasattr(result, "waypoint_statuses"):
        states = [each.waypoint_status for each in result.waypoint_statuses]
        assert states == [type(result.waypoint_statuses[0]).COMPLETED] * 3


def test_poses_outside_of_the_map_are_not_reached(client: Client) -> None:
    through_poses(client, [ahead(1.0), pose(*OUTSIDE)]).wait_aborted("no free path")


def test_a_refusal_that_may_be_due_to_the_number_of_poses_says_so(client: Client) -> None:
    through_poses(client, [ahead(n / 100) for n in range(201)]).wait_aborted(
        "the goal has 201 poses, which may be too many: send fewer"
    )


def test_no_poses_are_no_goal(client: Client) -> None:
    assert through_poses(client, []).result()[0] == ABORTED
    Nav2Client(client, "follow_waypoints", poses=[]).wait_aborted(code="NO_VALID_WAYPOINTS")


def missed(result: Any) -> list[int]:
    """Return the numbers of the missed waypoints, which are messages since Jazzy."""
    return [
        each
        if isinstance(each, int)
        else getattr(each, "waypoint_index", getattr(each, "index", None))
        for each in result.missed_waypoints
    ]


def test_waypoints_that_cannot_be_reached_are_missed(
    client: Client, simulator: SimulatorThread
) -> None:
    goal = Nav2Client(client, "follow_waypoints", poses=[ahead(0.5), pose(*OUTSIDE), ahead(1.0)])
    status, result = goal.result()
    assert (status, missed(result)) == (SUCCEEDED, [1])
    assert distance_to(simulator, 1.0) < 0.01
    assert goal.feedback.messages[-1].current_waypoint == 2


@pytest.mark.parametrize("fault", ["none", "half_open", "off"])
@pytest.mark.parametrize("prevention", PREVENTIONS)
def test_waypoints_end_when_something_stops_the_robot(
    client: Client, simulator: SimulatorThread, prevention: str, fault: str
) -> None:
    """Also if the robot could drive again by the time that the agent hears of it."""
    prevent, permit = PREVENTIONS[prevention]
    goal = driving(
        client, simulator, "follow_waypoints", poses=[ahead(4.0), ahead(1.0), ahead(2.0)]
    )
    injected = simulator.inject(fault) if fault != "none" else None
    prevent(simulator)
    permit(simulator)
    if injected is not None:
        injected.clear()
    assert missed(goal.wait_aborted(prevention)) == []
    assert drives(simulator) == [action_pb2.kExecute]
    wait_until(lambda: stands(simulator), "the robot stands")


def test_waypoints_end_when_one_was_reached_during_a_loss_of_the_link(
    client: Client, simulator: SimulatorThread
) -> None:
    """Nobody knows how long the robot has stood there, and what happened to it meanwhile."""
    goal = driving(client, simulator, "follow_waypoints", poses=[ahead(1.0), ahead(2.0)])
    injected = simulator.inject("off")
    hurry(simulator)
    wait_until(lambda: distance_to(simulator, 1.0) < 0.01, "the robot reaches the waypoint")
    wait_until(lambda: stands(simulator), "the robot stands")
    injected.clear()
    assert missed(goal.wait_aborted("waypoint 0 while the link")) == []
    assert drives(simulator) == [action_pb2.kExecute]


@pytest.mark.parametrize(
    ("report", "is_missed"),
    [
        ({"msg": "no free path to (1.00, 2.00): choose a goal on free floor"}, True),
        ({"code": 130101000011}, True),
        ({"code": 130101000022, "msg": "no way"}, True),  # another level than in the table
        ({"code": 130101000031}, False),  # the robot seems to be inside an obstacle
        ({"msg": "an obstacle stands in the way"}, False),
        ({"msg": "Request failed"}, False),
        ({}, False),
    ],
)
def test_a_waypoint_is_missed_only_for_its_pose(
    client: Client, simulator: SimulatorThread, report: dict[str, Any], is_missed: bool
) -> None:
    goal = driving(client, simulator, "follow_waypoints", poses=[ahead(4.0), ahead(0.3)])
    end = ros_pack_pb2.Feedback(
        action="woosh.ros.action.MoveBase", state=ros_pack_pb2.kRosFailure, **report
    )
    simulator.push(ros_pack_pb2.Feedbacks(fbs=[end]))
    status, result = goal.result()
    assert (status, missed(result)) == ((SUCCEEDED, [0]) if is_missed else (ABORTED, []))


def test_a_robot_that_accepts_no_tasks_misses_no_waypoints(
    client: Client, simulator: SimulatorThread
) -> None:
    simulator.set_key_switch(True)
    goal = Nav2Client(client, "follow_waypoints", poses=[ahead(1.0)] * 3)
    assert missed(goal.wait_aborted("manual")) == []


def test_a_frozen_chassis_is_no_standing_robot(client: Client, simulator: SimulatorThread) -> None:
    goal = driving(client, simulator)
    frozen = simulator.inject("freeze")
    goal.feedback.wait_count(len(goal.feedback.messages) + 12)  # no report for more than 1 s
    goal.cancel()
    frozen.clear()
    assert goal.result()[0] == CANCELED
    assert stands(simulator)


@pytest.mark.parametrize("place", [ahead(1.0, ""), pose(1e20, 0.0)], ids=["no frame", "far away"])
def test_a_pose_that_means_no_place_moves_nothing(
    client: Client, simulator: SimulatorThread, logs: Logs, place: PoseStamped
) -> None:
    goal = Nav2Client(client, "navigate_to_pose", pose=place)
    if place.header.frame_id:
        result = goal.wait_aborted()
        assert "report this" not in getattr(result, "error_msg", "")
    else:
        assert "has no frame" in goal.refusal(logs)
        assert not drives(simulator)
    assert stands(simulator)


def test_the_service_stop_ends_waypoints(client: Client, simulator: SimulatorThread) -> None:
    goal = driving(client, simulator, "follow_waypoints", poses=[ahead(4.0), ahead(1.0)])
    assert client.call(Trigger, "stop").success
    assert missed(goal.wait_aborted()) == []
    assert drives(simulator).count(action_pb2.kExecute) == 1
    wait_until(lambda: stands(simulator), "the robot stands")


@pytest.mark.parametrize("waits", ["a waypoint", "another goal"])
def test_after_the_service_stop_nothing_drives_that_waited_for_the_end_of_a_drive(
    robot: Robot, waits: str
) -> None:
    """However late the robot reports that end."""
    simulator = robot.chassis
    robot.set_motion_timing(hold=0.0, effect=0.1)
    goal = driving(robot, simulator, "follow_waypoints", poses=[ahead(4.0), ahead(1.0)])
    report_again = simulator.intercept(without_reports)
    if waits == "another goal":
        goal = Nav2Client(robot, "spin", target_yaw=1.0)
        wait_until(lambda: len(drives(simulator)) == 2, "the cancel of the drive")
    # the chassis refuses to cancel twice, and has not reported the end
    assert robot.call(Trigger, "stop").success == (waits == "a waypoint")
    report_again()
    simulator.push(feedbacks(ros_pack_pb2.kRosSuccess, action="woosh.ros.action.MoveBase"))
    goal.wait_aborted("cancelled by the service stop")
    assert [may_move(each.message) for each in simulator.received].count(True) == 1


@pytest.mark.skipif(
    "number_of_loops" not in nav2_actions.FollowWaypoints.Goal.get_fields_and_field_types(),
    reason="Humble has no loops",
)
def test_loops_of_waypoints(client: Client, simulator: SimulatorThread) -> None:
    goal = Nav2Client(
        client,
        "follow_waypoints",
        poses=[ahead(0.5), ahead(1.0)],
        number_of_loops=1,
        goal_index=1,
    )
    assert goal.result()[0] == SUCCEEDED
    targets = [
        round(math.hypot(each.x - START[0], each.y - START[1]), 3)
        for each in (
            received.message.move_base.target_pose
            for received in simulator.received
            if isinstance(received.message, CallAction)
        )
    ]
    assert targets == [1.0, 0.5, 1.0]
