"""Drops are counted, and the first of a series is logged."""

from __future__ import annotations

import logging

import pytest

from tests.link.link_peer import delimited, eventually, linked
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.link.reports import DropLog
from woosh_robot_agent.link.subscriptions import LATEST_DEPTH
from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed

CODE = "woosh.robot.count.StatusCode"


@pytest.fixture(autouse=True)
def all_levels(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "woosh_robot_agent.link")


def about(caplog: pytest.LogCaptureFixture, *words: str) -> list[tuple[int, str]]:
    """Return level and text of the log records that contain any of these words."""
    return [
        (record.levelno, record.getMessage())
        for record in caplog.records
        if any(word in record.getMessage() for word in words)
    ]


async def test_dropped_pushes_are_counted_and_logged(caplog: pytest.LogCaptureFixture) -> None:
    async with linked("tcp", push_queue=2) as (_peer, client, wire):
        seen: list[int] = []
        client.subscribe(StatusCode, lambda message: seen.append(message.code))
        await wire.raw(delimited({"type": CODE, "body": b"\x08\x01"}) * 1000)  # read together
        await eventually(lambda: len(seen) + client.stats.dropped_pushes[CODE] == 1000)
        await wire.push(CODE, b"\x08\x09")
        await eventually(lambda: seen[-1:] == [9])
        assert client.stats.dropped_pushes[CODE]
    ((level, _text),) = about(caplog, CODE)
    assert level == logging.WARNING


@pytest.mark.parametrize("kind", ["json", "tcp"])
async def test_no_push_of_a_burst_is_dropped_if_the_consumer_is_quick(kind: str) -> None:
    async with linked(kind) as (_peer, client, wire):
        seen: list[int] = []
        client.subscribe(PoseSpeed, lambda message: seen.append(message.mileage))
        pushes = range(10 * LATEST_DEPTH)
        for number in pushes:  # without a pause, so that many are read together
            packed = PoseSpeed(mileage=number).SerializeToString()
            await wire.push(full_name(PoseSpeed), packed if kind == "tcp" else {"mileage": number})
        await eventually(lambda: seen[-1:] == [pushes[-1]])
        assert not client.stats.dropped_pushes
        assert seen == list(pushes)


def test_a_series_lasts_while_drops_come_and_the_next_is_logged_again(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    drops = DropLog(logging.getLogger("woosh_robot_agent.link"), quiet=3.0)
    for now in (1.0, 3.0, 5.0, 9.0):
        monkeypatch.setattr("time.monotonic", lambda now=now: now)
        drops.warn("things", f"lost at {now}")
    drops.warn("others", "others lost")
    texts = [text for _, text in about(caplog, "lost")]
    assert texts == ["lost at 1.0", "lost at 9.0", "others lost"]
