"""stop: zero velocity and the end of everything that moves the robot, before all else."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Iterator
from functools import partial
from typing import Any

from google.protobuf.message import Message
from std_srvs.srv import Trigger

from woosh_robot_agent.bridge import Reply
from woosh_robot_agent.link import Answer, LinkError
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ActionOrder, Twist
from woosh_robot_agent.pb.ros.action_pb2 import kCancel as CANCEL_ACTION
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction
from woosh_robot_agent.pb.util.action_pb2 import kCancel as CANCEL_TASK
from woosh_robot_agent.standard.cmd_vel import CmdVel
from woosh_robot_agent.standard.part import Part
from woosh_robot_agent.standard.part_context import PartContext

_LOG = logging.getLogger(__name__)
_TIMEOUT_S = 2.0
_STOPPED = "the service stop took its place"
_HOLD_S = 0.5
"""For so long nothing that moves the robot is sent: a goal that was asked for before the stop may
come to the link after it."""


def cancels() -> Iterator[tuple[str, Message]]:
    """The requests that end whatever moves the robot, each with a name for people.

    Which actions there are is said by the oneof of CallAction.
    """
    yield "task", ActionOrder(order=CANCEL_TASK)
    for field in CallAction.DESCRIPTOR.oneofs_by_name["action"].fields:
        if field.message_type is not None and "action" in field.message_type.fields_by_name:
            call: Any = CallAction()
            getattr(call, field.name).SetInParent()
            getattr(call, field.name).action = CANCEL_ACTION
            yield field.message_type.name, call


class Stop(Part):
    """The service stop.

    It succeeds when the chassis confirmed the zero velocity and answered each cancel; that it
    refuses to cancel what is not running is no failure.

    Args:
        host: see `PartContext`.
        cmd_vel: is silenced until its sender pauses, if there is one.
    """

    def __init__(self, host: PartContext, cmd_vel: CmdVel | None) -> None:
        self._host = host
        self._cmd_vel = cmd_vel
        self._service = host.service("stop", self._asked)

    def _asked(self, _request: Any, reply: Reply) -> None:
        self._host.thread.spawn(partial(self._stop, reply), reply.fail)

    async def _stop(self, reply: Reply) -> None:
        if self._cmd_vel is not None:
            self._cmd_vel.silence()
        gate, address = self._host.gate, self._host.requests.address
        gate.withdraw(_STOPPED, _HOLD_S)
        orders = [("velocity zero", Twist()), *cancels()]
        # each goes before all that waits: the last of these is asked first
        answers = await asyncio.gather(
            *(
                gate.request(address(message), _TIMEOUT_S, first=True)
                for _, message in reversed(orders)
            ),
            return_exceptions=True,
        )
        results = dict(zip((name for name, _ in orders), reversed(answers), strict=True))
        for result in results.values():
            if isinstance(result, BaseException) and not isinstance(result, LinkError):
                raise result
        stopped = results.pop("velocity zero")
        text = ["stopped" if _is_done(stopped) else f"NOT STOPPED: {_reason(stopped)}"]
        text += [f"{name} cancelled" for name, result in results.items() if _is_done(result)]
        lost = [
            f"cancel of {name}: {result}"
            for name, result in results.items()
            if isinstance(result, LinkError)
        ]
        success = _is_done(stopped) and not lost
        if not success:
            text += [*lost[:1], "if the robot moves, press its emergency stop"]
            _LOG.error("stop: %s", "; ".join(text))
        reply.send(Trigger.Response(success=success, message="; ".join(text)))


def _is_done(result: Any) -> bool:
    return isinstance(result, Answer) and result.ok


def _reason(result: Any) -> str:
    return result.msg if isinstance(result, Answer) else str(result)
