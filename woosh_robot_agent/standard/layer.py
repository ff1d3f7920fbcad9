"""The standard layer, put together."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterator
from functools import partial

from woosh_robot_agent.standard.cmd_vel import CmdVel
from woosh_robot_agent.standard.diagnostics import Diagnostics
from woosh_robot_agent.standard.goal_pose import GoalPose
from woosh_robot_agent.standard.grid import Grid
from woosh_robot_agent.standard.initialpose import InitialPose
from woosh_robot_agent.standard.odom import Odom
from woosh_robot_agent.standard.part_context import Part, PartContext
from woosh_robot_agent.standard.scan import Scan
from woosh_robot_agent.standard.states import (
    Connected,
    battery_part,
    footprint_part,
    plan_part,
)
from woosh_robot_agent.standard.stop import Stop

_LOG = logging.getLogger(__name__)
_PAUSE_S = 1.0

#: What makes each part, with the parameters of which any switches it on.
PARTS: tuple[tuple[Callable[[PartContext], Part], tuple[str, ...]], ...] = (
    (Odom, ("enable_odom", "publish_tf")),
    (Scan, ("enable_scan", "publish_tf")),
    (battery_part, ("enable_battery_state",)),
    (Grid, ("enable_map",)),
    (plan_part, ("enable_plan",)),
    (footprint_part, ("enable_footprint",)),
    (CmdVel, ("enable_cmd_vel",)),
    (InitialPose, ("enable_initialpose",)),
    (GoalPose, ("enable_goal_pose",)),
    (Stop, ("enable_stop",)),
    (Connected, ("enable_connected",)),
    (Diagnostics, ("enable_diagnostics",)),
)


class StandardLayer:
    """The parts that the parameters switch on.

    Args:
        host: what they share.
    """

    def __init__(self, host: PartContext) -> None:
        self._host = host
        self._parts = list(_parts(host))

    def start(self) -> None:
        """Let all parts run; from any thread."""
        for part in self._parts:
            self._host.thread.spawn(partial(_keep_running, part))


async def _keep_running(part: Part) -> None:
    """Run a part; a mistake of ours in it, which is logged, must not end it for good."""
    while True:
        try:
            await part.run()
            return
        except Exception:
            _LOG.exception("%s of the standard layer failed; it goes on", type(part).__name__)
            await asyncio.sleep(_PAUSE_S)


def _parts(host: PartContext) -> Iterator[Part]:
    settings = host.settings()
    for make, switches in PARTS:
        if any(getattr(settings, switch) for switch in switches):
            yield make(host)
