"""stop: stops the robot at once, and cancels everything that moves it."""

from __future__ import annotations

import logging
from functools import partial
from typing import Any

from std_srvs.srv import Trigger

from woosh_robot_agent.bridge import Reply
from woosh_robot_agent.standard.part import Part
from woosh_robot_agent.standard.part_context import PartContext

_LOG = logging.getLogger(__name__)
_TIMEOUT = 2.0
"""Time to wait for each of the chassis's answers, in seconds."""


class Stop(Part):
    """The service stop, which calls `MotionGate.stop`."""

    def __init__(self, context: PartContext) -> None:
        self._context = context
        self._service = context.service("stop", self._stop_requested)

    def _stop_requested(self, _request: Any, reply: Reply) -> None:
        self._context.robot.gate.announce_stop()
        self._context.robot.thread.spawn(partial(self._stop, reply), reply.fail)

    async def _stop(self, reply: Reply) -> None:
        report = await self._context.robot.gate.stop(_TIMEOUT)
        if not report.success:
            _LOG.error("stop: %s", report.message)
        reply.send(Trigger.Response(success=report.success, message=report.message))
