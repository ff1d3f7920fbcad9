"""navigate_to_pose, navigate_through_poses and follow_waypoints."""

from __future__ import annotations

import math
import threading
import time
from itertools import pairwise
from typing import Any

import pytest
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Point
from std_srvs.srv import Trigger

from tests.asynchronous import TIMEOUT
from tests.harness import Logs, Robot, wait_until
from tests.node.goals import (
    CALL_ACTION,
    CANCEL,
    EXECUTING,
    START,
    Held,
    feedbacks,
    hurry,
    in_front,
    lift,
    move_base,
    replace_answers,
    slow_down,
    step,
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
    navigates,
    pose,
    poses_field,
    stands,
)
from tests.node.test_parameters import change
from woosh_robot_agent.motion.requests import may_move
from woosh_robot_agent.pb.robot.robot_pb2 import NavPath, Scene
from woosh_robot_agent.pb.ros import action_pb2, ros_pack_pb2
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction
from woosh_robot_agent.pb.util.common_pb2 import Pose2D
from woosh_robot_agent.pb.util.navigation_pb2 import Path
from woosh_robot_msgs.srv import Twist

nav2_actions = pytest.importorskip("nav2_msgs.action")

OUTSIDE = (1000.0, 1000.0)
"""A place outside of the map."""


def drives(robot: Robot) -> list[int]:
    """Return what the chassis was commanded to do with MoveBase: 0 to cancel, 1 to execute."""
    return [
        int(each.message.move_base.action)
        for each in robot.chassis.received
        if isinstance(each.message, CallAction) and each.message.HasField("move_base")
    ]


def distance_to(robot: Robot, distance: float) -> float:
    """Return how far the robot is from a pose in front of its initial one, in metres."""
    x, y, theta = START
    here = robot.chassis.state.pose
    return math.hypot(
        x + distance * math.cos(theta) - here.x, y + distance * math.sin(theta) - here.y
    )


def driving(robot: Robot, name: str = "navigate_to_pose", **fields: Any) -> Nav2Client:
    """Start a goal, 5 m ahead by default, in real time, and wait until the robot drives."""
    slow_down(robot.chassis)
    goal = Nav2Client(robot, name, **(fields or {"pose": ahead(5.0)}))
    wait_until(lambda: not stands(robot.chassis), "the robot drives")
    return goal


def test_the_robot_drives_to_the_pose_and_the_rest_in_the_feedback_falls(robot: Robot) -> None:
    slow_down(robot.chassis)
    goal = go(robot, 1.0)
    status, result = goal.result()
    assert (status, error_code(result)) == (SUCCEEDED, 0)
    assert distance_to(robot, 1.0) < 0.01
    assert drives(robot) == [action_pb2.kExecute]
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


def test_a_path_that_is_not_finite_does_not_end_the_drive(robot: Robot) -> None:
    goal = driving(robot)
    end = Pose2D(**in_front(5.0))
    robot.chassis.push(NavPath(path=Path(poses=[end, Pose2D(x=math.nan), end])))
    goal.feedback.wait_count(len(goal.feedback.messages) + 5)
    hurry(robot.chassis)
    assert goal.result()[0] == SUCCEEDED
    assert all(math.isfinite(each.distance_remaining) for each in goal.feedback.messages)


def test_a_cancel_ends_cancelled_and_the_robot_stands(robot: Robot) -> None:
    """`test_a_frozen_chassis_is_no_standing_robot` cancels navigate_to_pose."""
    goal = driving(robot, "follow_waypoints", poses=[ahead(5.0), ahead(1.0)])
    assert goal.cancel().goals_canceling
    status, result = goal.result()
    assert (status, error_code(result)) == (CANCELED, 0)
    assert stands(robot.chassis)
    assert distance_to(robot, 5.0) > 3.0
    assert drives(robot) == [action_pb2.kExecute, action_pb2.kCancel]


def test_a_new_goal_of_any_action_replaces_the_running_one(robot: Robot) -> None:
    """Without a stop if the new one navigates, too."""
    first = driving(robot)
    second = go(robot, 4.0)
    assert first.result()[0] == ABORTED
    waypoints = Nav2Client(robot, "follow_waypoints", poses=[ahead(4.0), ahead(1.0)])
    assert second.result()[0] == ABORTED
    wait_until(lambda: len(drives(robot)) == 3, "the first waypoint")
    assert drives(robot) == [action_pb2.kExecute] * 3
    spin = Nav2Client(robot, "spin", target_yaw=0.5)
    assert waypoints.result()[0] == ABORTED
    assert spin.result()[0] == SUCCEEDED
    assert drives(robot) == [action_pb2.kExecute] * 3 + [action_pb2.kCancel]
    last = driving(robot)
    of_the_agents_own_action = move_base(robot, 1.0)
    last.wait_aborted("newer goal")
    hurry(robot.chassis)
    assert of_the_agents_own_action.result()[0] == SUCCEEDED


def test_the_robot_stands_if_the_chassis_refuses_the_goal_that_replaces_another(
    robot: Robot,
) -> None:
    first = driving(robot)
    robot.chassis.inject("refuse", type=CALL_ACTION, text="not there", count=1)
    go(robot, 1.0).wait_aborted("not there")
    assert first.result()[0] == ABORTED
    assert stands(robot.chassis)
    assert distance_to(robot, 5.0) > 2.0


@pytest.mark.parametrize("both", [False, True], ids=["the new goal", "both goals"])
def test_a_cancel_does_not_wait_until_the_chassis_has_answered_the_goal(
    robot: Robot, both: bool
) -> None:
    """The goal replaces another one, and the chassis does not report the end of that either."""
    first = driving(robot)
    robot.chassis.intercept(without_reports)
    held = Held(robot.chassis, CALL_ACTION)
    second = go(robot, 4.0)
    wait_until(lambda: len(drives(robot)) == 2, "the chassis gets both goals")
    if both:
        first.cancel()
    second.cancel()
    wait_until(
        lambda: action_pb2.kCancel in drives(robot), "the chassis gets a cancel", timeout=6.0
    )
    held.release()
    assert second.result()[0] == CANCELED
    assert first.result()[0] == ABORTED


def test_a_cancel_of_others_is_explained(robot: Robot) -> None:
    goal = driving(robot)
    move_base(robot, 0.0, CANCEL).result()
    goal.wait_aborted("cancelled by ros/MoveBase")
    goal = driving(robot)
    wait_until(lambda: navigates(robot), "the robot may still have rolled before")
    lift(robot, action=CANCEL).result()  # of another action
    robot.chassis.call(lambda sim: sim.chassis.actions.cancel("woosh.ros.action.MoveBase"))
    goal.wait_aborted("cancelled by the robot itself or another client of it")
    goal = driving(robot)
    wait_until(lambda: navigates(robot), "the robot may still have rolled before")
    step(robot, 1.0)
    goal.wait_aborted("cancelled by ros/StepControl")


def test_a_pause_by_a_zero_is_told(robot: Robot, logs: Logs) -> None:
    goal = driving(robot)
    assert robot.call(Twist, "robot/Twist").ok
    logs.wait_text("navigate_to_pose: the robot has paused", "resume it by ros/MoveBase")
    goal.cancel()
    assert goal.result()[0] == CANCELED


@pytest.mark.parametrize("first", ["navigate_to_pose", "spin"])
def test_a_goal_that_comes_without_a_link_moves_nothing_later(robot: Robot, first: str) -> None:
    goals = {"navigate_to_pose": {"pose": ahead(2.0)}, "spin": {"target_yaw": 6.0}}
    running = driving(robot, first, **goals.pop(first))
    switched_off = robot.chassis.inject("off")
    robot.wait_lost()
    [(name, fields)] = goals.items()
    Nav2Client(robot, name, **fields).wait_aborted("no link")
    hurry(robot.chassis)
    switched_off.clear()
    assert running.result()[0] == SUCCEEDED
    assert robot.chassis.counts[CALL_ACTION] == 1


def test_a_goal_that_waits_for_another_ends_with_the_link(robot: Robot) -> None:
    driving(robot)
    report_again = robot.chassis.intercept(without_reports)
    spin = Nav2Client(robot, "spin", target_yaw=1.0)
    wait_until(lambda: len(drives(robot)) == 2, "the cancel of the drive")
    switched_off = robot.chassis.inject("off")
    spin.wait_aborted("no link")
    report_again()
    switched_off.clear()


def test_the_places_of_a_goal_are_those_of_the_map_that_the_robot_used(robot: Robot) -> None:
    goal = driving(robot, "follow_waypoints", poses=[ahead(1.0), ahead(2.0)])
    robot.chassis.push(Scene(scene_name="factory", map_name="floor 2"))
    hurry(robot.chassis)
    goal.wait_aborted("the robot now uses the map floor 2")
    assert drives(robot) == [action_pb2.kExecute]


def test_no_next_waypoint_is_driven_to_after_an_emergency_stop(robot: Robot) -> None:
    """Even if the waypoint was reached, and the button released, before the agent heard of it."""
    goal = driving(robot, "follow_waypoints", poses=[ahead(1.0), ahead(2.0)])
    stalled = robot.chassis.inject("half_open")
    hurry(robot.chassis)
    wait_until(lambda: not navigates(robot), "the first waypoint")
    robot.chassis.set_emergency_stop(True)
    robot.chassis.set_emergency_stop(False)
    stalled.clear()
    goal.wait_aborted("emergency stop")
    assert drives(robot) == [action_pb2.kExecute]


def test_a_refusal_is_explained(robot: Robot, logs: Logs) -> None:
    """A task of the agent or of another program, such as the VDA 5050 connector, goes on."""
    slow_down(robot.chassis)
    running = task(robot, mark="A23", task_id=11)
    running.feedback.wait(lambda each: each.state.value == EXECUTING)
    go(robot, 1.0).wait_aborted("task", code="UNKNOWN")
    assert not running.done
    running.cancel()
    running.result()
    robot.chassis.set_emergency_stop(True)
    goal = Nav2Client(robot, "follow_waypoints", poses=[ahead(1.0)] * 3)
    assert missed(goal.wait_aborted("emergency stop")) == []
    logs.wait_text("follow_waypoints: the goal is aborted", "emergency stop")


def test_all_goals_are_aborted_when_the_agent_stops(own_robot: Robot) -> None:
    robot = own_robot
    stop_time(robot.chassis)
    goals = [
        Nav2Client(robot, "follow_waypoints", poses=[ahead(4.0), ahead(1.0)]),
        Nav2Client(robot, "wait", time=Duration(sec=100)),
    ]
    for goal in goals:
        goal.feedback.wait(lambda _: True)
    robot.agent.close()
    for goal in goals:
        goal.wait_aborted("the agent is stopping")


def test_a_pose_that_is_none_is_refused(robot: Robot, logs: Logs) -> None:
    """What runs goes on."""
    stop_time(robot.chassis)
    running = go(robot, 5.0)
    wait_until(lambda: drives(robot), "the robot gets the goal")
    for x, text in ((math.nan, "not finite"), (1e300, "too large")):
        assert text in Nav2Client(robot, "navigate_to_pose", pose=pose(x, 0.0)).refusal(logs)
    assert "has no frame" in Nav2Client(
        robot, "navigate_to_pose", pose=ahead(1.0, frame="")
    ).refusal(logs)
    assert not running.done
    assert drives(robot) == [action_pb2.kExecute]


def through_poses(robot: Robot, poses: list[Any]) -> Nav2Client:
    field = poses_field(nav2_actions.NavigateThroughPoses, "poses", poses)
    return Nav2Client(robot, "navigate_through_poses", poses=field)


def test_the_robot_drives_through_poses(robot: Robot) -> None:
    goal = through_poses(robot, [ahead(1.0), ahead(1.0, left=-1.0), ahead(2.0, left=-1.0)])
    status, result = goal.result()
    assert status == SUCCEEDED
    (command,) = [
        each.message for each in robot.chassis.received if type(each.message) is CallAction
    ]
    assert command.move_base.execution_mode == action_pb2.MoveBase.kOneByOne
    left = [each.number_of_poses_remaining for each in goal.feedback.messages]
    assert left == sorted(left, reverse=True)
    assert left[0] == 3
    if hasattr(result, "waypoint_statuses"):
        states = [each.waypoint_status for each in result.waypoint_statuses]
        assert states == [type(result.waypoint_statuses[0]).COMPLETED] * 3


def test_poses_that_the_robot_cannot_reach(robot: Robot) -> None:
    through_poses(robot, [ahead(1.0), pose(*OUTSIDE)]).wait_aborted("no free path")
    result = Nav2Client(robot, "navigate_to_pose", pose=pose(1e20, 0.0)).wait_aborted()
    assert "report this" not in getattr(result, "error_msg", "")
    through_poses(robot, [ahead(n / 100) for n in range(201)]).wait_aborted(
        "the goal has 201 poses, which may be too many: send fewer"
    )
    assert stands(robot.chassis)


def test_what_runs_goes_on_after_a_goal_that_cannot_be_executed(robot: Robot) -> None:
    running = driving(robot)
    through_poses(robot, []).wait_aborted("give at least one")
    Nav2Client(robot, "follow_waypoints", poses=[]).wait_aborted(code="NO_VALID_WAYPOINTS")
    for name, target in (("drive_on_heading", Point(x=-0.3)), ("backup", Point(y=0.1))):
        step = Nav2Client(robot, name, target=target, speed=0.2)
        step.wait_aborted(code="INVALID_INPUT")
    hurry(robot.chassis)
    assert running.result()[0] == SUCCEEDED
    assert drives(robot) == [action_pb2.kExecute]


def missed(result: Any) -> list[int]:
    """Return the numbers of the missed waypoints, which are messages since Jazzy."""
    return [
        each
        if isinstance(each, int)
        else getattr(each, "waypoint_index", getattr(each, "index", None))
        for each in result.missed_waypoints
    ]


def test_waypoints_that_cannot_be_reached_are_missed(robot: Robot) -> None:
    goal = Nav2Client(robot, "follow_waypoints", poses=[ahead(0.5), pose(*OUTSIDE), ahead(1.0)])
    status, result = goal.result()
    assert (status, missed(result)) == (SUCCEEDED, [1])
    assert distance_to(robot, 1.0) < 0.01
    assert goal.feedback.messages[-1].current_waypoint == 2


@pytest.mark.parametrize(
    ("prevention", "fault"),
    [("emergency stop", "none"), ("key switch", "half_open"), ("localisation", "off")],
)
def test_waypoints_end_when_something_stops_the_robot(
    robot: Robot, prevention: str, fault: str
) -> None:
    """Also if the robot could drive again by the time that the agent hears of it."""
    prevent, permit = PREVENTIONS[prevention]
    goal = driving(robot, "follow_waypoints", poses=[ahead(4.0), ahead(1.0), ahead(2.0)])
    injected = robot.chassis.inject(fault) if fault != "none" else None
    prevent(robot.chassis)
    permit(robot.chassis)
    if injected is not None:
        injected.clear()
    assert missed(goal.wait_aborted(prevention)) == []
    assert drives(robot) == [action_pb2.kExecute]
    wait_until(lambda: stands(robot.chassis), "the robot stands")


def test_waypoints_end_when_one_was_reached_during_a_loss_of_the_link(robot: Robot) -> None:
    """Nobody knows how long the robot has stood there, and what happened to it meanwhile."""
    goal = driving(robot, "follow_waypoints", poses=[ahead(1.0), ahead(2.0)])
    injected = robot.chassis.inject("off")
    hurry(robot.chassis)
    wait_until(lambda: distance_to(robot, 1.0) < 0.01, "the robot reaches the waypoint")
    wait_until(lambda: stands(robot.chassis), "the robot stands")
    injected.clear()
    assert missed(goal.wait_aborted("waypoint 0 while the link")) == []
    assert drives(robot) == [action_pb2.kExecute]


def test_a_navigation_that_its_replacement_could_not_cancel_says_so(own_robot: Robot) -> None:
    robot = own_robot
    assert change(robot, goal_link_timeout=0.2) == (True, "")
    robot.set_goal_timing(min_cancel_timeout=0.5)
    slow_down(robot.chassis)
    goal = driving(robot, "navigate_to_pose", pose=ahead(5.0))
    replace_answers(robot.chassis, "woosh.ros.CallAction", ok=True)  # it has no effect
    Nav2Client(robot, "spin", target_yaw=1.0)
    goal.wait_aborted("the robot may still be executing it")


def test_waypoints_end_when_one_was_reached_while_the_agent_stood_still(own_robot: Robot) -> None:
    robot = own_robot  # because an agent that stood still refuses goals for a moment
    goal = driving(robot, "follow_waypoints", poses=[ahead(1.0), ahead(2.0)])
    # a slow machine may need more than the usual time to handle the end of the drive
    robot.set_motion_timing(stall=0.5, settle=TIMEOUT)
    resumed = threading.Event()
    robot.agent.agent.robot.thread.call(resumed.wait, TIMEOUT)
    hurry(robot.chassis)
    wait_until(lambda: distance_to(robot, 1.0) < 0.01, "the robot reaches the waypoint")
    time.sleep(1.0)
    resumed.set()
    assert missed(goal.wait_aborted("the agent stood still")) == []
    assert drives(robot) == [action_pb2.kExecute]


@pytest.mark.parametrize(
    ("report", "is_missed"),
    [
        ({"msg": "no free path to (1.00, 2.00): choose a goal on free floor"}, True),
        ({"code": 130101000022, "msg": "no way"}, True),  # another level than in the table
        ({"code": 130101000031}, False),  # the robot seems to be inside an obstacle
        ({}, False),
    ],
)
def test_a_waypoint_is_missed_only_for_its_pose(
    robot: Robot, report: dict[str, Any], is_missed: bool
) -> None:
    goal = driving(robot, "follow_waypoints", poses=[ahead(4.0), ahead(0.3)])
    end = ros_pack_pb2.Feedback(
        action="woosh.ros.action.MoveBase", state=ros_pack_pb2.kRosFailure, **report
    )
    robot.chassis.push(ros_pack_pb2.Feedbacks(fbs=[end]))
    status, result = goal.result()
    assert (status, missed(result)) == ((SUCCEEDED, [0]) if is_missed else (ABORTED, []))


def test_a_frozen_chassis_is_no_standing_robot(robot: Robot) -> None:
    goal = driving(robot)
    frozen = robot.chassis.inject("freeze")
    goal.feedback.wait_count(len(goal.feedback.messages) + 12)  # no report for more than 1 s
    goal.cancel()
    frozen.clear()
    assert goal.result()[0] == CANCELED
    assert stands(robot.chassis)


@pytest.mark.parametrize("waits", ["a waypoint", "another goal"])
def test_after_the_service_stop_nothing_drives_that_waited_for_the_end_of_a_drive(
    own_robot: Robot, waits: str
) -> None:
    """However late the robot reports that end."""
    robot = own_robot
    robot.set_motion_timing(hold=0.0, effect=0.1)
    goal = driving(robot, "follow_waypoints", poses=[ahead(4.0), ahead(1.0)])
    report_again = robot.chassis.intercept(without_reports)
    if waits == "another goal":
        goal = Nav2Client(robot, "spin", target_yaw=1.0)
        wait_until(lambda: len(drives(robot)) == 2, "the cancel of the drive")
    # the chassis refuses to cancel twice, and has not reported the end
    assert robot.call(Trigger, "stop").success == (waits == "a waypoint")
    report_again()
    robot.chassis.push(feedbacks(ros_pack_pb2.kRosSuccess, action="woosh.ros.action.MoveBase"))
    goal.wait_aborted("cancelled by the service stop")
    assert [may_move(each.message) for each in robot.chassis.received].count(True) == 1


@pytest.mark.skipif(
    "number_of_loops" not in nav2_actions.FollowWaypoints.Goal.get_fields_and_field_types(),
    reason="Humble has no loops",
)
def test_loops_of_waypoints(robot: Robot) -> None:
    goal = Nav2Client(
        robot,
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
            for received in robot.chassis.received
            if isinstance(received.message, CallAction)
        )
    ]
    assert targets == [1.0, 0.5, 1.0]
