"""Handlers of queries, and of requests that change settings, modes or statistics."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.pb.map import map_pack_pb2
from woosh_robot_agent.pb.robot import robot_count_pb2 as count_pb2
from woosh_robot_agent.pb.robot import robot_pack_pb2 as pack
from woosh_robot_agent.pb.robot import robot_pb2
from woosh_robot_agent.pb.robot import robot_setting_pb2 as setting_pb2
from woosh_robot_agent.pb.ros import ros_pack_pb2
from woosh_robot_agent.pb.task import woosh_task_pb2
from woosh_robot_agent.pb.util import robot_pb2 as util_robot_pb2
from woosh_robot_agent.simulator import refusals
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.protocol import reports
from woosh_robot_agent.simulator.protocol.handlers import (
    Handler,
    command,
    named_scene,
    pose,
    query,
)
from woosh_robot_agent.simulator.refusals import RefusedError
from woosh_robot_agent.simulator.timeline import copy_of

_MAX_NAME = 100
"""Maximum length of the robot's name, in characters."""

_MAX_HOST = 253
"""Maximum length of a host name, in characters."""


def _check_length(field: str, text: str, most: int) -> None:
    if len(text) > most:
        raise RefusedError(refusals.TEXT_TOO_LONG, field=field, limit=most)


@command(setting_pb2.Identity)
def _identity(chassis: Chassis, request: setting_pb2.Identity) -> Message:
    _check_length("name", request.name, _MAX_NAME)
    chassis.setting.identity.name = request.name
    return copy_of(chassis.setting.identity)


@command(setting_pb2.Server)
def _server(chassis: Chassis, request: setting_pb2.Server) -> Message:
    if request.port > 65535:
        raise RefusedError(f"port {request.port} is not within 0 to 65535")
    _check_length("ip", request.ip, _MAX_HOST)
    chassis.setting.server.ip = request.ip
    chassis.setting.server.port = request.port
    return copy_of(chassis.setting.server)


def _set_permission(field: str) -> Handler:
    """Return the handler of a request that sets one of the permissions in the settings."""

    # The other requests of this kind have the same field as AutoCharge.
    def handle(chassis: Chassis, request: setting_pb2.AutoCharge) -> Message:
        setattr(chassis.setting.allow, field, request.allow)
        return copy_of(request)

    return handle


for _cls, _field in (
    (setting_pb2.AutoCharge, "auto_charge"),
    (setting_pb2.AutoPark, "auto_park"),
    (setting_pb2.GoodsCheck, "goods_check"),
):
    command(_cls)(_set_permission(_field))


@command(setting_pb2.Power)
def _power(chassis: Chassis, request: setting_pb2.Power) -> Message:
    levels = [request.alarm, request.low, request.idle, request.full]
    if levels != sorted(levels) or request.full > 100:
        raise RefusedError(
            f"power levels {levels} must rise or stay the same from alarm to full (at most 100)"
        )
    power = chassis.setting.power
    power.alarm, power.low, power.idle, power.full = levels
    return copy_of(power)


@command(setting_pb2.Sound)
def _sound(chassis: Chassis, request: setting_pb2.Sound) -> Message:
    if request.volume > 100:
        raise RefusedError(f"volume {request.volume} is not within 0 to 100")
    chassis.setting.sound.mute = request.mute
    chassis.setting.sound.volume = request.volume
    return copy_of(chassis.setting.sound)


_MAX_SPEECH = 1000
"""Number of characters of a spoken text that are kept; the rest is cut off."""

_MAX_LIGHT = 15
"""Maximum number of a submodule of the lights. The schema does not say which submodules exist."""


@command(pack.InitRobot)
def _init_robot(chassis: Chassis, request: pack.InitRobot) -> None:
    """Set the pose, end all driving and the task, and initialise the robot."""
    has_task = chassis.tasks.active or chassis.tasks.between_tasks
    if has_task and chassis.profile.refusals.while_busy:
        task = chassis.tasks.proc.robot_task_id
        raise RefusedError(refusals.INIT_DURING_TASK, task=task)
    chassis.mapping.require_none(refusals.INIT_WHILE_MAPPING)
    # Clients may send is_record together with an empty pose: is_record takes precedence.
    where = chassis.base.pose if request.is_record else pose(request.pose)
    chassis.localise(where)
    reason = "robot was initialised"
    chassis.ownership.end_driving(reason)
    chassis.base.halt()
    if has_task:
        chassis.tasks.cancel(reason)
    # The answer comes when the initialisation is done.
    chassis.answer_delay = chassis.initialise()


@command(pack.SetRobotPose)
def _set_robot_pose(chassis: Chassis, request: pack.SetRobotPose) -> None:
    if not chassis.readiness.initialised and not chassis.mapping.active:
        raise RefusedError(refusals.NOT_INITIALISED)
    # While a map is made, only a robot that has lost its localisation may get a pose.
    if chassis.readiness.located:
        chassis.mapping.require_none(refusals.POSE_WHILE_MAPPING)
    chassis.localise(pose(request.pose))


@command(pack.SetOccupancy)
def _set_occupancy(chassis: Chassis, request: pack.SetOccupancy) -> None:
    chassis.occupied = request.occupy


@command(pack.SetMuteCall)
def _set_mute_call(chassis: Chassis, request: pack.SetMuteCall) -> None:
    chassis.call_muted = request.mute


@command(pack.SetProgramMute)
def _set_program_mute(chassis: Chassis, request: pack.SetProgramMute) -> None:
    chassis.program_muted = request.mute


@command(pack.SwitchControlMode)
def _switch_control_mode(chassis: Chassis, request: pack.SwitchControlMode) -> Message:
    known = (util_robot_pb2.kAuto, util_robot_pb2.kManual, util_robot_pb2.kMaintain)
    if request.mode not in known:
        raise RefusedError(
            f"unknown control mode {request.mode}: 1 is automatic, 2 manual, 3 maintenance"
        )
    if chassis.readiness.key_manual and request.mode != util_robot_pb2.kManual:
        raise RefusedError(refusals.KEY_AT_MANUAL)
    chassis.readiness.requested_control = request.mode
    return reports.mode(chassis)


@command(pack.SwitchWorkMode)
def _switch_work_mode(chassis: Chassis, request: pack.SwitchWorkMode) -> Message:
    known = (
        util_robot_pb2.kDeployMode,
        util_robot_pb2.kTaskMode,
        util_robot_pb2.kScheduleMode,
    )
    if request.mode not in known:
        raise RefusedError(f"unknown work mode {request.mode}: 1 is deployment, 2 task, 3 schedule")
    if request.mode != chassis.readiness.work:
        chassis.mapping.require_none(refusals.WORK_MODE_WHILE_MAPPING)
        chassis.deployment.end_session()
    chassis.readiness.work = request.mode
    return reports.mode(chassis)


@command(pack.SwitchFootPrint)
def _switch_foot_print(chassis: Chassis, request: pack.SwitchFootPrint) -> Message:
    if request.type not in chassis.footprints:
        raise RefusedError(
            f"unknown footprint {request.type}: use one of {list(chassis.footprints)}"
        )
    chassis.footprint = request.type
    if chassis.ownership.navigation:
        chassis.ownership.navigation.replan()
    return pack.SwitchFootPrint(type=chassis.footprint)


@command(pack.Speak)
def _speak(chassis: Chassis, request: pack.Speak) -> None:
    chassis.spoken.append(request.text[:_MAX_SPEECH])


@command(pack.LED)
def _led(chassis: Chassis, request: pack.LED) -> Message:
    if request.submodule > _MAX_LIGHT:
        raise RefusedError(
            f"unknown submodule {request.submodule} of the lights: use 0 to {_MAX_LIGHT}"
        )
    chassis.lights[request.submodule] = request
    return request


@command(pack.RobotWiFi)
def _wifi(chassis: Chassis, request: pack.RobotWiFi) -> Message:
    wifi, order = chassis.wifi, request.order
    answer = pack.RobotWiFi(order=order)
    if order == pack.RobotWiFi.kWiFiList:
        answer.content = wifi.scan()
        text = answer.content.decode()
        feedback = ros_pack_pb2.Feedback(state=ros_pack_pb2.kRosWiFiJson, msg=text)
        # the list is also sent as a push
        chassis.emit(ros_pack_pb2.Feedbacks(fbs=[feedback]))
    elif order == pack.RobotWiFi.kAdd:
        wifi.add(request.content, connect=request.is_connect_now)
    elif order == pack.RobotWiFi.kReconnect:
        wifi.reconnect(request.content)
    elif order == pack.RobotWiFi.kForget:
        wifi.forget(request.content)
    elif order == pack.RobotWiFi.kHotspot:
        wifi.hotspot = request.enable
        answer.enable = request.enable
    else:
        raise RefusedError(
            f"unknown Wi-Fi order {order}: 1 is list, 2 add, 3 reconnect, 4 forget, 5 hotspot"
        )
    return answer


@query(woosh_task_pb2.RepeatTasks)
def _repeat_tasks(chassis: Chassis, request: woosh_task_pb2.RepeatTasks) -> Message:
    return copy_of(chassis.scene.predefined)


@query(woosh_task_pb2.CallTasks)
def _call_tasks(chassis: Chassis, request: woosh_task_pb2.CallTasks) -> Message:
    return copy_of(chassis.scene.calls)


@query(ros_pack_pb2.Feedbacks)
def _feedbacks(chassis: Chassis, request: ros_pack_pb2.Feedbacks) -> Message:
    return ros_pack_pb2.Feedbacks(fbs=chassis.actions.last.values())


@query(map_pack_pb2.SceneDataEasy)
def _scene_data_easy(chassis: Chassis, request: map_pack_pb2.SceneDataEasy) -> Message:
    return reports.scene_data_easy(named_scene(chassis, request.name))


@query(map_pack_pb2.SceneData)
def _scene_data(chassis: Chassis, request: map_pack_pb2.SceneData) -> Message:
    return reports.scene_data(named_scene(chassis, request.name))


def _answer_with(report: Callable[[Chassis], Message]) -> Handler:
    return lambda chassis, request: report(chassis)


for _request, _report in {
    **reports.STATES,
    **reports.PERIODIC,
    robot_pb2.RobotInfo: reports.robot_info,
    robot_pb2.General: reports.general,
    robot_pb2.TaskProc: reports.task_proc,
    robot_pb2.TaskHistory: reports.task_history,
    count_pb2.StatusCodes: reports.status_codes,
    map_pack_pb2.SceneList: reports.scene_list,
}.items():
    query(_request)(_answer_with(_report))


_PAGE_SIZE = 100
"""Maximum number of records of a page."""

_Count = pack.CountData


@query(pack.CountData)
def _count_data(chassis: Chassis, request: pack.CountData) -> Message:
    """Return records by their ids, or else a page of the records of a time span.

    The quantities count all matching records, also those on other pages.
    """
    _check_count_request(request)
    statistics = chassis.statistics
    statistics.update()
    days = _matching(request, _Count.kOperation, statistics.days, request.operation_id)
    tasks = _matching(request, _Count.kTask, statistics.tasks, request.task_id)
    statuses = _matching(request, _Count.kStatus, statistics.statuses, request.status_id)
    return pack.CountDataResponse(
        operations=count_pb2.Operations(ops=_page(request, days, request.operation_page)),
        tasks=count_pb2.Tasks(ts=_page(request, tasks, request.task_page)),
        abnormals=count_pb2.Abnormals(ss=_page(request, statuses, request.status_page)),
        operation_qty=len(days),
        task_qty=len(tasks),
        abnormal_qty=len(statuses),
    )


def _check_count_request(request: pack.CountData) -> None:
    """Raise RefusedError if a CountData has an unknown type, or an invalid page or time span."""
    if request.req_type not in (_Count.kGet, _Count.kSync):
        raise RefusedError(f"unknown request type {request.req_type}: 0 is get, 1 synchronise")
    if request.count_type not in _Count.CountType.values():
        raise RefusedError(
            f"unknown kind of statistics {request.count_type}: 0 is all, 1 operation, 2 task, "
            "3 status"
        )
    page = min(request.operation_page, request.task_page, request.status_page)
    if page < 0:
        raise RefusedError(f"page {page} is negative: count pages from 0")
    first, last = request.bucket.start, request.bucket.end
    if last and last < first:  # an end of 0 is no end
        raise RefusedError(f"the time span from {first} to {last} ends before it starts")


def _matching(
    request: pack.CountData, kind: int, records: Iterable[Any], ids: Sequence[int]
) -> list[Any]:
    """Return the records of one kind that a client wants; `ids` are the ids that it names."""
    if request.req_type == _Count.kSync:
        return [each for each in records if each.id in ids]
    if request.count_type not in (_Count.kAll, kind):
        return []
    first, last = request.bucket.start, request.bucket.end or math.inf
    wanted = []
    for each in records:
        span = each.buckets[0] if kind == _Count.kOperation else each.bucket
        if span.start <= last and (span.end or math.inf) >= first:  # an end of 0 is no end
            wanted.append(each)
    return wanted


def _page(request: pack.CountData, records: list[Any], page: int) -> list[Any]:
    """Return a page of records, or all records that a client has named."""
    is_by_id = request.req_type == _Count.kSync
    return records if is_by_id else records[page * _PAGE_SIZE : (page + 1) * _PAGE_SIZE]


@query(count_pb2.Operation)
def _operation(chassis: Chassis, request: count_pb2.Operation) -> Message:
    chassis.statistics.update()
    return copy_of(chassis.statistics.days[-1])


def _answer_with_last(records: Callable[[Chassis], Sequence[Message]]) -> Handler:
    """Return the handler that answers with the last record, or else with an empty one."""

    def handle(chassis: Chassis, request: Any) -> Message:
        found = records(chassis)
        return copy_of(found[-1]) if found else type(request)(robot_id=chassis.robot_id)

    return handle


query(count_pb2.StatusCode)(_answer_with_last(lambda chassis: chassis.codes.recent))
query(count_pb2.Task)(_answer_with_last(lambda chassis: chassis.statistics.tasks))
query(count_pb2.Status)(_answer_with_last(lambda chassis: chassis.statistics.statuses))
