"""Handlers of queries. The query for a state is an empty message of the state's type."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.pb.map import map_pack_pb2
from woosh_robot_agent.pb.robot import robot_count_pb2, robot_pb2
from woosh_robot_agent.pb.ros import ros_pack_pb2
from woosh_robot_agent.pb.task import woosh_task_pb2
from woosh_robot_agent.simulator.chassis import Chassis
from woosh_robot_agent.simulator.protocol import reports
from woosh_robot_agent.simulator.protocol.handlers import (
    Handler,
    Handlers,
    Result,
    copy_of,
    named_scene,
)
from woosh_robot_agent.simulator.scenes.scene import Scene


def _answering(report: Callable[[Chassis], Message]) -> Handler:
    def handle(chassis: Chassis, request: Any) -> Result:
        return report(chassis)

    return handle


def _of_scene(report: Callable[[Scene], Message]) -> Handler:
    """Return the handler of a request that names a scene; the current one if its name is empty."""

    def handle(chassis: Chassis, request: Any) -> Result:
        return report(named_scene(chassis, request.name))

    return handle


def _repeat_tasks(chassis: Chassis) -> Message:
    return copy_of(chassis.scene.predefined)


def _call_tasks(chassis: Chassis) -> Message:
    return copy_of(chassis.scene.calls)


def _feedbacks(chassis: Chassis) -> Message:
    return ros_pack_pb2.Feedbacks(fbs=chassis.actions.last.values())


def _status_code(chassis: Chassis) -> Message:
    recent = chassis.codes.recent
    return copy_of(recent[-1]) if recent else robot_count_pb2.StatusCode(robot_id=chassis.robot_id)


HANDLERS: Handlers = {
    cls: _answering(report)
    for cls, report in {
        **reports.STATES,
        **reports.PERIODIC,
        robot_pb2.RobotInfo: reports.robot_info,
        robot_pb2.General: reports.general,
        robot_pb2.TaskProc: reports.task_proc,
        robot_pb2.TaskHistory: reports.task_history,
        robot_count_pb2.StatusCodes: reports.status_codes,
        robot_count_pb2.StatusCode: _status_code,
        map_pack_pb2.SceneList: reports.scene_list,
        woosh_task_pb2.RepeatTasks: _repeat_tasks,
        woosh_task_pb2.CallTasks: _call_tasks,
        ros_pack_pb2.Feedbacks: _feedbacks,
    }.items()
} | {
    map_pack_pb2.SceneDataEasy: _of_scene(reports.scene_data_easy),
    map_pack_pb2.SceneData: _of_scene(reports.scene_data),
}
