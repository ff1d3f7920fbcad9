"""Requests that command the robot: where it is, its modes, its map, its speed, its voice."""

from __future__ import annotations

import dataclasses

from woosh_robot_agent.pb.robot import robot_pack_pb2 as pack
from woosh_robot_agent.pb.ros import ros_pack_pb2
from woosh_robot_agent.pb.util import robot_pb2 as util_robot_pb2
from woosh_robot_agent.simulator.body.base import STANDSTILL, Velocity
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.errors import RefusedError
from woosh_robot_agent.simulator.protocol import reports, uploads
from woosh_robot_agent.simulator.protocol.handlers import Handlers, Result, pose
from woosh_robot_agent.simulator.scenes.scene import Scene
from woosh_robot_agent.simulator.world.footprints import FOOTPRINTS

_MAX_SCENES = 20
_LONGEST_SPEECH = 1000


def _init_robot(chassis: Chassis, request: pack.InitRobot) -> Result:
    # A record counts for more than a pose: clients may send both, the pose empty.
    where = chassis.base.pose if request.is_record else pose(request.pose)
    chassis.localise(where)
    reason = "robot was initialised"
    chassis.ownership.end_driving(reason)
    chassis.base.halt()
    if chassis.tasks.active:
        chassis.tasks.cancel(reason)
    chassis.readiness.initialised = True
    return None


def _set_robot_pose(chassis: Chassis, request: pack.SetRobotPose) -> Result:
    if not chassis.readiness.initialised:
        raise RefusedError("robot is not initialised: InitRobot first")
    chassis.localise(pose(request.pose))
    return None


def _set_occupancy(chassis: Chassis, request: pack.SetOccupancy) -> Result:
    chassis.occupied = request.occupy
    return None


def _set_mute_call(chassis: Chassis, request: pack.SetMuteCall) -> Result:
    chassis.call_muted = request.mute
    return None


def _set_program_mute(chassis: Chassis, request: pack.SetProgramMute) -> Result:
    chassis.program_muted = request.mute
    return None


def _switch_control_mode(chassis: Chassis, request: pack.SwitchControlMode) -> Result:
    known = (util_robot_pb2.kAuto, util_robot_pb2.kManual, util_robot_pb2.kMaintain)
    if request.mode not in known:
        raise RefusedError(
            f"unknown control mode {request.mode}: 1 is automatic, 2 manual, 3 maintenance"
        )
    if chassis.readiness.key_manual and request.mode != util_robot_pb2.kManual:
        raise RefusedError("key switch stands at manual: turn it to automatic first")
    chassis.readiness.ctrl = request.mode
    return reports.mode(chassis)


def _switch_work_mode(chassis: Chassis, request: pack.SwitchWorkMode) -> Result:
    known = (
        util_robot_pb2.kDeployMode,
        util_robot_pb2.kTaskMode,
        util_robot_pb2.kScheduleMode,
    )
    if request.mode not in known:
        raise RefusedError(f"unknown work mode {request.mode}: 1 is deployment, 2 task, 3 schedule")
    chassis.readiness.work = request.mode
    return reports.mode(chassis)


def _switch_foot_print(chassis: Chassis, request: pack.SwitchFootPrint) -> Result:
    if request.type not in FOOTPRINTS:
        raise RefusedError(
            f"unknown foot print {request.type}: the known ones are {list(FOOTPRINTS)}"
        )
    chassis.footprint = request.type
    if chassis.ownership.navigation:
        chassis.ownership.navigation.replan()
    return pack.SwitchFootPrint(type=chassis.footprint)


def _switch_map(chassis: Chassis, request: pack.SwitchMap) -> Result:
    # What is paused would go on to where it wanted to on the old map.
    if chassis.tasks.paused:
        raise RefusedError(f"task {chassis.tasks.proc.robot_task_id} is paused: cancel it first")
    if chassis.tasks.active:
        raise RefusedError("a task is running: wait for it or cancel it first")
    if chassis.ownership.driver:
        raise RefusedError(f"{chassis.ownership.driver} is driving: wait for it or cancel it first")
    if chassis.ownership.navigation:
        raise RefusedError("a navigation is paused: cancel it first")
    name = request.scene_name or chassis.scene.name
    scene = _with_files(chassis, name, request) if request.file_datas else chassis.scenes.get(name)
    if scene is None:
        raise RefusedError(
            f"unknown scene {name}: it comes with file_datas, or is one of these: "
            + ", ".join(chassis.scenes)
        )
    wanted = request.map_name or uploads.first_map(scene, request.file_datas)
    area = scene.map(wanted)
    if area is None:
        maps = ", ".join(each.name for each in scene.maps)
        raise RefusedError(f"unknown map {wanted} of scene {name}, which has {maps}")
    chassis.enter(scene, area)
    return None


def _with_files(chassis: Chassis, name: str, request: pack.SwitchMap) -> Scene:
    """The scene as it is after the upload: one version further, or new."""
    old = chassis.scenes.get(name)
    if not old and len(chassis.scenes) >= _MAX_SCENES:
        raise RefusedError(f"there are {_MAX_SCENES} scenes already")
    files = uploads.checked(old.files if old else {}, request.file_datas)
    scene = uploads.described(name, old, files)
    if scene:
        return scene
    # The robot still stands in the same building, whatever the files call it.
    area = dataclasses.replace(chassis.map, name=request.map_name or name, version=1)
    return dataclasses.replace(chassis.scene, name=name, maps=[area], files=files)


def _speak(chassis: Chassis, request: pack.Speak) -> Result:
    chassis.spoken.append(request.text[:_LONGEST_SPEECH])
    return None


def _twist(chassis: Chassis, request: pack.Twist) -> Result:
    velocity = Velocity(request.linear, request.linear_y, request.angular)
    if velocity == STANDSTILL:
        driver = chassis.ownership.driver
        chassis.ownership.stop_wheels("stopped by a velocity of zero")
        return f"stopped: {driver} is paused, continue or cancel it" if driver else None
    if chassis.readiness.emergency_stop:
        raise RefusedError("emergency stop is pressed: release it first")
    if chassis.readiness.battery_empty:
        raise RefusedError("battery is empty: charge first")
    if chassis.readiness.control == util_robot_pb2.kMaintain:
        raise RefusedError("robot is in maintenance mode: switch to automatic or manual first")
    if velocity.left and not chassis.omnidirectional:
        raise RefusedError("a differential base cannot move sideways: linear_y must be 0")
    chassis.ownership.drive(velocity)
    return None


def _follow(chassis: Chassis, request: pack.Follow) -> Result:
    if request.type:
        chassis.readiness.require_ready()
        chassis.ownership.follow()
    else:
        chassis.follower.stop()
    return None


def _wifi(chassis: Chassis, request: pack.RobotWiFi) -> Result:
    wifi, order = chassis.wifi, request.order
    answer = pack.RobotWiFi(order=order)
    if order == pack.RobotWiFi.kWiFiList:
        answer.content = wifi.scan()
        text = answer.content.decode()
        feedback = ros_pack_pb2.Feedback(state=ros_pack_pb2.kRosWiFiJson, msg=text)
        chassis.emit(ros_pack_pb2.Feedbacks(fbs=[feedback]))
    elif order == pack.RobotWiFi.kAdd:
        wifi.add(request.content, connect=request.is_connect_now)
    elif order == pack.RobotWiFi.kReconnect:
        wifi.reconnect(request.content)
    elif order == pack.RobotWiFi.kForget:
        wifi.forget(request.content)
    elif order == pack.RobotWiFi.kHotspot:
        wifi.switch_hotspot(on=request.enable)
        answer.enable = request.enable
    else:
        raise RefusedError(
            f"unknown WiFi order {order}: 1 is list, 2 add, 3 reconnect, 4 forget, 5 hotspot"
        )
    return answer


HANDLERS: Handlers = {
    pack.InitRobot: _init_robot,
    pack.SetRobotPose: _set_robot_pose,
    pack.SetOccupancy: _set_occupancy,
    pack.SetMuteCall: _set_mute_call,
    pack.SetProgramMute: _set_program_mute,
    pack.SwitchControlMode: _switch_control_mode,
    pack.SwitchWorkMode: _switch_work_mode,
    pack.SwitchFootPrint: _switch_foot_print,
    pack.SwitchMap: _switch_map,
    pack.Speak: _speak,
    pack.Twist: _twist,
    pack.Follow: _follow,
    pack.RobotWiFi: _wifi,
}
