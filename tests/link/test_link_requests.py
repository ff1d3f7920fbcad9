"""Requests: matching of answers, timeouts, limits and lost connections."""

from __future__ import annotations

import asyncio
import logging
from typing import Any

import pytest

from tests.link.link_peer import (
    INFO,
    KINDS,
    LOAD,
    TIMEOUT,
    Frame,
    Peer,
    Wire,
    answered,
    ask,
    block,
    eventually,
    linked,
    soon,
    turns,
)
from woosh_robot_agent.link import (
    ChassisClient,
    ConnectionLostError,
    NotConnectedError,
    RequestTimeoutError,
    SupersededError,
    TooManyRequestsError,
)
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Speak, SwitchControlMode
from woosh_robot_agent.pb.robot.robot_pb2 import Battery, Mode, PoseSpeed, RobotInfo, RobotState


def pending(client: ChassisClient) -> int:
    sizes = client.debug()
    return sizes["requests"] + sizes["outbox"]


@pytest.mark.parametrize("kind", KINDS)
async def test_a_request_returns_its_answer(kind: str) -> None:
    async with linked(kind) as (_peer, client, wire):
        answer = ask(client, SwitchControlMode(mode=1))  # type: ignore[arg-type]
        frame = await wire.next()
        assert frame["type"] == "woosh.robot.SwitchControlMode"
        assert 1 <= frame["sn"] < 2**31
        assert "ok" not in frame
        body: Any = b"\x08\x01\x10\x02"
        if kind == "json":
            assert frame["body"] == {"mode": 1}
            assert isinstance(frame["timestamp"], int)
            body = {"ctrl": 1, "work": 2}
        await wire.answer(frame, body, type="woosh.robot.Mode", msg="Request succeed")
        expected = Mode(ctrl=1, work=2)  # type: ignore[arg-type]
        got = await soon(answer)
        assert (got.ok, got.msg, got.type) == (True, "Request succeed", "woosh.robot.Mode")
        assert (got.body, got.defect) == (expected, "")


async def test_sns_start_again_at_one_and_skip_those_in_use() -> None:
    async with linked() as (_peer, client, wire):
        first = ask(client, Speak())
        used = (await wire.next())["sn"]
        assert client._connection is not None
        client._connection._next_sn = 2**31 - 1
        others_ = [ask(client, Speak()) for _ in range(used + 1)]
        sns = [(await wire.next())["sn"] for _ in others_]
        assert sns[:2] == [2**31 - 1, 1]
        assert used not in sns
        for task in (first, *others_):
            task.cancel()
        await asyncio.wait([first, *others_])


async def test_answers_may_come_in_any_order() -> None:
    async with linked() as (_peer, client, wire):
        tasks = [ask(client, Speak(text=str(i))) for i in range(5)]
        frames = [await wire.next() for _ in tasks]
        for i in (3, 0, 4, 2, 1):
            await wire.answer(frames[i], msg=f"answer {i}")
        assert [answer.msg for answer in await soon(asyncio.gather(*tasks))] == [
            f"answer {i}" for i in range(5)
        ]


async def test_late_duplicate_and_unknown_answers_are_counted_and_ignored(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.DEBUG, "woosh_robot_agent.link")
    async with linked() as (_peer, client, wire):
        with pytest.raises(RequestTimeoutError):
            await client.request(Speak(), timeout=0.02)
        late = await wire.next()
        await wire.answer(late)
        task = ask(client, Speak())
        frame = await wire.next()
        for sn in (99999, -4, 2**31, 2**70):
            await wire.answer(frame, sn=sn)
        await wire.answer(frame, msg="first")
        await wire.answer(frame, msg="second")
        assert (await soon(task)).msg == "first"
        await eventually(lambda: client.stats.late_answers == 6)
        logged = [r for r in caplog.records if "no request is pending" in r.message]
        assert len(logged) == 6
        assert {record.levelno for record in logged} == {logging.DEBUG}
        assert not client.stats.bad_frames


async def test_a_refusal_an_unknown_type_and_a_bare_frame_are_answers() -> None:
    """They keep the chassis' own text."""
    refused = {"ok": False, "msg": "未初始化"}
    answers: tuple[tuple[dict[str, Any], Any, str], ...] = (
        (refused, Speak(), "未初始化"),
        ({**refused, "type": "error", "body": None}, None, "未初始化"),
        ({"ok": False}, Speak(), "refused without a reason"),
        ({"type": "woosh.robot.Battery", "body": {"power": 5}}, Battery(power=5), ""),
        ({"type": "woosh.New", "msg": "m"}, None, "the answer cannot be read: "),
    )
    async with linked() as (_peer, client, wire):
        for changes, body, reason in answers:
            got = await answered(client.request(Speak()), wire, **changes)
            assert (got.ok, got.msg) == (changes.get("ok", True), changes.get("msg", ""))
            assert got.body == body
            assert got.reason.startswith(reason)
            assert bool(got.reason) == bool(reason)
        task = ask(client, Speak())
        await wire.raw(f'{{"sn":{(await wire.next())["sn"]}}}')
        bare = await soon(task)
        assert (bare.ok, bare.msg, bare.body) == (False, "", None)
        assert bare.defect


@pytest.mark.parametrize(("kind", "ok"), [("json", True), ("tcp", False)])
async def test_an_unreadable_body_is_logged_and_counted(kind: str, ok: bool) -> None:
    async with linked(kind) as (_peer, client, wire):
        task = ask(client, PoseSpeed())
        body: Any = {"mapId": "x"} if kind == "json" else b"\xff"
        await wire.answer(await wire.next(), body, ok=ok, msg="m")
        answer = await soon(task)
        assert (answer.ok, answer.msg, answer.body) == (ok, "m", None)
        assert "PoseSpeed" in answer.defect
        assert client.stats.bad_frames == {"body": 1}


async def test_a_timeout_names_the_message_and_the_time() -> None:
    async with linked(request_timeout=0.04) as (_peer, client, _wire):
        with pytest.raises(RequestTimeoutError, match=r"woosh\.robot\.Speak within 0\.05 s"):
            await client.request(Speak(), timeout=0.05)
        with pytest.raises(RequestTimeoutError, match=r"0\.04 s"):
            await client.request(Speak())
        assert pending(client) == 0
        assert client.stats.timeouts == {"woosh.robot.Speak": 2}


async def test_a_short_timeout_does_not_wait_for_a_long_one() -> None:
    async with linked() as (_peer, client, wire):
        long = ask(client, Speak(), timeout=600.0)
        frame = await wire.next("woosh.robot.Speak")
        for _ in range(2):
            with pytest.raises(RequestTimeoutError):
                await client.request(Speak(), timeout=0.02)
        await wire.answer(frame)
        assert (await soon(long)).ok


async def test_requests_over_the_limit_fail_at_once_are_counted_and_not_sent(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async with linked(max_in_flight=2) as (_peer, client, wire):
        tasks = [ask(client, Speak()), ask(client, Speak())]
        frames = [await wire.next() for _ in tasks]
        for _ in range(7):
            with pytest.raises(TooManyRequestsError, match=r"woosh\.robot\.Battery.*in flight"):
                await client.request(Battery())
        assert client.stats.refused_requests == {"woosh.robot.Battery": 7}
        told = [each for each in caplog.records if "requests are in flight" in each.getMessage()]
        (why,) = [each for each in told if each.levelno == logging.WARNING]
        assert "woosh.robot.Battery was not sent" in why.getMessage()
        for frame in frames:
            await wire.answer(frame)
        await soon(asyncio.gather(*tasks))
        task = ask(client, Speak())  # now there is room
        await wire.answer(await wire.next("woosh.robot.Speak"))
        await soon(task)
        assert not [frame for frame in wire.seen if frame["type"] == "woosh.robot.Battery"]


@pytest.mark.parametrize("kind", ["json", "tcp"])
async def test_a_lost_connection_fails_pending_requests_and_nothing_is_sent_again(
    kind: str,
) -> None:
    async with linked(kind) as (peer, client, wire):
        tasks = [ask(client, Speak(text=str(i))) for i in range(3)]
        for _ in tasks:
            await wire.next()
        wire.abort()
        results = await soon(asyncio.gather(*tasks, return_exceptions=True))
        assert [type(result) for result in results] == [ConnectionLostError] * 3
        assert len({str(result) for result in results}) == 1
        assert "internal" not in str(results[0])
        assert len({id(result) for result in results}) == 3
        again = await peer.wire(2)
        await client.wait_ready(TIMEOUT)
        task = ask(client, Battery())
        frame = await again.next()
        assert frame["type"] == "woosh.robot.Battery"
        await again.answer(frame, {} if kind == "json" else b"")
        await soon(task)
        assert {frame["type"] for frame in again.seen} == {INFO, "woosh.robot.Battery"}


async def test_an_unsent_request_is_not_sent_after_a_reconnect() -> None:
    async with linked(liveness_timeout=0.4) as (peer, client, wire):
        wire.freeze()
        tasks = [ask(client, Speak(text=LOAD)), ask(client, Speak(text="small"))]
        results = await soon(asyncio.gather(*tasks, return_exceptions=True))
        assert [type(result) for result in results] == [ConnectionLostError, NotConnectedError]
        assert "(last error: " in str(results[1])
        again = await peer.wire(2)
        await client.wait_ready(TIMEOUT)
        await turns()
        assert [frame["type"] for frame in again.seen] == [INFO]


async def test_a_request_without_a_link_says_why() -> None:
    async with Peer() as peer:
        client = peer.client(backoff_min=5, backoff_max=5)
        with pytest.raises(NotConnectedError, match="no attempt has ended yet"):
            await client.request(Speak())
        async with client:
            wire = await peer.wire()
            wire.abort()
            await wire.gone.wait()
            await eventually(lambda: client.last_error)
            with pytest.raises(
                NotConnectedError, match=rf"127\.0\.0\.1:{peer.port}.*ended without a close"
            ):
                await client.request(Speak())


async def test_a_request_at_the_moment_of_a_loss_says_why() -> None:
    async with Peer() as peer, peer.client() as client:
        assert client._connection is not None
        client._connection._fail(ConnectionLostError("gone"))
        client._connection._fail(ConnectionLostError("a consequence"))
        with pytest.raises(
            NotConnectedError, match=rf"not connected to ws://127\.0\.0\.1:{peer.port} since.*gone"
        ):
            await client.request(Speak())


async def test_the_links_own_requests_name_the_robot() -> None:
    async with Peer("tcp") as peer, peer.client(robot_id=7, liveness_timeout=0.3):
        wire = await peer.wire()
        await wire.next("woosh.robot.RobotState")  # the probe of a quiet link
        asked = {frame["type"]: frame["body"] for frame in wire.seen if frame["sn"]}
        assert asked == {
            "woosh.robot.RobotInfo": RobotInfo(robot_id=7).SerializeToString(),
            "woosh.robot.RobotState": RobotState(robot_id=7).SerializeToString(),
        }


async def test_cancelled_requests_do_not_pile_up_unsent() -> None:
    async with linked() as (_peer, client, wire):
        first = await block(client, wire)
        for _ in range(30):
            with pytest.raises(SupersededError, match="not sent: the connection was busy"):
                await client.request(Speak(text="late"), timeout=0.001)
        assert client.debug()["outbox"] == 0
        assert not client.stats.timeouts
        task = ask(client, Speak(text="now"))
        await turns()
        wire.thaw()
        frames = [await wire.next() for _ in range(2)]
        assert frames[1]["body"] == {"text": "now"}
        for frame in frames:
            await wire.answer(frame)
        await soon(asyncio.gather(first, task))


async def test_a_tap_sees_the_answer_in_its_place_among_the_pushes() -> None:
    seen: list[Any] = []

    async def script(wire: Wire, frame: Frame) -> bool:
        if frame["type"] != "woosh.robot.Speak":
            return False
        await wire.push("woosh.robot.PoseSpeed", {"mapId": 1})
        await wire.answer(frame, msg="answer")
        await wire.push("woosh.robot.PoseSpeed", {"mapId": 2})
        return True

    async with Peer(script=script) as peer, peer.client() as client:
        client.subscribe(PoseSpeed, lambda pose: seen.append(pose.map_id))
        await client.request(Speak(), tap=lambda answer: seen.append(answer.msg))
        await eventually(lambda: len(seen) == 3)
    assert seen == [1, "answer", 2]


async def test_no_tap_is_dropped_however_many_are_queued() -> None:
    seen: list[Any] = []
    async with linked(push_queue=1) as (_peer, client, wire):
        tasks = [ask(client, Speak(), tap=seen.append) for _ in range(40)]
        frames = [await wire.next() for _ in tasks]
        for frame in frames:
            await wire.answer(frame)
        await soon(asyncio.gather(*tasks))
        await eventually(lambda: len(seen) == 40)


async def test_the_round_trip_is_measured() -> None:
    async with Peer() as peer, peer.client() as client:
        assert client.stats.round_trip is not None
        assert 0 < client.stats.round_trip < 2
        assert (client.stats.connects, client.stats.rx, client.stats.tx) == (1, 1, 1)


@pytest.mark.parametrize("kind", ["json", "tcp"])
async def test_frames_of_many_mib_go_both_ways(kind: str) -> None:
    picture = "z" * (1024 * 1024)
    async with linked(kind) as (_peer, client, wire):
        task = ask(client, Speak(text=picture))
        frame = await wire.next()
        assert len(frame["body"]["text"] if kind == "json" else frame["body"]) >= len(picture)
        await wire.answer(frame, frame["body"])
        answer = await soon(task)
        assert isinstance(answer.body, Speak)
        assert answer.body.text == picture


@pytest.mark.parametrize("kind", ["json", "tcp"])
async def test_traffic_shows_what_arrives_and_what_waits(kind: str) -> None:
    async with linked(kind) as (_peer, client, wire):
        received, _ = client.traffic()
        assert received > 0
        text = "x" * 100_000
        body = {"text": text} if kind == "json" else Speak(text=text).SerializeToString()
        await answered(client.request(Speak()), wire, body)
        assert len(text) < client.traffic()[0] - received < 2 * len(text)
        big = ask(client, Speak(text="x" * 20_000_000))
        await eventually(lambda: client.traffic()[1] > 1_000_000)
        await wire.answer(await wire.next())
        await soon(big)
        assert client.traffic()[1] == 0
    assert client.traffic() == (0, 0)
