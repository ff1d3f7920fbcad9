"""dock_robot and undock_robot."""

from __future__ import annotations

import pytest
from std_srvs.srv import Trigger

from tests.harness import Logs, Robot, fill, wait_until
from tests.node.cmd_vel import Sender
from tests.node.goals import ACTION_ORDER, CALL_ACTION, EXECUTING, slow_down, without_reports
from tests.node.nav2.goals import (
    CANCELED,
    PREVENTIONS,
    SUCCEEDED,
    Nav2Client,
    pose,
    stands,
)
from woosh_robot_agent.pb.map.storage_edit_pb2 import Storages
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ExecTask
from woosh_robot_agent.pb.robot.robot_pb2 import Battery
from woosh_robot_agent.pb.util.task_pb2 import kCharge, kPaused
from woosh_robot_agent.robot.readiness import is_charging
from woosh_robot_msgs.action import ExecTask as ExecTaskAction
from woosh_robot_msgs.msg import Battery as BatteryMsg
from woosh_robot_msgs.srv import RobotState, Twist

nav2_actions = pytest.importorskip("nav2_msgs.action")
pytestmark = pytest.mark.skipif(
    not hasattr(nav2_actions, "DockRobot"), reason="Humble has no docking"
)


def charges(robot: Robot) -> bool:
    return is_charging(robot.chassis.state.info.battery)


def chargers(robot: Robot) -> list[tuple[str, float, float]]:
    """Return the marks of the chargers and their positions."""
    marks = robot.chassis.call(lambda sim: dict(sim.chassis.map.marks))
    return [
        (number, mark.pose.x, mark.pose.y)
        for number, mark in marks.items()
        if "charg" in str(mark.kind).lower()
    ]


def docking(robot: Robot) -> Nav2Client:
    """Start docking in real time, and wait until the robot drives."""
    slow_down(robot.chassis)
    goal = Nav2Client(robot, "dock_robot")
    wait_until(lambda: robot.chassis.state.velocity.speed > 0.01, "the robot drives")
    return goal


def test_the_robot_docks_and_undocks(robot: Robot, logs: Logs) -> None:
    mark = chargers(robot)[0][0]
    goal = Nav2Client(robot, "dock_robot", dock_id=mark)
    status, result = goal.result()
    assert (status, result.success, result.error_code) == (SUCCEEDED, True, 0)
    assert charges(robot)
    Sender(robot).send(x=0.1)  # the charging task goes on, and no client has a goal to cancel
    logs.wait_text("cmd_vel is ignored: task ")
    feedback = nav2_actions.DockRobot.Feedback
    states = [each.state for each in goal.feedback.messages]
    assert states == sorted(states)
    assert states[0] == feedback.NAV_TO_STAGING_POSE
    status, result = Nav2Client(robot, "undock_robot").result()
    assert (status, result.success, result.error_code) == (SUCCEEDED, True, 0)
    assert not charges(robot)
    assert robot.chassis.call(lambda sim: sim.chassis.charger) is None
    again = Nav2Client(robot, "undock_robot")  # the chassis might back out further
    again.wait_aborted("the robot is in no charger", code="DOCK_NOT_VALID")


def test_the_charger_is_found_and_left_even_if_the_robot_charges_no_more(robot: Robot) -> None:
    """Without an id it is the nearest one; a pose stands for the charger near it."""
    here = robot.chassis.state.pose
    mark, x, y = min(chargers(robot), key=lambda each: here.distance(each[1:]))
    for fields in ({"use_dock_id": True}, {"use_dock_id": False, "dock_pose": pose(x + 0.3, y)}):
        assert Nav2Client(robot, "dock_robot", **fields).result()[0] == SUCCEEDED
        robot.chassis.call(lambda sim: setattr(sim.chassis.battery, "charging", Battery.kNot))
        assert Nav2Client(robot, "undock_robot").result()[0] == SUCCEEDED
        assert robot.chassis.call(lambda sim: sim.chassis.charger) is None
    tasks = [each.message for each in robot.chassis.received if type(each.message) is ExecTask]
    assert [task.mark_no for task in tasks] == [mark] * 2


def test_there_is_no_such_charger(robot: Robot) -> None:
    for where in ({"dock_id": "Z99"}, {"use_dock_id": False, "dock_pose": pose(0.0, 0.0)}):
        goal = Nav2Client(robot, "dock_robot", **where)
        assert not goal.wait_aborted("there is no charger", code="DOCK_NOT_IN_DB").success
    assert ExecTask.DESCRIPTOR.full_name not in robot.chassis.counts


def test_docking_is_cancelled(robot: Robot) -> None:
    slow_down(robot.chassis)
    goal = Nav2Client(robot, "dock_robot")
    goal.feedback.wait(lambda _: True)
    goal.cancel()
    status, result = goal.result()
    assert (status, result.success) == (CANCELED, False)
    assert not robot.chassis.call(lambda sim: sim.chassis.tasks.active)


def test_docking_is_cancelled_though_the_chassis_does_not_answer(robot: Robot) -> None:
    robot.chassis.mute(Storages.DESCRIPTOR.full_name)
    goal = Nav2Client(robot, "dock_robot")
    robot.chassis.wait_received(Storages.DESCRIPTOR.full_name)
    goal.cancel()
    assert goal.result()[0] == CANCELED
    assert ExecTask.DESCRIPTOR.full_name not in robot.chassis.counts


def test_docking_ends_when_something_stops_the_robot(robot: Robot) -> None:
    """test_navigation.py has everything that may stop it."""
    prevent, permit = PREVENTIONS["localisation"]
    goal = docking(robot)
    prevent(robot.chassis)
    assert not goal.wait_aborted("localisation").success
    permit(robot.chassis)
    wait_until(
        lambda: not robot.chassis.call(lambda sim: sim.chassis.tasks.active), "the task ends"
    )


def test_docking_ends_though_the_robot_obeys_again_when_the_agent_hears_of_it(
    robot: Robot,
) -> None:
    goal = docking(robot)
    stalled = robot.chassis.inject("half_open")
    robot.chassis.set_emergency_stop(True)
    robot.chassis.set_emergency_stop(False)
    stalled.clear()
    goal.wait_aborted("emergency stop")


@pytest.mark.parametrize("cancelled", [False, True], ids=["", "after a cancel of the client"])
def test_docking_that_something_stops_is_cancelled_once(robot: Robot, cancelled: bool) -> None:
    """A cancel names no task, so a further one could end another task."""
    goal = docking(robot)
    # the end of the task is not reported
    robot.chassis.intercept(
        lambda out: [out] if getattr(out.body, "state", kPaused) == kPaused else []
    )
    if cancelled:
        assert robot.call(Twist, "robot/Twist").ok  # a zero, which pauses the task
        wait_until(lambda: robot.chassis.state.info.task_proc.state == kPaused, "the pause")
        goal.cancel()
    else:
        robot.chassis.set_emergency_stop(True)
    robot.chassis.wait_received(ACTION_ORDER)
    robot.chassis.set_emergency_stop(True)
    goal.feedback.wait_count(len(goal.feedback.messages) + 5)
    assert robot.chassis.counts[ACTION_ORDER] == 1


def test_docking_that_a_stop_did_not_end_is_cancelled_when_something_stops_the_robot(
    own_robot: Robot,
) -> None:
    robot = own_robot
    goal = docking(robot)
    refusal = robot.chassis.inject("refuse", type=ACTION_ORDER)
    assert robot.call(Trigger, "stop").success  # its zero only pauses the task
    refusal.clear()
    robot.chassis.set_emergency_stop(True)
    goal.wait_aborted("cancelled by the service stop")
    robot.chassis.set_emergency_stop(False)
    wait_until(
        lambda: not robot.chassis.call(lambda sim: sim.chassis.tasks.active), "the task ends"
    )


def test_a_robot_that_charges_is_docked_and_a_refusal_is_explained(
    robot: Robot, logs: Logs
) -> None:
    for _ in range(2):
        goal = Nav2Client(robot, "dock_robot", navigate_to_staging_pose=False)
        status, result = goal.result()
        assert (status, result.success) == (SUCCEEDED, True)
    assert robot.chassis.counts[ExecTask.DESCRIPTOR.full_name] == 1
    assert len(logs.with_text("navigate_to_staging_pose has no effect")) == 1
    robot.chassis.set_emergency_stop(True)
    for name in ("dock_robot", "undock_robot"):
        result = Nav2Client(robot, name).wait_aborted("emergency stop")
        assert not result.success
        assert result.error_code != 0


def test_cmd_vel_is_refused_before_the_chassis_executes_anything_for_the_goal(
    robot: Robot, logs: Logs
) -> None:
    robot.chassis.mute(Storages.DESCRIPTOR.full_name)
    Nav2Client(robot, "dock_robot")
    robot.chassis.wait_received(Storages.DESCRIPTOR.full_name)
    Sender(robot).send(x=0.1)
    logs.wait_text("cmd_vel is ignored: a goal is running")


def test_undocking_does_not_wait_for_a_lost_link(robot: Robot) -> None:
    assert Nav2Client(robot, "dock_robot").result()[0] == SUCCEEDED
    report_again = robot.chassis.intercept(without_reports)
    goal = Nav2Client(robot, "undock_robot")
    robot.chassis.wait_received(ACTION_ORDER)
    robot.call(RobotState, "robot/RobotState")  # answered after the cancel of the task
    switched_off = robot.chassis.inject("off")
    goal.wait_aborted("no link")
    report_again()
    switched_off.clear()
    robot.call(RobotState, "robot/RobotState")
    assert robot.chassis.counts[CALL_ACTION] == 0


def test_undocking_is_cancelled(robot: Robot) -> None:
    assert Nav2Client(robot, "dock_robot").result()[0] == SUCCEEDED
    slow_down(robot.chassis)
    goal = Nav2Client(robot, "undock_robot")
    wait_until(lambda: robot.chassis.state.velocity.speed > 0.01, "the robot backs out")
    goal.cancel()
    status, result = goal.result()
    assert (status, result.success, result.error_code) == (CANCELED, False, 0)
    assert stands(robot.chassis)


def test_the_way_to_the_charger_takes_too_long(robot: Robot) -> None:
    slow_down(robot.chassis)
    Nav2Client(robot, "dock_robot", max_staging_time=0.2).wait_aborted(code="FAILED_TO_STAGE")
    assert not robot.chassis.call(lambda sim: sim.chassis.tasks.active)


def test_a_robot_in_no_charger_is_not_undocked(robot: Robot) -> None:
    """The chassis might back out of where it is, or drive away with the cable of a person."""

    def check() -> None:
        goal = Nav2Client(robot, "undock_robot")
        assert not goal.wait_aborted("the robot is in no charger", code="DOCK_NOT_VALID").success
        assert robot.chassis.counts["woosh.ros.CallAction"] == 0

    batteries = robot.echo(BatteryMsg, "robot/Battery")
    for plug in (Battery.kManual, Battery.kNot):
        robot.chassis.call(lambda sim, plug=plug: setattr(sim.chassis.battery, "charging", plug))
        batteries.wait(lambda each, plug=plug: each.charge_state.value == plug)
        check()
    slow_down(robot.chassis)
    charge = fill(ExecTaskAction.Goal(), arg={"type": kCharge})
    to_a_charger = robot.send_goal(ExecTaskAction, "robot/ExecTask", charge)
    to_a_charger.feedback.wait(lambda each: each.state.value == EXECUTING)
    check()
