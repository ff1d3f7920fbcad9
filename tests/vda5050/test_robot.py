"""The state of the robot from its reports, also senseless ones; waits; actions that never begin."""

from __future__ import annotations

import asyncio
import math
from typing import Any, cast

import pytest

from tests.asynchronous import eventually
from tests.vda5050 import orders
from tests.vda5050.chassis_events import commands
from woosh_robot_agent.link import LinkConfig
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.pb.robot.robot_count_pb2 import AbnormalCodes, StatusCode
from woosh_robot_agent.pb.robot.robot_pb2 import (
    OperationState,
    PoseSpeed,
    RobotInfo,
    Scene,
    TaskProc,
)
from woosh_robot_agent.pb.ros.action_pb2 import StepControl
from woosh_robot_agent.pb.ros.ros_pack_pb2 import Feedback, Feedbacks, kRosSuccess
from woosh_robot_agent.pb.util import action_pb2 as action
from woosh_robot_agent.pb.util import robot_pb2
from woosh_robot_agent.pb.util import task_pb2 as task
from woosh_robot_agent.pb.util.common_pb2 import Pose2D, Twist
from woosh_robot_agent.simulator import SimulatorThread
from woosh_robot_agent.vda5050.actions.runner import ActionRunner, action_types
from woosh_robot_agent.vda5050.execution import Execution
from woosh_robot_agent.vda5050.messages.order import Action
from woosh_robot_agent.vda5050.messages.state import ActionStatus, ErrorLevel
from woosh_robot_agent.vda5050.messages.versions import V2_1
from woosh_robot_agent.vda5050.orders.legs import EndAction, Perform
from woosh_robot_agent.vda5050.robot.calls import RobotCalls
from woosh_robot_agent.vda5050.robot.link import Conditions, RobotLink, Timing
from woosh_robot_agent.vda5050.robot.status import code_errors, field_violated, points, robot_status

BUSY, IDLE, SCANNER = 120301000022, 140801000071, 110203000012


def codes(*found: tuple[int, StatusCode.Level.ValueType, str]) -> AbnormalCodes:
    return AbnormalCodes(
        scs=[StatusCode(code=code, level=level, msg=text) for code, level, text in found]
    )


def test_warnings_and_faults_are_errors_with_meaning_and_hint() -> None:
    warning, fault = code_errors(
        codes((IDLE, StatusCode.kWarn, ""), (BUSY, StatusCode.kFault, "in its own words"))
    )
    assert (warning.level, fault.level) == (ErrorLevel.WARNING, ErrorLevel.FATAL)
    assert "robot is not navigating" in warning.description
    assert "in its own words (step control is already in use)" in fault.description
    assert fault.references == (("statusCode", str(BUSY)),)
    assert "resolve the cause" in warning.hint


def test_a_code_counts_once_and_lower_levels_are_no_errors() -> None:
    twice = codes((BUSY, StatusCode.kWarn, ""), (BUSY, StatusCode.kWarn, ""))
    assert len(code_errors(twice)) == 1
    assert code_errors(codes((BUSY, StatusCode.kTips, ""))) == ()


def test_a_safety_scanner_that_has_tripped_violates_the_field() -> None:
    assert field_violated(codes((SCANNER, StatusCode.kWarn, "")))
    assert not field_violated(codes((BUSY, StatusCode.kFault, "")))


def task_proc(state: task.State.ValueType, action_state: action.State.ValueType) -> RobotInfo:
    """What a robot with a task reports."""
    report = TaskProc(robot_task_id=1, state=state)
    report.action.state = action_state
    return RobotInfo(task_proc=report)


@pytest.mark.parametrize(
    ("report", "blocked"),
    [
        (RobotInfo(operation_state=OperationState(nav=OperationState.kImpede)), True),
        (RobotInfo(operation_state=OperationState(nav=OperationState.kNarrow)), False),
        (task_proc(task.kPaused, action.kRosWarning), True),  # as a TR-200 reports it
        (task_proc(task.kExecuting, action.kRosExecuting), False),
        (task_proc(task.kPaused, action.kSuspend), False),
        (RobotInfo(), False),
    ],
)
def test_the_robot_tells_that_an_obstacle_blocks_its_way(report: RobotInfo, blocked: bool) -> None:
    assert robot_status(report).blocked == blocked


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_numbers_that_are_not_finite_are_left_out(bad: float) -> None:
    good = PoseSpeed(map_id=3, pose=Pose2D(x=1.0, y=2.0, theta=3.0), twist=Twist(linear=0.5))
    status = robot_status(RobotInfo(pose_speed=good))
    assert status.position is not None
    assert status.velocity is not None
    lost = PoseSpeed(map_id=3, pose=Pose2D(x=1.0, theta=bad), twist=Twist(angular=bad))
    status = robot_status(RobotInfo(pose_speed=lost))
    assert status.position is None
    assert status.velocity is None
    assert points([Pose2D(x=1.0, y=2.0), Pose2D(x=bad)]) == ((1.0, 2.0),)


@pytest.mark.parametrize(
    ("changed", "is_on_map"),
    [
        ({}, True),
        ({"scene": Scene(map_name="hall", map_id=7)}, False),
        ({"scene": Scene()}, False),
        ({"pose_speed": None}, False),
        ({"state": robot_pb2.kMapping}, False),
    ],
)
def test_a_pose_without_a_map_is_one_on_the_map_with_the_id_0(
    changed: dict[str, Any], is_on_map: bool
) -> None:
    report = {"pose_speed": PoseSpeed(), "scene": Scene(map_name="hall"), **changed}
    position = robot_status(RobotInfo(**report)).position
    assert (position is not None) == is_on_map


@pytest.mark.parametrize("timeout", [None, 60.0])
async def test_a_cancel_at_the_moment_when_the_condition_holds_is_not_lost(
    timeout: float | None,
) -> None:
    """An action goes on otherwise, although its order was cancelled."""
    conditions = Conditions()
    values: list[int] = []
    waiting = asyncio.create_task(conditions.wait(lambda: bool(values), timeout))
    await asyncio.sleep(0)
    values.append(1)
    conditions.check()
    waiting.cancel()
    with pytest.raises(asyncio.CancelledError):
        await waiting


async def test_an_action_that_is_cancelled_as_it_ends_does_not_cancel_the_next_one(
    chassis: SimulatorThread,
) -> None:
    """E.g. because somebody turns the key switch at that moment."""
    config = LinkConfig(ip="127.0.0.1", port=chassis.port)
    link = RobotLink(config, Timing(repeat_after=0.1), *[lambda: None] * 3)
    calls = RobotCalls(link)
    step = StepControl(steps=[StepControl.Step(mode=StepControl.Step.kStraight, value=0.2)])

    def cancel_at_end(reports: Feedbacks) -> None:
        if any(each.state == kRosSuccess for each in reports.fbs):
            first.cancel()

    link.chassis.subscribe(Feedbacks, cancel_at_end)  # called when `calls` knows the end
    link.chassis.start()
    await link.wait_ready()
    first = asyncio.create_task(calls.perform(step, lambda status: None))
    with pytest.raises(asyncio.CancelledError):
        await first
    assert await calls.perform(step, lambda status: None) == "1 of 1 steps done"
    assert commands(chassis) == ["step_control execute"] * 2
    await link.background.close()
    await link.chassis.close()


async def test_the_end_of_an_action_that_does_not_exist_is_not_kept(
    chassis: SimulatorThread,
) -> None:
    link = RobotLink(LinkConfig(ip="127.0.0.1", port=chassis.port), Timing(), *[lambda: None] * 3)
    calls = RobotCalls(link)
    names = ("woosh.ros.action.Unknown", full_name(StepControl))
    seen: list[Feedbacks] = []
    link.chassis.subscribe(Feedbacks, seen.append)  # called when `calls` knows the ends
    link.chassis.start()
    await link.wait_ready()
    chassis.push(Feedbacks(fbs=[Feedback(action=name, state=kRosSuccess) for name in names]))
    await eventually(lambda: seen)
    assert set(calls._ends) == {names[1]}
    await link.background.close()
    await link.chassis.close()


async def test_an_action_that_is_ended_before_it_begins_has_failed() -> None:
    link = RobotLink(LinkConfig(), Timing(), *[lambda: None] * 3)
    execution = Execution(link, V2_1, action_types(V2_1))
    runner = ActionRunner(execution, cast("Any", None), None)
    lift = Action("1", "liftTo", parameters={"height": 0.1})
    execution.order.moved(orders.at(0.0))
    execution.order.receive(orders.path("a", actions={"a": [lift]}))
    runner.execute(Perform(lift, at_once=True))
    runner.execute(EndAction(lift, "it is not needed"))
    await eventually(lambda: execution.order.status.actions[0].status is ActionStatus.FAILED)
    assert execution.order.status.actions[0].result == "it is not needed"
    await link.background.close()
