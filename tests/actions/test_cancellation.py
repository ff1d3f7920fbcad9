"""Cancels of one goal; tests/node/test_cancel.py has when they are sent and repeated."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest

from woosh_robot_agent.ros.actions.giving_up import Cancellation

pytestmark = pytest.mark.asyncio


class Chassis:
    """A chassis that receives cancels, and answers them when the test does."""

    def __init__(self) -> None:
        self.accepted = 0
        self.sent: list[asyncio.Future[Any]] = []
        self.has_begun, self.replaced = True, False
        self.cancellation = Cancellation(
            "task 5",
            self._send,
            self._replaced,
            self._accepted,
            lambda: None,
            lambda: self.has_begun,
        )

    async def _send(self) -> Any:
        self.sent.append(asyncio.get_running_loop().create_future())
        return await self.sent[-1]

    async def _replaced(self) -> bool:
        return self.replaced

    def _accepted(self) -> None:
        self.accepted += 1

    async def request(self) -> None:
        """Let the client ask to cancel the goal, which the chassis has accepted."""
        self.cancellation.pending = True
        self.cancellation.send_soon()
        await settled()


async def settled() -> None:
    """Let all tasks run until each of them waits."""
    for _ in range(5):
        await asyncio.sleep(0)


async def test_one_cancel_at_a_time() -> None:
    chassis = Chassis()
    await chassis.request()
    await chassis.request()
    assert len(chassis.sent) == 1
    chassis.sent[-1].set_result(SimpleNamespace(ok=False, reason="not now"))
    await settled()
    assert len(chassis.sent) == 2, "the client asked again meanwhile"
    chassis.sent[-1].set_result(SimpleNamespace(ok=True, msg=""))
    await settled()
    assert (len(chassis.sent), chassis.accepted) == (2, 1)


async def test_no_cancel_is_sent_after_stop() -> None:
    chassis = Chassis()
    await chassis.request()
    chassis.cancellation.stop()
    await settled()
    assert chassis.sent[0].cancelled()


async def test_an_early_cancel_is_not_sent_again_if_another_goal_has_replaced_this_one() -> None:
    """It would hit the other goal."""
    chassis = Chassis()
    chassis.has_begun = False
    await chassis.request()
    chassis.has_begun = chassis.replaced = True
    chassis.sent[-1].set_result(SimpleNamespace(ok=True, msg=""))
    await settled()
    assert len(chassis.sent) == 1
