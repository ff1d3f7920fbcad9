"""Drops are counted, and logged at the beginning of a series and, with their number, at its end."""

from __future__ import annotations

import asyncio
import logging

import pytest

from tests.link.link_peer import Peer, aio, eventually, soon
from woosh_robot_agent.link import RequestTimeoutError, TooManyRequestsError, reports
from woosh_robot_agent.link.reports import DropLog
from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Speak

CODE = "woosh.robot.count.StatusCode"


@pytest.fixture(autouse=True)
def short_series(caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    caplog.set_level(logging.INFO, "woosh_robot_agent.link")
    monkeypatch.setattr(reports, "QUIET", 0.2)


def about(caplog: pytest.LogCaptureFixture, *words: str) -> list[tuple[int, str]]:
    """Return level and text of the log records that contain any of these words."""
    return [
        (record.levelno, record.getMessage())
        for record in caplog.records
        if any(word in record.getMessage() for word in words)
    ]


@aio
async def test_refused_requests_are_counted_and_logged(caplog: pytest.LogCaptureFixture) -> None:
    async with Peer() as peer, peer.client(max_in_flight=1) as client:
        wire = await peer.wire()
        waiting = asyncio.ensure_future(client.request(Speak(text="first")))
        first = await wire.next("woosh.robot.Speak")
        for _ in range(7):
            with pytest.raises(TooManyRequestsError):
                await client.request(Speak())
        await wire.answer(first)
        await soon(waiting)
        assert client.stats.refused_requests == {"woosh.robot.Speak": 7}
        await eventually(lambda: about(caplog, "none since then"))
        (begun, why), (over, number) = about(
            caplog, "requests are in flight", "too many were in flight"
        )
        assert (begun, over) == (logging.WARNING, logging.INFO)
        assert "woosh.robot.Speak was not sent" in why
        assert number.startswith("7 requests were refused")


@aio
async def test_dropped_pushes_are_counted_and_logged(caplog: pytest.LogCaptureFixture) -> None:
    async with Peer() as peer, peer.client(push_queue=2) as client:
        wire = await peer.wire()
        seen: list[int] = []
        client.subscribe(StatusCode, lambda message: seen.append(message.code))
        envelope = client._connection._codec.decode(f'{{"type":"{CODE}"}}')  # type: ignore[union-attr]
        for _ in range(6):  # all before the delivery task runs
            client._connection._on_push(envelope)  # type: ignore[union-attr]
        await eventually(lambda: about(caplog, "none since then"))
        assert len(seen) == 2
        levels, texts = zip(*about(caplog, CODE), strict=True)
        assert levels == (logging.WARNING, logging.INFO)
        assert texts[1].startswith(f"4 pushes of {CODE} were dropped")
        await wire.push(CODE, {"code": "9"})
        await eventually(lambda: seen[-1:] == [9])


@aio
async def test_unanswered_requests_are_counted() -> None:
    async with Peer() as peer, peer.client() as client:
        with pytest.raises(RequestTimeoutError):
            await client.request(Speak(), 0.01)
        assert client.stats.timeouts == {"woosh.robot.Speak": 1}


@aio
async def test_a_close_logs_the_number_at_once(caplog: pytest.LogCaptureFixture) -> None:
    reports.QUIET = 60.0
    async with Peer() as peer, peer.client(max_in_flight=1) as client:
        waiting = asyncio.ensure_future(client.request(Speak()))
        await (await peer.wire()).next("woosh.robot.Speak")
        with pytest.raises(TooManyRequestsError):
            await client.request(Speak())
        await client.close()
        await asyncio.gather(waiting, return_exceptions=True)
        assert len(about(caplog, "1 requests were refused")) == 1


@aio
async def test_a_series_lasts_while_drops_come_and_the_next_is_logged_again(
    caplog: pytest.LogCaptureFixture,
) -> None:
    loop = asyncio.get_running_loop()
    counted = DropLog(logging.getLogger("woosh_robot_agent.link"))
    for _ in range(2):
        caplog.clear()
        longest, last = 0.0, loop.time()
        for _ in range(10):
            longest, last = max(longest, loop.time() - last), loop.time()
            counted.count("things were lost", "things get lost")
            await asyncio.sleep(0.05)  # in total longer than the pause that ends a series
        await eventually(
            lambda: sum(int(t.split()[0]) for _, t in about(caplog, "none since then")) == 10
        )
        if longest < reports.QUIET / 2:  # otherwise a busy machine delayed the drops
            first, second = (text for _, text in about(caplog, "thing"))
            assert first == "things get lost"
            assert second.startswith("10 things were lost within ")
