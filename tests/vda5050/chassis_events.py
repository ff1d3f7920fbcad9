"""What a vehicle has sent to its chassis, and what it has told about its actions."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from tests.vda5050.broker import Recorder
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ActionOrder, ExecTask
from woosh_robot_agent.pb.ros import action_pb2
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction
from woosh_robot_agent.pb.util import action_pb2 as order_pb2
from woosh_robot_agent.pb.util import task_pb2 as task
from woosh_robot_agent.simulator import SimulatorThread

_CONTROLS = {
    action_pb2.kCancel: "cancel",
    action_pb2.kExecute: "execute",
    action_pb2.kPause: "pause",
    action_pb2.kResume: "resume",
}
_ORDERS = {order_pb2.kPause: "pause", order_pb2.kContinue: "continue", order_pb2.kCancel: "cancel"}
_TASKS = {task.kPick: "drive", task.kCharge: "charge", task.kCarry: "carry"}


def received(chassis: SimulatorThread, kind: type[Any]) -> list[Any]:
    """Messages of a type that the chassis has received."""
    return [each.message for each in chassis.received if isinstance(each.message, kind)]


def commands(chassis: SimulatorThread) -> list[str]:
    """Commands that the chassis has received, in their sequence, e.g. `lift_control3 execute`."""
    texts = []
    for _, message in chassis.received:
        if isinstance(message, ExecTask):
            texts.append(f"{_TASKS[message.type]} {message.mark_no}".strip())
        elif isinstance(message, ActionOrder):
            texts.append(_ORDERS[message.order])
        elif isinstance(message, CallAction):
            which = message.WhichOneof("action")
            assert which is not None
            texts.append(f"{which} {_CONTROLS[getattr(message, which).action]}")
    return texts


def statuses(recorder: Recorder, action_id: str) -> list[str]:
    """Statuses of an action in the sequence of the published states, without repetitions."""
    found: list[str] = []
    for state in recorder.sent("state"):
        for each in state["actionStates"]:
            if each["actionId"] == action_id and each["actionStatus"] not in found[-1:]:
                found.append(each["actionStatus"])
    return found


def together(recorder: Recorder, action_ids: Iterable[str]) -> bool:
    """Return True if a published state shows all these actions as running."""
    wanted = set(action_ids)
    return any(
        wanted
        <= {each["actionId"] for each in state["actionStates"] if each["actionStatus"] == "RUNNING"}
        for state in recorder.sent("state")
    )
