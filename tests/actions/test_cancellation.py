"""Conditions under which a cancel is sent to the chassis, and repeated."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest

from woosh_robot_agent.link import ConnectionLostError
from woosh_robot_agent.ros.actions.giving_up import Cancellation

pytestmark = pytest.mark.asyncio

ACCEPTED = SimpleNamespace(ok=True, msg="")
REFUSED = SimpleNamespace(ok=False, msg="not now")
LOST = ConnectionLostError("reset")


class Chassis:
    """A chassis that receives cancels, and answers them when the test calls `answer`."""

    def __init__(self) -> None:
        self.replaced = False
        self.accepted = 0
        self.sent: list[asyncio.Future[Any]] = []
        self.cancellation = Cancellation("task 5", self._send, self._replaced, self._accepted)

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
        await self.report()

    async def report(self) -> None:
        """Let the chassis report on the goal."""
        self.cancellation.send_soon()
        await settled()

    async def answer(self, answer: Any) -> None:
        """Answer the last cancel."""
        if isinstance(answer, Exception):
            self.sent[-1].set_exception(answer)
        else:
            self.sent[-1].set_result(answer)
        await settled()


async def settled() -> None:
    """Let all tasks run until each of them waits."""
    for _ in range(5):
        await asyncio.sleep(0)


@pytest.fixture
def chassis() -> Chassis:
    return Chassis()


async def test_no_cancel_is_sent_without_a_request(chassis: Chassis) -> None:
    await chassis.report()
    assert not chassis.sent


async def test_accepted_cancel_is_not_sent_again(chassis: Chassis) -> None:
    await chassis.request()
    await chassis.answer(ACCEPTED)
    await chassis.report()
    assert (len(chassis.sent), chassis.accepted) == (1, 1)


async def test_refused_cancel_is_sent_again_only_on_request(chassis: Chassis) -> None:
    await chassis.request()
    await chassis.answer(REFUSED)
    await chassis.report()
    assert (len(chassis.sent), chassis.accepted) == (1, 0)
    await chassis.request()
    assert len(chassis.sent) == 2


async def test_lost_cancel_is_sent_again_only_after_a_report(chassis: Chassis) -> None:
    await chassis.request()
    await chassis.answer(LOST)
    assert len(chassis.sent) == 1
    assert chassis.cancellation.pending
    await chassis.report()
    assert len(chassis.sent) == 2
    assert not chassis.cancellation.pending


async def test_one_cancel_at_a_time(chassis: Chassis) -> None:
    await chassis.request()
    await chassis.request()
    await chassis.report()
    assert len(chassis.sent) == 1
    await chassis.answer(REFUSED)
    assert len(chassis.sent) == 2, "the client asked again meanwhile"
    await chassis.answer(ACCEPTED)
    assert len(chassis.sent) == 2


async def test_cancel_never_hits_a_newer_goal(chassis: Chassis) -> None:
    chassis.replaced = True
    await chassis.request()
    assert not chassis.sent


async def test_no_cancel_is_sent_after_stop(chassis: Chassis) -> None:
    await chassis.request()
    chassis.cancellation.stop()
    await settled()
    assert chassis.sent[0].cancelled()
