"""Handlers of queries, and of requests that change settings or modes."""

from __future__ import annotations

from collections.abc import Callable

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


_MAX_SPEECH = 1000
"""Number of characters of a spoken text that are kept; the rest is cut off."""


@command(pack.Speak)
def _speak(chassis: Chassis, request: pack.Speak) -> None:
    chassis.spoken.append(request.text[:_MAX_SPEECH])


_MAX_LIGHT = 15
"""Maximum number of a submodule of the lights. The schema does not say which submodules exist."""


@command(pack.LED)
def _led(chassis: Chassis, request: pack.LED) -> Message:
    if request.submodule > _MAX_LIGHT:
        raise RefusedError(
            f"unknown submodule {request.submodule} of the lights: use 0 to {_MAX_LIGHT}"
        )
    chassis.lights[request.submodule] = request
    return request


_WIFI_LIST = b'{"wifi_list": [{"ssid": "woosh-factory", "signal": 78, "connected": true}]}'
"""The Wi-Fi networks within reach. The documents do not show the form of a real list."""


@command(pack.RobotWiFi)
def _wifi(chassis: Chassis, request: pack.RobotWiFi) -> Message:
    """Answer every order as if it were carried out. The network stays as it is."""
    content = _WIFI_LIST if request.order == pack.RobotWiFi.kWiFiList else b""
    return pack.RobotWiFi(order=request.order, enable=request.enable, content=content)


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


@query(count_pb2.StatusCode)
def _last_status_code(chassis: Chassis, request: count_pb2.StatusCode) -> Message:
    recent = chassis.codes.recent
    return copy_of(recent[-1]) if recent else count_pb2.StatusCode(robot_id=chassis.robot_id)


# The simulated robot keeps no statistics.
query(pack.CountData)(lambda chassis, request: pack.CountDataResponse())
for _record in (count_pb2.Operation, count_pb2.Task, count_pb2.Status):
    query(_record)(lambda chassis, request: type(request)(robot_id=chassis.robot_id))
