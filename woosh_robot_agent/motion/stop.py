"""The requests that make up a stop, and the chassis's answers to them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from google.protobuf.message import Message

from woosh_robot_agent.link import Answer, LinkError
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ActionOrder
from woosh_robot_agent.pb.ros.action_pb2 import kCancel as CANCEL_ACTION
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction
from woosh_robot_agent.pb.util.action_pb2 import kCancel as CANCEL_TASK


def cancel_orders() -> dict[str, Message]:
    """Return the requests that cancel the task and the actions, by the name of each.

    The actions are those members of the oneof of CallAction that can be cancelled.
    """
    orders: dict[str, Message] = {"task": ActionOrder(order=CANCEL_TASK)}
    for field in CallAction.DESCRIPTOR.oneofs_by_name["action"].fields:
        if field.message_type is not None and "action" in field.message_type.fields_by_name:
            call: Any = CallAction()
            getattr(call, field.name).SetInParent()
            getattr(call, field.name).action = CANCEL_ACTION
            orders[field.message_type.name] = call
    return orders


@dataclass(frozen=True)
class StopReport:
    """Answers of the chassis to the requests of a stop.

    Attributes:
        zero: the answer to the zero velocity, or the error if there is none.
        cancels: the answer or error of each cancel request, by the name of the task or action.
    """

    zero: Answer | LinkError
    cancels: dict[str, Answer | LinkError]

    @property
    def success(self) -> bool:
        """True if the chassis confirmed the zero and answered each cancel.

        The chassis refuses to cancel something that is not running; that is no failure.
        """
        return _is_ok(self.zero) and not self._lost

    @property
    def message(self) -> str:
        """Human-readable result, with advice if the stop failed."""
        parts = ["stopped" if _is_ok(self.zero) else f"NOT STOPPED: {_reason(self.zero)}"]
        parts += [f"{name} cancelled" for name, answer in self.cancels.items() if _is_ok(answer)]
        if not self.success:
            parts += [*self._lost[:1], "if the robot moves, press its emergency stop"]
        return "; ".join(parts)

    @property
    def _lost(self) -> list[str]:
        return [
            f"cancel of {name}: {answer}"
            for name, answer in self.cancels.items()
            if isinstance(answer, LinkError)
        ]


def _is_ok(answer: Answer | LinkError) -> bool:
    return isinstance(answer, Answer) and answer.ok


def _reason(answer: Answer | LinkError) -> str:
    return answer.msg if isinstance(answer, Answer) else str(answer)
