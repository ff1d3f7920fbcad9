"""Create and run the parts of the standard layer that the parameters enable."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Coroutine
from functools import partial
from typing import Any

from woosh_robot_agent.ros.standard.cmd_vel import CmdVel, Stop
from woosh_robot_agent.ros.standard.diagnostics import Diagnostics
from woosh_robot_agent.ros.standard.goal_pose import GoalPose, InitialPose
from woosh_robot_agent.ros.standard.map import Map
from woosh_robot_agent.ros.standard.odom import Odom
from woosh_robot_agent.ros.standard.part import Part, PartContext
from woosh_robot_agent.ros.standard.poses import Pose2D
from woosh_robot_agent.ros.standard.scan import Scan
from woosh_robot_agent.ros.standard.states import (
    Connected,
    battery_part,
    footprint_part,
    plan_part,
)

_LOG = logging.getLogger(__name__)
_RESTART_DELAY = 1.0
"""Delay before a part that failed runs again, in seconds."""

_PARTS: tuple[tuple[Callable[[PartContext], Part], tuple[str, ...]], ...] = (
    (Odom, ("odom", "tf")),
    (Scan, ("scan", "tf")),
    (battery_part, ("battery_state",)),
    (Map, ("map",)),
    (plan_part, ("plan",)),
    (footprint_part, ("footprint",)),
    (CmdVel, ("cmd_vel",)),
    (InitialPose, ("initialpose",)),
    (GoalPose, ("goal_pose",)),
    (Stop, ("stop",)),
    (Connected, ("connected",)),
    (Diagnostics, ("diagnostics",)),
)
"""Constructor of each `Part`, and names for `StandardSettings.enables`, one of which suffices."""


class StandardLayer:
    """The enabled parts of the standard layer."""

    def __init__(self, context: PartContext) -> None:
        self._context = context
        settings = context.settings()
        self._parts = [
            create(context) for create, names in _PARTS if any(map(settings.enables, names))
        ]

    def start(self) -> None:
        """Start all parts. Thread-safe."""
        for part in self._parts:
            run = partial(keep_running, part.run, type(part).__name__)
            self._context.thread.spawn(run)

    @property
    def map_to_odom(self) -> Pose2D | None:
        """Pose of the frame of the odometry in the map.

        None if it is unknown, or if neither the topic odom nor `publish_tf` is on.
        """
        return next((each.map_to_odom for each in self._parts if isinstance(each, Odom)), None)


async def keep_running(run: Callable[[], Coroutine[Any, Any, None]], name: str) -> None:
    """Run `run`; after an unexpected error, log it with `name`, and run it again after a pause."""
    while True:
        try:
            await run()
            return
        except Exception:
            _LOG.exception("%s failed; restarting it", name)
            await asyncio.sleep(_RESTART_DELAY)
