"""Reasons why a robot would reject a task, compared with those of the simulated chassis."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import pytest

from tests.quick_chassis import quick_config
from woosh_robot_agent.pb.robot.robot_count_pb2 import AbnormalCodes, StatusCode
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ActionOrder, ExecTask
from woosh_robot_agent.pb.robot.robot_pb2 import (
    Battery,
    DeviceState,
    HardwareState,
    Mode,
    OperationState,
    RobotInfo,
    TaskProc,
)
from woosh_robot_agent.pb.util import action_pb2 as action
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.pb.util import task_pb2 as task
from woosh_robot_agent.robot.readiness import (
    accepts_task,
    all_objections,
    is_located,
    is_taskable,
    objections,
    pose_problem,
)
from woosh_robot_agent.simulator.chassis import TIME_STEP, Chassis
from woosh_robot_agent.simulator.config import SimulatorConfig
from woosh_robot_agent.simulator.protocol.handlers import dispatch
from woosh_robot_agent.simulator.protocol.reports import robot_info


def ready() -> RobotInfo:
    return robot_info(Chassis(quick_config()))


def not_taskable() -> RobotInfo:
    info = ready()
    info.operation_state.robot = 0
    return info


def names(info: RobotInfo) -> list[str]:
    return [objection.name for objection in objections(info)]


@pytest.mark.parametrize(("info", "known"), [(ready(), True), (RobotInfo(), None)])
def test_a_ready_robot_and_an_empty_robot_info_give_no_reason(
    info: RobotInfo, known: bool | None
) -> None:
    assert all_objections(info) == []
    assert [judge(info) for judge in (is_taskable, is_located, accepts_task)] == [known] * 3
    assert pose_problem(info) is None


@pytest.mark.parametrize("stop", [False, True])
@pytest.mark.parametrize("located", [False, True])
@pytest.mark.parametrize("initialised", [False, True])
def test_reasons_match_those_of_the_chassis(stop: bool, located: bool, initialised: bool) -> None:
    for ctrl, work in itertools.product((robot.kAuto, robot.kManual, robot.kMaintain), (1, 2)):
        chassis = Chassis(quick_config())
        readiness = chassis.readiness
        readiness.requested_control, readiness.work = ctrl, work  # type: ignore[assignment]
        readiness.located, readiness.initialised = located, initialised
        chassis.set_emergency_stop(stop)
        found = objections(robot_info(chassis))
        assert bool(found) != readiness.ready, (found, readiness)
        assert len({objection.name for objection in found}) == len(found)


CASES: list[tuple[str, Callable[[RobotInfo], object]]] = [
    ("emergency_stop", lambda i: i.device_state.MergeFrom(DeviceState(hardware=1024))),
    ("manual", lambda i: i.mode.CopyFrom(Mode(ctrl=robot.kManual))),
    ("maintenance", lambda i: i.mode.CopyFrom(Mode(ctrl=robot.kMaintain))),
    ("no_control_mode", lambda i: i.mode.CopyFrom(Mode())),
    ("no_work_mode", lambda i: i.mode.CopyFrom(Mode(ctrl=robot.kAuto))),
    ("deployment", lambda i: i.mode.CopyFrom(Mode(ctrl=robot.kAuto, work=robot.kDeployMode))),
    ("schedule", lambda i: i.mode.CopyFrom(Mode(ctrl=robot.kAuto, work=robot.kScheduleMode))),
    ("not_initialised", lambda i: i.MergeFrom(RobotInfo(state=robot.kUninit))),
    ("lost", lambda i: i.device_state.CopyFrom(DeviceState())),
]


@pytest.mark.parametrize(("name", "change"), CASES, ids=[case[0] for case in CASES])
def test_sufficient_reasons_do_not_depend_on_the_taskable_bit(
    name: str, change: Callable[[RobotInfo], object]
) -> None:
    """They are given with and without the taskable bit, and only once."""
    for info in (ready(), not_taskable()):
        change(info)
        assert names(info) == [name]
        assert all(objections(info)[0])


BUSY: list[tuple[str, Callable[[RobotInfo], object]]] = [
    ("executing task 7", lambda i: i.task_proc.MergeFrom(running(7, task.kExecuting))),
    ("executing task 8", lambda i: i.task_proc.MergeFrom(running(8, task.kPaused))),
    ("executing task 9", lambda i: i.task_proc.MergeFrom(running(9, task.kActionWait))),
    ("executing a task", lambda i: i.MergeFrom(RobotInfo(state=robot.kTask))),
    ("charging or parking task", lambda i: i.MergeFrom(RobotInfo(state=robot.kParking))),
    ("building a map", lambda i: i.MergeFrom(RobotInfo(state=robot.kMapping))),
    ("following a person", lambda i: i.MergeFrom(RobotInfo(state=robot.kFollowing))),
]


def running(number: int, state: task.State) -> TaskProc:
    return TaskProc(robot_task_id=number, type=task.kPick, state=state)


@pytest.mark.parametrize(("text", "change"), BUSY, ids=[case[0] for case in BUSY])
def test_a_busy_robot_rejects_a_new_task(text: str, change: Callable[[RobotInfo], object]) -> None:
    """Whether or not it clears its taskable bit meanwhile."""
    for info in (ready(), not_taskable()):
        change(info)
        (only,) = all_objections(info)
        assert text in only.reason
        assert accepts_task(info) is False


def test_the_chassis_refuses_a_task_while_it_is_judged_to_do_so():
    chassis = Chassis(SimulatorConfig(seed=1))
    first, other = (ExecTask(task_id=n, type=task.kPick, mark_no="A2") for n in (5, 6))
    assert accepts_task(robot_info(chassis)) is True
    assert dispatch(chassis, first).ok
    for order in (None, action.kPause, action.kContinue):
        if order is not None:
            assert dispatch(chassis, ActionOrder(order=order)).ok
        for _ in range(40):
            assert accepts_task(robot_info(chassis)) is False
            assert not dispatch(chassis, other).ok
            chassis.tick(TIME_STEP)
    while chassis.tasks.active:
        assert accepts_task(robot_info(chassis)) is False
        chassis.tick(TIME_STEP)
    chassis.tick(TIME_STEP)  # the robot reports for some milliseconds more that it has a task
    assert accepts_task(robot_info(chassis)) is True
    assert dispatch(chassis, other).ok


def test_what_a_robot_does_is_told_beside_other_reasons():
    info = ready()
    info.device_state.MergeFrom(DeviceState(hardware=DeviceState.kEmgBtn))
    info.task_proc.MergeFrom(running(7, task.kPaused))
    assert [each.name for each in all_objections(info)] == ["emergency_stop", "busy"]


def test_a_pose_without_a_map_is_told_from_one_on_a_map_with_the_id_0():
    info = ready()
    info.pose_speed.map_id = 0
    problem = pose_problem(info)
    assert problem is not None
    assert "it belongs to no map" in problem.reason
    info.scene.map_id = 0
    problem = pose_problem(info)
    assert problem is not None
    assert "it belongs to no map" not in problem.reason
    assert "map wooshmap has the id 0" in problem.reason


def test_a_robot_that_builds_a_map_is_not_lost_and_has_a_map():
    info = ready()
    info.MergeFrom(RobotInfo(state=robot.kMapping))
    info.device_state.CopyFrom(DeviceState())
    info.pose_speed.map_id = 0
    assert names(info) == []
    assert is_located(info) is None
    assert pose_problem(info) is None
    info.state = robot.kIdle
    assert names(info) == ["lost"]
    assert pose_problem(info) is not None


def test_all_reasons_are_given_at_once():
    info = not_taskable()
    info.mode.CopyFrom(Mode(ctrl=robot.kManual, work=robot.kDeployMode))
    info.device_state.CopyFrom(DeviceState(hardware=1024))
    info.battery.CopyFrom(Battery(charge_state=Battery.kNot, power=0))
    info.hardware_state.CopyFrom(HardwareState(motor=[0, 17], imu=HardwareState.kFatal))
    found = ["emergency_stop", "manual", "deployment", "lost", "battery_empty"]
    assert names(info) == [*found, "hardware", "hardware"]
    assert "(motor 2)" in str(objections(info)[-2])
    assert "(imu)" in str(objections(info)[-1])


@pytest.mark.parametrize(
    ("change", "name", "text"),
    [
        (
            lambda i: i.abnormal_codes.CopyFrom(
                AbnormalCodes(scs=[StatusCode(code=7, msg="drive", level=StatusCode.kFault)])
            ),
            "fault",
            "7: drive",
        ),
        (lambda i: i.MergeFrom(RobotInfo(state=robot.kMapping)), "mapping", "map"),
        (lambda i: i.MergeFrom(RobotInfo(state=robot.kFollowing)), "following", "Follow"),
        (lambda i: i.MergeFrom(RobotInfo(state=robot.kCharging)), "charging", "charging"),
        (lambda i: i.device_state.MergeFrom(DeviceState(software=9)), "occupied", "SetOccupancy"),
        (lambda i: None, "not_taskable", "not why"),
    ],
)
def test_probable_reasons_are_given_only_if_the_robot_is_not_taskable(change, name, text):
    info = ready()
    change(info)
    assert names(info) == []
    info.operation_state.CopyFrom(OperationState())
    assert names(info) == [name]
    assert text in str(objections(info)[0])
