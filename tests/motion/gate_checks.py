"""Helpers of the tests of the motion gate."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable
from typing import Any

import pytest

from tests.link.link_peer import Frame, Wire, soon
from tests.motion.moving import MOVING, name_of
from woosh_robot_agent.motion.gate import cancel_orders

TWIST = "woosh.robot.Twist"


ORDERS = len(cancel_orders()) + 1


every_moving_request = pytest.mark.parametrize("request_", MOVING, ids=name_of)


async def answer_all(wire: Wire, frame: Frame) -> bool:
    """Accept every request; a script for `Peer`."""
    if frame["type"] != "woosh.robot.RobotInfo" and "sn" in frame:
        await wire.answer(frame)
        return True
    return False


def types(wire: Wire) -> list[str]:
    wanted = {TWIST, *(message.DESCRIPTOR.full_name for message in MOVING)}
    wanted.add("woosh.robot.ActionOrder")
    return [frame["type"] for frame in wire.seen if frame["type"] in wanted]


async def ok(work: Awaitable[Any]) -> None:
    assert (await soon(asyncio.ensure_future(work))).ok
