"""One request of each kind that moves the robot."""

from __future__ import annotations

from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.pb.robot.robot_pack_pb2 import (
    ActionOrder,
    ExecPreTask,
    ExecTask,
    ExecTaskSet,
    Follow,
    Twist,
)
from woosh_robot_agent.pb.ros.action_pb2 import kExecute
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction
from woosh_robot_agent.pb.task.woosh_task_pb2 import RepeatTask
from woosh_robot_agent.pb.util.action_pb2 import kContinue


def _calls() -> list[Message]:
    calls: list[Message] = []
    for field in CallAction.DESCRIPTOR.oneofs_by_name["action"].fields:
        call: Any = CallAction()
        member = getattr(call, field.name)
        member.SetInParent()
        if "action" in field.message_type.fields_by_name:
            member.action = kExecute
        calls.append(call)
    return calls


MOVING: tuple[Message, ...] = (
    Twist(linear=0.1),
    Twist(linear_y=0.1),
    Twist(angular=0.1),
    ExecTask(task_id=1),
    ExecPreTask(task_set_id=1),
    ExecTaskSet(repeat_times=1),
    ActionOrder(order=kContinue),
    Follow(type=True),
    RepeatTask(order=RepeatTask.kExec),
    RepeatTask(),
    *_calls(),
)
