"""Classification of requests: do they only read, command motion, or move the robot?"""

from __future__ import annotations

from google.protobuf.message import Message

from woosh_robot_agent.endpoints import COMMANDS, OWN_READS, QUERIES
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.pb.robot.robot_pack_pb2 import (
    ActionOrder,
    CountData,
    ExecPreTask,
    ExecTask,
    ExecTaskSet,
    Follow,
    RobotWiFi,
    Twist,
)
from woosh_robot_agent.pb.ros.action_pb2 import kCancel, kExecute, kPause, kResume
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction
from woosh_robot_agent.pb.task.woosh_task_pb2 import RepeatTask
from woosh_robot_agent.pb.util import action_pb2

_READS = {
    *(query.request for query in QUERIES),
    *(command.request for command in COMMANDS if command.reads),
    *OWN_READS,
}
"""Protobuf full names of the requests that only read, whatever they contain."""


def only_reads(request: Message) -> bool:
    """Return True if a request changes and moves nothing; False if in doubt."""
    if isinstance(request, RobotWiFi):
        return request == RobotWiFi(order=RobotWiFi.kWiFiList)
    if isinstance(request, CountData):
        return request.req_type == CountData.kGet
    return full_name(request) in _READS


TASK_REQUESTS = (ExecTask, ExecPreTask, ExecTaskSet, RepeatTask)
"""Types of the requests that start tasks. RepeatTask can also just edit a task set."""
_MOTION_TYPES = frozenset((Twist, CallAction, ActionOrder, Follow, *TASK_REQUESTS))
_RESTING_ORDERS = (action_pb2.kPause, action_pb2.kCancel)
"""Orders to the running task after which the robot stands."""
_DRIVING_ORDERS = (action_pb2.kStart, action_pb2.kContinue, action_pb2.kRecover)
"""Orders to the running task after which the robot drives by itself."""
_EDITING_ORDERS = (RepeatTask.kPut, RepeatTask.kDel)
"""Orders of RepeatTask that only change the list of predefined task sets."""
_DRIVING_MEMBERS = ("step_control", "move_base", "charge_control")
"""Members of the oneof of CallAction that drive the base."""


def commands_motion(request: Message) -> bool:
    """Return True if requests of this type start, change or end a motion."""
    return type(request) in _MOTION_TYPES


def may_move(request: Message) -> bool:
    """Return True if any part of the robot may move, or go on moving, because of the request."""
    if isinstance(request, Twist):
        return bool(request.linear or request.linear_y or request.angular)
    if isinstance(request, CallAction):
        which = request.WhichOneof("action")
        call = getattr(request, which) if which else None
        # a command without the field `action` counts as one that executes
        return getattr(call, "action", kExecute) not in (kCancel, kPause)
    if isinstance(request, ActionOrder):
        return request.order not in _RESTING_ORDERS
    if isinstance(request, Follow):
        return request.type  # False ends the following
    if isinstance(request, RepeatTask):
        return request.order not in _EDITING_ORDERS
    return isinstance(request, TASK_REQUESTS)


def started_by(request: Message) -> str:
    """Return what a request starts: "task", or an action by its short name.

    Empty if it starts nothing, or if the chassis does not report the start.
    """
    if isinstance(request, (Twist, Follow)) or not may_move(request):
        return ""
    if isinstance(request, CallAction):
        which = request.WhichOneof("action")
        return str(getattr(request, which).DESCRIPTOR.name) if which else ""
    return "task"


def takes_wheels(request: Message) -> bool:
    """Return True if the robot drives by itself once the chassis has accepted the request."""
    if isinstance(request, CallAction):
        return any(
            request.HasField(name) and getattr(request, name).action in (kExecute, kResume)
            for name in _DRIVING_MEMBERS
        )
    if isinstance(request, ActionOrder):
        return request.order in _DRIVING_ORDERS
    return may_move(request) and not isinstance(request, Twist)
