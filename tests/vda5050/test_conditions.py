"""Conditions of the vehicle: their timeouts, and cancelled actions that wait for them."""

from __future__ import annotations

import asyncio

import pytest

from tests.tools.waiting import aio
from woosh_robot_agent.vda5050.robot.link import Conditions


@aio
async def test_a_condition_holds_or_the_wait_times_out() -> None:
    conditions = Conditions()
    assert not await conditions.wait(lambda: False, 0.01)
    values: list[int] = []
    waiting = asyncio.create_task(conditions.wait(lambda: bool(values), 60.0))
    await asyncio.sleep(0)
    values.append(1)
    conditions.check()
    assert await waiting


@pytest.mark.parametrize("timeout", [None, 60.0])
@aio
async def test_a_cancel_at_the_moment_when_the_condition_holds_is_not_lost(
    timeout: float | None,
) -> None:
    """An action goes on otherwise, although its order was cancelled."""
    conditions = Conditions()
    values: list[int] = []
    waiting = asyncio.create_task(conditions.wait(lambda: bool(values), timeout))
    await asyncio.sleep(0)
    values.append(1)
    conditions.check()
    waiting.cancel()
    with pytest.raises(asyncio.CancelledError):
        await waiting
