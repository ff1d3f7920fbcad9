"""Reasons why a robot would reject a task, compared with those of the simulated chassis."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import pytest

from tests.quick_chassis import quick_config
from woosh_robot_agent.pb.robot.robot_count_pb2 import AbnormalCodes, StatusCode
from woosh_robot_agent.pb.robot.robot_pb2 import (
    Battery,
    DeviceState,
    HardwareState,
    Mode,
    OperationState,
    RobotInfo,
)
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.readiness import has_map, is_located, is_taskable, objections
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.protocol.reports import robot_info


def ready() -> RobotInfo:
    return robot_info(Chassis(quick_config()))


def not_taskable() -> RobotInfo:
    info = ready()
    info.operation_state.robot = 0
    return info


def names(info: RobotInfo) -> list[str]:
    return [objection.name for objection in objections(info)]


def test_a_ready_robot_has_no_reason():
    assert objections(ready()) == []
    assert is_taskable(ready()) is True
    assert is_located(ready()) is True


def test_an_empty_robot_info_gives_no_reason():
    assert objections(RobotInfo()) == []
    assert is_taskable(RobotInfo()) is None
    assert is_located(RobotInfo()) is None


@pytest.mark.parametrize("stop", [False, True])
@pytest.mark.parametrize("located", [False, True])
@pytest.mark.parametrize("initialised", [False, True])
def test_reasons_match_those_of_the_chassis(stop: bool, located: bool, initialised: bool) -> None:
    for ctrl, work in itertools.product((robot.kAuto, robot.kManual, robot.kMaintain), (1, 2)):
        chassis = Chassis(quick_config())
        readiness = chassis.readiness
        readiness.ctrl, readiness.work = ctrl, work  # type: ignore[assignment]
        readiness.located, readiness.initialised = located, initialised
        chassis.set_emergency_stop(stop)
        found = objections(robot_info(chassis))
        assert bool(found) == bool(readiness.objections()), (found, readiness.objections())
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


def test_a_robot_that_builds_a_map_is_not_lost_and_has_a_map():
    info = ready()
    info.MergeFrom(RobotInfo(state=robot.kMapping))
    info.device_state.CopyFrom(DeviceState())
    info.pose_speed.map_id = 0
    assert names(info) == []
    assert is_located(info) is None
    assert has_map(info) is True
    info.state = robot.kIdle
    assert names(info) == ["lost"]
    assert has_map(info) is False


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
