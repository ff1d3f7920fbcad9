"""Who cancels what Nav2's goals let the chassis execute."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Iterable

from google.protobuf.message import Message

from woosh_robot_agent.motion import AnsweredCommand, MotionGate
from woosh_robot_agent.motion.gate import cancel_orders
from woosh_robot_agent.motion.requests import started_by, takes_wheels
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ActionOrder, ExecTask
from woosh_robot_agent.pb.ros.action_pb2 import kCancel
from woosh_robot_agent.pb.ros.ros_pack_pb2 import CallAction
from woosh_robot_agent.pb.util import action_pb2 as action
from woosh_robot_agent.robot.code_log import GOAL_CANCEL
from woosh_robot_agent.robot.who_drives import command_name

_ANSWER_DELAY = 0.1
"""Maximum time from the report of a cancel to the answer to its request, in seconds."""


class CancelLog:
    """Remembers what last cancelled the task and each action, other than the client of its goal.

    The start of another drive cancels them, too. Used in the link thread.
    """

    def __init__(self, gate: MotionGate) -> None:
        self._last: dict[str, tuple[str, float]] = {}
        """Name of the service, topic or action through which the last cancel came, and its loop
        time; by "task" or the short name of the action."""
        gate.on_stop(lambda: self._note(cancel_orders(), "the service stop"))
        gate.on_answered(self._answered)

    async def source(self, command: Message, since: float) -> str:
        """Return what has cancelled a task, or the action of a command, since a loop time.

        If no cancel has passed through the agent since, it was the robot itself or another client.
        The report of a cancel may come before the answer to its request, so this waits for
        `_ANSWER_DELAY` at most.
        """
        what = "task" if isinstance(command, ExecTask) else command.DESCRIPTOR.name
        clock = asyncio.get_running_loop().time
        until = clock() + _ANSWER_DELAY
        while clock() <= until:
            source, noted = self._last.get(what, ("", -math.inf))
            if noted >= since:
                return source
            await asyncio.sleep(_ANSWER_DELAY / 10)
        return "the robot itself or another client of it"

    def _answered(self, command: AnsweredCommand) -> None:
        """Note what a command has cancelled, unless it is the cancel of the goal's client."""
        if command.answer.ok and command.source != GOAL_CANCEL:
            self._note(_cancelled_by(command.message), command_name(command))

    def _note(self, cancelled: Iterable[str], source: str) -> None:
        now = asyncio.get_running_loop().time()
        self._last.update((each, (source, now)) for each in cancelled)


def _cancelled_by(message: Message) -> Iterable[str]:
    """Return what an accepted command may have cancelled, named as in `cancel_orders`."""
    if takes_wheels(message):  # the goal of the same action has been replaced, not cancelled
        return cancel_orders().keys() - {started_by(message)}
    if isinstance(message, CallAction) and (member := message.WhichOneof("action")):
        call = getattr(message, member)
        # a setting has no field `action`
        return [call.DESCRIPTOR.name] if getattr(call, "action", None) == kCancel else []
    is_cancel = isinstance(message, ActionOrder) and message.order == action.kCancel
    return ["task"] if is_cancel else []
