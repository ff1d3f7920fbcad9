"""Which requests hand the wheels over to the chassis itself."""

from __future__ import annotations

from google.protobuf.message import Message

from woosh_robot_agent.pb.robot.robot_pack_pb2 import ExecPreTask, ExecTask
from woosh_robot_agent.pb.ros.action_pb2 import kExecute
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction


def takes_wheels(request: Message) -> bool:
    """Whether the robot drives by itself once the chassis has accepted `request`."""
    if isinstance(request, CallAction):
        return any(
            request.HasField(name) and getattr(request, name).action == kExecute
            for name in ("step_control", "move_base")
        )
    return isinstance(request, ExecTask | ExecPreTask)
