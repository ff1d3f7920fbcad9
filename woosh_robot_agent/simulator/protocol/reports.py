"""Reports: messages that describe the state of the robot, and the times of their pushes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from google.protobuf.message import Message

from woosh_robot_agent.pb.device import device_pb2
from woosh_robot_agent.pb.map import field_pb2, map_pack_pb2, mark_pb2, path_pb2
from woosh_robot_agent.pb.robot import robot_count_pb2, robot_pack_pb2, robot_pb2
from woosh_robot_agent.pb.ros import ros_pack_pb2
from woosh_robot_agent.pb.util import common_pb2, navigation_pb2
from woosh_robot_agent.pb.util import robot_pb2 as util_robot_pb2
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.scenes.scene import (
    KEEPOUT,
    MARK_INFO,
    NAV_AREA,
    PATH_INFO,
    PICTURE,
    TRAFFIC_KEEPOUT,
    Scene,
    end_of,
    files_of,
    mark_info_of,
    storages_of,
    task_info_of,
)
from woosh_robot_agent.simulator.timeline import ROUNDING, copy_of
from woosh_robot_agent.simulator.world.geometry import Pose
from woosh_robot_agent.simulator.world.maps import Map

_Hardware = robot_pb2.HardwareState
_Device = robot_pb2.DeviceState
_Operation = robot_pb2.OperationState


def pose2d(pose: Pose) -> common_pb2.Pose2D:
    """Convert a pose to a message."""
    return common_pb2.Pose2D(x=pose.x, y=pose.y, theta=pose.theta)


def general(chassis: Chassis) -> robot_pb2.General:
    """Return the model and the versions of the robot."""
    model = chassis.profile.model
    return robot_pb2.General(
        robot_id=chassis.robot_id,
        type=util_robot_pb2.kBaseRobot_200,
        model_data=robot_pb2.General.ModelData(
            length=model.length,
            width=model.width,
            height=model.height,
            weight=model.weight,
            load=model.load,
        ),
        urdf_name=model.urdf_name,
        display_model=model.display_model,
        serial_number=chassis.robot_id,
        service_id="RB2000030100000000Z",
        driver_method=1 if chassis.omnidirectional else 0,
        version=robot_pb2.General.Version(system="UROS20210720", rc="1.0.0-1"),
    )


def robot_state(chassis: Chassis) -> robot_pb2.RobotState:
    """Return the state of the robot."""
    return robot_pb2.RobotState(robot_id=chassis.robot_id, state=chassis.state)


def mode(chassis: Chassis) -> robot_pb2.Mode:
    """Return the effective control mode, and the work mode."""
    readiness = chassis.readiness
    return robot_pb2.Mode(robot_id=chassis.robot_id, ctrl=readiness.control, work=readiness.work)


def pose_speed(chassis: Chassis) -> robot_pb2.PoseSpeed:
    """Return the pose, the velocity and the odometer, in whole metres.

    The message has no field for a velocity sideways.
    """
    base = chassis.base
    return robot_pb2.PoseSpeed(
        robot_id=chassis.robot_id,
        twist=common_pb2.Twist(linear=base.velocity.forward, angular=base.velocity.turn),
        pose=pose2d(chassis.pose),
        map_id=chassis.map.id,
        mileage=int(base.odometer),
    )


def battery(chassis: Chassis) -> robot_pb2.Battery:
    """Return charge and state of charging."""
    values = chassis.battery.profile
    return robot_pb2.Battery(
        robot_id=chassis.robot_id,
        charge_state=chassis.battery.charging,
        power=chassis.battery.percent,
        health=values.health,
        charge_cycle=values.charge_cycle,
        battery_cycle=values.battery_cycle,
        temp_max=values.temp_max,
    )


def network(chassis: Chassis) -> robot_pb2.Network:
    """Return address and Wi-Fi, which never change."""
    wifi = robot_pb2.Network.WiFi(
        name="woosh-factory", strength=78, mode=robot_pb2.Network.WiFi.kClient
    )
    return robot_pb2.Network(robot_id=chassis.robot_id, robot_ip="172.20.254.63", wifi=wifi)


def scene(chassis: Chassis) -> robot_pb2.Scene:
    """Return the current scene and map."""
    return robot_pb2.Scene(
        robot_id=chassis.robot_id,
        scene_name=chassis.scene.name,
        map_id=chassis.map.id,
        map_name=chassis.map.name,
        version=chassis.map.version,
    )


def task_proc(chassis: Chassis) -> robot_pb2.TaskProc:
    """Return the last report about a task."""
    proc = robot_pb2.TaskProc(robot_id=chassis.robot_id)
    proc.MergeFrom(chassis.tasks.reported)
    return proc


def task_history(chassis: Chassis) -> robot_pb2.TaskHistory:
    """Return the last ended tasks."""
    return robot_pb2.TaskHistory(tes=chassis.tasks.history)


def device_state(chassis: Chassis) -> robot_pb2.DeviceState:
    """Return the emergency stop button and the flags, one bit each."""
    flags = (
        (chassis.readiness.located, _Device.kLocation),
        (chassis.jack.raised, _Device.kGoodsState),
        (chassis.occupied, _Device.kOccupancy),
        (chassis.call_muted, _Device.kMuteCall),
        (chassis.program_muted, _Device.kProgramMute),
    )
    return robot_pb2.DeviceState(
        robot_id=chassis.robot_id,
        hardware=_Device.kEmgBtn if chassis.readiness.emergency_stop else 0,
        software=sum(bit for is_set, bit in flags if is_set),
    )


def hardware_state(chassis: Chassis) -> robot_pb2.HardwareState:
    """Return the health of the devices."""
    normal = _Hardware.kNormal
    return robot_pb2.HardwareState(
        robot_id=chassis.robot_id,
        esb=_Hardware.kWarn if chassis.readiness.emergency_stop else normal,
        motor=[normal] * 2,
        lidar=[normal] * 2,
        camera=[normal] * 2,
        sonar=[normal] * 24,
        lift=[normal] * 2,
        roller=[normal] * 2,
    )


def operation_state(chassis: Chassis) -> robot_pb2.OperationState:
    """Return whether the robot accepts tasks, and whether an obstacle is in its way."""
    return _Operation(
        robot_id=chassis.robot_id,
        nav=_Operation.kImpede if chassis.impeded else 0,
        robot=_Operation.kTaskable if chassis.readiness.ready else 0,
    )


def model(chassis: Chassis) -> robot_pb2.Model:
    """Return the current footprint."""
    points = [common_pb2.Point(x=x, y=y) for x, y in chassis.outline]
    return robot_pb2.Model(robot_id=chassis.robot_id, model=points, type=chassis.footprint)


def status_codes(chassis: Chassis) -> robot_count_pb2.StatusCodes:
    """Return the last status codes, including those of problems that are over."""
    return robot_count_pb2.StatusCodes(robot_id=chassis.robot_id, scs=chassis.codes.recent)


def abnormal_codes(chassis: Chassis) -> robot_count_pb2.AbnormalCodes:
    """Return the status codes of the current problems."""
    return robot_count_pb2.AbnormalCodes(robot_id=chassis.robot_id, scs=chassis.codes.abnormal)


def nav_path(chassis: Chassis) -> robot_pb2.NavPath:
    """Return the path of the running or paused navigation; empty without one."""
    path = navigation_pb2.Path()
    if chassis.ownership.navigation:
        path.poses.extend(map(pose2d, chassis.ownership.navigation.path))
    return robot_pb2.NavPath(robot_id=chassis.robot_id, path=path)


def plan_path(chassis: Chassis) -> robot_pb2.PlanPath:
    """Return the path of the running or paused navigation with its target; empty without one."""
    plan = robot_pb2.PlanPath(robot_id=chassis.robot_id)
    if chassis.ownership.navigation:
        plan.plan_path.add(
            path=nav_path(chassis).path,
            map_id=chassis.map.id,
            dest_map_id=chassis.map.id,
            target=pose2d(chassis.ownership.navigation.goal),
        )
    return plan


def robot_info(chassis: Chassis) -> robot_pb2.RobotInfo:
    """Return all states of the robot in one message."""
    return robot_pb2.RobotInfo(
        robot_id=chassis.robot_id,
        genral=general(chassis),  # the misspelling is that of the schema
        setting=chassis.setting,
        state=chassis.state,
        mode=mode(chassis),
        pose_speed=pose_speed(chassis),
        battery=battery(chassis),
        network=network(chassis),
        scene=scene(chassis),
        task_proc=task_proc(chassis),
        device_state=device_state(chassis),
        hardware_state=hardware_state(chassis),
        operation_state=operation_state(chassis),
        model=model(chassis),
        task_history=task_history(chassis),
        status_codes=status_codes(chassis),
        abnormal_codes=abnormal_codes(chassis),
    )


def scanner_data(chassis: Chassis) -> robot_pb2.ScannerData:
    """Return the last scan of the laser, and the pose at which the robot made it."""
    laser = chassis.laser
    return robot_pb2.ScannerData(
        robot_id=chassis.robot_id,
        angle_min=laser.angle_min,
        angle_max=laser.angle_max,
        angle_increment=laser.increment,
        scan_time=laser.scan_time,
        range_min=laser.range_min,
        range_max=laser.range_max,
        ranges=chassis.scan(),
        pose=pose2d(chassis.scan_pose),
        offset=common_pb2.Vector3(x=laser.forward),
    )


def build_map_data(chassis: Chassis) -> robot_pack_pb2.BuildMapData:
    """Return the map that is being made; empty while no scans are added to a map.

    In the picture, 0 is occupied, 254 free and 205 unknown. The marks are a serialised MarkInfo.
    """
    mapping = chassis.mapping
    raster = mapping.raster
    if raster is None:
        return robot_pack_pb2.BuildMapData()
    # numpy and Pillow load slowly, and only pictures need them.
    from woosh_robot_agent.simulator.world.picture import png

    height, width = raster.cells.shape
    return robot_pack_pb2.BuildMapData(
        map_data=png(raster.cells),
        width=width,
        height=height,
        origin_x=raster.low[0],
        origin_y=raster.low[1],
        resolution=raster.resolution,
        mark_data=mark_info_of(mapping.draft or chassis.map).SerializeToString(),
    )


def scene_data_easy(scene: Scene) -> map_pack_pb2.SceneDataEasy:
    """Return the maps of a scene with their marks."""
    return map_pack_pb2.SceneDataEasy(
        name=scene.name,
        maps=[
            map_pack_pb2.SceneDataEasy.Map(
                id=each.id,
                name=each.name,
                floor=each.floor,
                version=each.version,
                storages=storages_of(each.marks.values()),
            )
            for each in scene.maps
        ],
    )


def scene_data(scene: Scene) -> map_pack_pb2.SceneData:
    """Return the maps of a scene with their pictures and marks, and the tasks of the scene.

    In the pictures 0 is occupied, 254 free and 205 unknown, as in pictures of nav2's map_saver.
    """
    files = files_of(scene).of_maps
    return map_pack_pb2.SceneData(
        name=scene.name,
        maps=[_map_data(each, files[each.name], end_of(scene, each)) for each in scene.maps],
        task_info=task_info_of(scene),
        action_group=scene.action_groups.data.decode(errors="replace"),
    )


def scene_list(chassis: Chassis) -> map_pack_pb2.SceneList:
    """Return the names of all scenes and maps."""
    return map_pack_pb2.SceneList(
        scenes=[
            map_pack_pb2.SceneList.Scene(name=each.name, maps=[area.name for area in each.maps])
            for each in chassis.scenes.values()
        ]
    )


def _map_data(
    area: Map, files: Mapping[str, bytes], end: Pose | None
) -> map_pack_pb2.SceneData.Map:
    """Return a map with its `files`; `end` is the last pose of the robot on the map."""
    # numpy and Pillow load slowly, and only pictures need them.
    from woosh_robot_agent.simulator.world.picture import draw

    def file(name: str) -> bytes:
        return files.get(f"{area.name}/{name}", b"")

    # A grid and a drawn picture both have `low` and `resolution`.
    picture = area.grid or draw(area)
    x, y = picture.low
    return map_pack_pb2.SceneData.Map(
        id=area.id,
        name=area.name,
        resolution=picture.resolution,
        origin=common_pb2.Pose2D(x=x, y=y),
        end=pose2d(end) if end else None,
        map_png=file(PICTURE),
        keepout_png=file(KEEPOUT),
        traffic_keepout_png=file(TRAFFIC_KEEPOUT),
        mark_info=mark_pb2.MarkInfo.FromString(file(MARK_INFO)),
        field_info=field_pb2.FieldInfo.FromString(file(NAV_AREA)) if file(NAV_AREA) else None,
        path_info=path_pb2.PathInfo.FromString(file(PATH_INFO)) if file(PATH_INFO) else None,
    )


STATES: dict[type[Message], Callable[[Chassis], Message]] = {
    robot_pb2.Setting: lambda chassis: copy_of(chassis.setting),
    robot_pb2.RobotState: robot_state,
    robot_pb2.Mode: mode,
    robot_pb2.PoseSpeed: pose_speed,
    robot_pb2.Battery: battery,
    robot_pb2.Network: network,
    robot_pb2.Scene: scene,
    robot_pb2.DeviceState: device_state,
    robot_pb2.HardwareState: hardware_state,
    robot_pb2.OperationState: operation_state,
    robot_pb2.Model: model,
    robot_count_pb2.AbnormalCodes: abnormal_codes,
    robot_pb2.NavPath: nav_path,
    robot_pb2.PlanPath: plan_path,
    device_pb2.RfRemoteController: lambda chassis: chassis.remote_controller,
}
"""Reports that are pushed when they change, by their message class."""

PERIODIC: dict[type[Message], Callable[[Chassis], Message]] = {
    robot_pb2.ScannerData: scanner_data,
    robot_pack_pb2.BuildMapData: build_map_data,
}
"""Reports that are pushed periodically, even if nothing has changed, by their message class."""


_STATES = {cls.DESCRIPTOR.full_name: report for cls, report in STATES.items()}
_PERIODIC = {cls.DESCRIPTOR.full_name: report for cls, report in PERIODIC.items()}
"""The same reports, by topic: the full protobuf name of the message."""

_POSE_SPEED = robot_pb2.PoseSpeed.DESCRIPTOR.full_name
_BATTERY = robot_pb2.Battery.DESCRIPTOR.full_name

_DUE_TIMES: dict[str, Callable[[Chassis], float]] = {
    robot_pb2.ScannerData.DESCRIPTOR.full_name: lambda chassis: chassis.pushed_scan_time,
    robot_pack_pb2.BuildMapData.DESCRIPTOR.full_name: lambda chassis: chassis.mapping.picture_time,
}
"""Functions that return when a periodic report was last due, in simulated seconds, by topic."""

_EVENTS = {
    cls.DESCRIPTOR.full_name
    for cls in (
        robot_pb2.TaskProc,
        robot_count_pb2.StatusCode,
        robot_count_pb2.Operation,
        robot_count_pb2.Task,
        robot_count_pb2.Status,
        ros_pack_pb2.Feedbacks,
    )
}
"""Messages that are pushed each time they are emitted, even if nothing has changed.

Only tests push Operation, Task and Status: the simulated robot keeps no statistics.
"""

TOPICS = frozenset(_STATES) | frozenset(_PERIODIC) | _EVENTS
"""Full protobuf names of all messages that a client can subscribe to."""


class StateWatch:
    """Detects which of the watched states have changed since the last call of `take_changes`.

    It limits the rate of PoseSpeed, and repeats an unchanged Battery, both as in the profile.
    """

    def __init__(self, chassis: Chassis) -> None:
        self._chassis = chassis
        self._last: dict[str, bytes] = {}
        """Last known state of each watched topic, serialized."""
        self._due: dict[str, float] = {}
        """Simulated time at which each watched periodic report was last due, in seconds."""
        self._next_pose = 0.0
        """Simulated time from which PoseSpeed may be pushed again, in seconds."""
        self._repeat_battery = math.inf
        """Simulated time at which an unchanged Battery is pushed again, in seconds."""

    def watch(self, topics: set[str]) -> None:
        """Watch these topics only. The current state of an additional topic is no change."""
        if _BATTERY in topics and _BATTERY not in self._last:
            self._schedule_battery()
        known = self._last
        self._last = {
            topic: known[topic] if topic in known else report(self._chassis).SerializeToString()
            for topic, report in _STATES.items()
            if topic in topics
        }
        self._due = {
            topic: self._due.get(topic, due(self._chassis))
            for topic, due in _DUE_TIMES.items()
            if topic in topics
        }

    def take_changes(self, *, while_moving: bool) -> list[Message]:
        """Return the periodic reports that are due and the states that have changed, once each.

        Args:
            while_moving: False to leave out PoseSpeed, which each step of a moving robot changes.
        """
        messages = []
        for topic, last_due in self._due.items():
            due = _DUE_TIMES[topic](self._chassis)
            if due != last_due:
                self._due[topic] = due
                messages.append(_PERIODIC[topic](self._chassis))
        due_until = self._chassis.elapsed + ROUNDING
        pose_is_due = while_moving and self._next_pose <= due_until
        battery_is_due = self._repeat_battery <= due_until
        for topic, last in self._last.items():
            if topic == _POSE_SPEED and not pose_is_due:
                continue
            message = _STATES[topic](self._chassis)
            now = message.SerializeToString()
            if now != last or (topic == _BATTERY and battery_is_due):
                self._last[topic] = now
                messages.append(message)
                if topic == _POSE_SPEED:
                    self._next_pose = self._wake_after(self._chassis.profile.rates.pose_speed)
                elif topic == _BATTERY:
                    self._schedule_battery()
        return messages

    def _schedule_battery(self) -> None:
        period = self._chassis.profile.rates.battery
        if period:
            self._repeat_battery = self._wake_after(period.sample(self._chassis.rng))

    def _wake_after(self, delay: float) -> float:
        """Schedule another check for changes in `delay` seconds; return its simulated time."""
        if delay > 0.0:
            self._chassis.after(delay, lambda: None)  # changes are reported after each call
        return self._chassis.elapsed + delay
