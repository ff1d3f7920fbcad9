"""Cancels of one goal; tests/node/test_cancel.py has when they are sent and repeated."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

from woosh_robot_agent.ros.actions.giving_up import Cancellation


class Chassis:
    """A chassis that receives cancels, and answers them when the test does."""

    def __init__(self) -> None:
        self.sent: list[asyncio.Future[Any]] = []
        self.has_begun = self.replaced = False
        self.cancellation = Cancellation(
            "task 5",
            self._send,
            self._is_replaced,
            on_accepted=lambda: None,
            on_refused=lambda: None,
            has_begun=lambda: self.has_begun,
        )

    async def _send(self) -> Any:
        self.sent.append(asyncio.get_running_loop().create_future())
        return await self.sent[-1]

    async def _is_replaced(self) -> bool:
        return self.replaced


async def settled() -> None:
    """Let all tasks run until each of them waits."""
    for _ in range(5):
        await asyncio.sleep(0)


async def test_an_early_cancel_is_not_sent_again_if_another_goal_has_replaced_this_one() -> None:
    """It would hit the other goal."""
    chassis = Chassis()
    chassis.cancellation.pending = True
    chassis.cancellation.send_soon()
    await settled()
    chassis.has_begun = chassis.replaced = True
    chassis.sent[-1].set_result(SimpleNamespace(ok=True, msg=""))
    await settled()
    assert len(chassis.sent) == 1
