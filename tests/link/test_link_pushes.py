"""Subscriptions and pushes: which are requested, which are delivered, and in which order."""

from __future__ import annotations

import asyncio
import logging
import time
from collections import Counter
from typing import Any

import pytest
from google.protobuf.any_pb2 import Any as AnyMessage

from tests.link.link_peer import (
    INFO,
    TIMEOUT,
    Frame,
    Peer,
    Wire,
    answered,
    delimited,
    eventually,
    linked,
    soon,
    turns,
)
from woosh_robot_agent.link import ChassisClient
from woosh_robot_agent.link.reports import LinkRecord
from woosh_robot_agent.link.subscriptions import LATEST_DEPTH, PushQueue, Subscriptions
from woosh_robot_agent.link.tasks import LARGE
from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Speak
from woosh_robot_agent.pb.robot.robot_pb2 import Battery, PoseSpeed, RobotInfo, TaskProc
from woosh_robot_agent.pb.util.commu_pack_pb2 import MessagePackJson, Subscription

CODE = "woosh.robot.count.StatusCode"
POSE = "woosh.robot.PoseSpeed"
TASK = "woosh.robot.TaskProc"


def topics(frame: Frame) -> tuple[list[str], bool]:
    """Return the topics of a subscribe frame."""
    assert frame["type"] == "woosh.Subscription"
    assert "sn" not in frame
    if isinstance(frame["body"], bytes):
        body = Subscription.FromString(frame["body"])
        return list(body.topics), body.sub
    assert "ok" not in frame
    return frame["body"]["topics"], frame["body"].get("sub", False)


def pose(kind: str, map_id: int) -> Any:
    return {"mapId": map_id} if kind == "json" else PoseSpeed(map_id=map_id).SerializeToString()


@pytest.mark.parametrize("kind", ["json", "tcp"])
async def test_subscriptions_are_sent_first_and_again_on_each_link(kind: str) -> None:
    async with Peer(kind) as peer:
        client = peer.client()
        seen: list[int] = []
        client.subscribe(PoseSpeed, lambda message: seen.append(message.map_id))
        client.subscribe(TaskProc, print)
        client.subscribe(Battery, print)()  # subscribe and unsubscribe
        async with client:
            for number in (1, 2):
                wire = await peer.wire(number)
                await client.wait_ready(TIMEOUT)
                assert topics(wire.seen[0]) == ([POSE, TASK], True)
                assert [frame["type"] for frame in wire.seen[1:]] == [INFO]
                await wire.push(POSE, pose(kind, number))
                await eventually(lambda number=number: len(seen) == number)  # type: ignore[misc]
                wire.abort()
        assert seen == [1, 2]


@pytest.mark.parametrize("kind", ["json", "tcp"])
async def test_subscribing_and_unsubscribing_work_while_connected(kind: str) -> None:
    async with linked(kind) as (_peer, client, wire):
        seen: list[int] = []

        def callback(message: PoseSpeed) -> None:
            seen.append(message.map_id)

        stop_first = client.subscribe(PoseSpeed, callback)
        assert topics(await wire.next()) == ([POSE], True)
        stop_second = client.subscribe(PoseSpeed, callback)  # one callback, two subscriptions
        await wire.push(POSE, pose(kind, 1))
        await eventually(lambda: len(seen) == 2)
        stop_first()
        stop_first()
        await wire.push(POSE, pose(kind, 2))
        await eventually(lambda: len(seen) == 3)
        stop_second()
        # only the first subscription and the last unsubscription were sent
        assert topics(await wire.next()) == ([POSE], False)
        await wire.push(POSE, pose(kind, 3))
        await eventually(lambda: client.stats.rx == 4)
        await turns()
        assert seen == [1, 1, 2]


async def test_a_subscription_during_the_handshake_is_sent() -> None:
    async with Peer(auto=False) as peer:
        client = peer.client()
        client.start()
        wire = await peer.wire()
        info = await wire.next(INFO)
        client.subscribe(PoseSpeed, print)
        assert topics(await wire.next()) == ([POSE], True)
        await wire.answer(info)
        await client.wait_ready(TIMEOUT)
        await client.close()


def test_a_type_that_the_chassis_does_not_have_cannot_be_subscribed() -> None:
    client = ChassisClient()
    with pytest.raises(ValueError, match=r"google\.protobuf\.Any"):
        client.subscribe(AnyMessage, print)
    client.subscribe(MessagePackJson, print)


async def test_the_snapshot_is_delivered_in_its_place_among_the_pushes() -> None:
    seen: list[Any] = []

    async def script(wire: Wire, frame: Frame) -> bool:
        if frame["type"] != INFO:
            return False
        await wire.push(POSE, {"mapId": 1})
        await wire.answer(frame, {"scene": {"mapName": "hall"}})
        await wire.push(POSE, {"mapId": 2})
        return True

    async with Peer(script=script) as peer:
        client = peer.client()
        client.subscribe(PoseSpeed, lambda message: seen.append(message.map_id))
        client.on_snapshot(lambda info: seen.append(info.scene.map_name))
        async with client:
            await eventually(lambda: len(seen) == 3)
            assert seen == [1, "hall", 2]
            (await peer.wire()).abort()
            await eventually(lambda: len(seen) == 6)
            assert seen == [1, "hall", 2] * 2
            seen.clear()
            await client.wait_ready(TIMEOUT)
            await client.request(RobotInfo())  # asked for later, it is no snapshot
            await eventually(lambda: len(seen) == 2)
            assert seen == [1, 2]


async def test_an_exception_of_a_callback_is_logged_and_delivery_goes_on(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async with linked() as (_peer, client, wire):
        seen: list[Any] = []

        def fail(_: object) -> None:
            raise ZeroDivisionError

        def cancelled(_: object) -> None:
            raise asyncio.CancelledError

        for callback in (fail, cancelled, seen.append):
            client.subscribe(PoseSpeed, callback)
            client.on_state(callback)
        for _ in range(2):
            await wire.push(POSE)
        await eventually(lambda: len(seen) == 2)
        wire.abort()
        await eventually(lambda: client.stats.connects == 2)
        assert len([r for r in caplog.records if r.message == "a callback failed"]) >= 4


async def test_what_is_not_used_is_skipped_and_logged_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Unreadable pushes, errors without a request, and pushes that nobody has subscribed to."""
    caplog.set_level(logging.DEBUG, "woosh_robot_agent.link")

    def levels(text: str) -> list[int]:
        return [each.levelno for each in caplog.records if text in each.getMessage()]

    async with linked() as (_peer, client, wire):
        seen: list[Any] = []
        client.subscribe(PoseSpeed, seen.append)
        await wire.push("woosh.New", {"a": 1})
        await wire.push(TASK, {"state": "not even read"})
        for _ in range(2):
            await wire.raw('{"type":"error","ok":false,"msg":"odd"}')
        for body in ({"mapId": "x"}, {"mapId": "y"}, {"mapId": 3}):
            await wire.push(POSE, body)
        await eventually(lambda: seen)
        assert client.stats.bad_frames == {"body": 2}
        assert client.stats.connects == 1
        assert levels("skipped a push") == [logging.WARNING, logging.DEBUG]
        assert levels("the chassis reports: odd") == [logging.WARNING, logging.DEBUG]


async def test_pushes_go_on_after_an_answer_that_its_tap_cannot_read() -> None:
    async with linked() as (_peer, client, wire):
        seen: list[Any] = []
        client.subscribe(PoseSpeed, seen.append)
        asked = asyncio.ensure_future(
            client.request(PoseSpeed(), tap=lambda answer: seen.append(answer.raw.message()))
        )
        answer = await wire.next(POSE)
        await wire.push(POSE)
        await wire.answer(answer, {"mapId": "x"})
        for _ in range(2):
            await wire.push(POSE)
        await soon(asked)
        await eventually(lambda: len(seen) == 3)


async def test_a_flood_keeps_its_order_and_each_status_code() -> None:
    async with linked() as (_peer, client, wire):
        codes: list[int] = []
        poses: list[int] = []
        client.subscribe(StatusCode, lambda message: codes.append(message.code))
        client.subscribe(PoseSpeed, lambda message: poses.append(message.map_id))
        for number in range(1, 501):
            await wire.push(CODE, {"code": str(number)})
            await wire.push(POSE, {"mapId": number})
        await eventually(lambda: len(codes) == 500 and poses and poses[-1] == 500)
        assert codes == list(range(1, 501))
        assert poses == sorted(poses)
        assert client.stats.dropped_pushes == Counter(
            {POSE: 500 - len(poses)} if len(poses) < 500 else {}
        )


async def test_a_slow_consumer_does_not_delay_answers() -> None:
    async with linked() as (_peer, client, wire):
        loop = asyncio.get_running_loop()
        seen: list[int] = []

        def slow(message: StatusCode) -> None:
            end = loop.time() + 0.01
            while loop.time() < end:
                pass
            seen.append(message.code)

        client.subscribe(StatusCode, slow)
        for number in range(40):
            await wire.push(CODE, {"code": str(number)})
        await eventually(lambda: seen)
        await answered(client.request(Speak()), wire)
        assert len(seen) < 40  # the answer came before all of them were delivered


async def test_a_flood_does_not_delay_answers_and_consumers() -> None:
    async with linked("tcp") as (_peer, client, wire):
        seen: list[Any] = []
        client.subscribe(StatusCode, seen.append)
        one = delimited({"type": CODE, "body": b"\x08\x01"})
        await wire.raw(one * 5_000)
        await eventually(lambda: seen)
        assert client.stats.rx < 5_000
        await eventually(lambda: client.stats.rx == 5_001)
        await eventually(lambda: len(seen) + client.stats.dropped_pushes[CODE] == 5_000)


# Drops


async def test_dropped_pushes_are_counted_and_logged(caplog: pytest.LogCaptureFixture) -> None:
    async with linked("tcp", push_queue=2) as (_peer, client, wire):
        seen: list[int] = []
        client.subscribe(StatusCode, lambda message: seen.append(message.code))
        await wire.raw(delimited({"type": CODE, "body": b"\x08\x01"}) * 1000)  # read together
        await eventually(lambda: len(seen) + client.stats.dropped_pushes[CODE] == 1000)
        await wire.push(CODE, b"\x08\x09")
        await eventually(lambda: seen[-1:] == [9])
        assert client.stats.dropped_pushes[CODE]
    warnings = [each for each in caplog.records if each.levelno == logging.WARNING]
    assert len([each for each in warnings if CODE in each.getMessage()]) == 1


# The queue


async def taken(queue: PushQueue, count: int) -> None:
    for _ in range(count):
        await soon(queue.wait(), 1)
        queue.get()()


async def test_the_queue_keeps_the_newest_pushes_of_each_type_up_to_its_limit() -> None:
    dropped: Counter[str] = Counter()
    queue = PushQueue({"counted": 20}, dropped)
    seen: list[tuple[str, int]] = []
    fits = []
    sent = LATEST_DEPTH + 20
    for number in range(sent):
        for name in ("state", "counted"):
            item = (name, number)
            fits.append(queue.put(name, lambda item=item: seen.append(item)))  # type: ignore[misc]
    assert dropped == {"state": 20, "counted": LATEST_DEPTH}
    assert fits.count(False) == sum(dropped.values())
    await taken(queue, LATEST_DEPTH + 20)
    assert [n for name, n in seen if name == "state"] == list(range(20, sent))
    assert [n for name, n in seen if name == "counted"] == list(range(LATEST_DEPTH, sent))
    assert seen == sorted(seen, key=lambda one: (one[1], one[0] == "counted"))
    queue.put("state", lambda: seen.clear())
    await taken(queue, 1)  # now there is room
    assert not seen
    assert dropped["state"] == 20


async def test_a_burst_after_an_idle_time_is_delivered_in_one_turn() -> None:
    """Otherwise the reader adds the next pushes to those of the burst, and the queue overflows."""
    record = LinkRecord(logging.getLogger())
    subscriptions = Subscriptions(10, record)
    loop = asyncio.get_running_loop()
    delivery = loop.create_task(subscriptions.deliver())
    await asyncio.sleep(0.02)  # the idle time: more than the delivery's time slice
    answer: Any = None  # for the queue, any object is an answer
    seen: list[int | str] = []
    subscriptions.put_answer(lambda _: loop.call_soon(seen.append, "next turn"), answer)
    for number in range(20):
        subscriptions.put_answer(lambda _, number=number: seen.append(number), answer)  # type: ignore[misc]
    await eventually(lambda: "next turn" in seen)
    assert seen == [*range(20), "next turn"]
    delivery.cancel()


async def test_pushes_tell_the_difference_of_the_clocks_too() -> None:
    async with linked() as (_peer, client, wire):
        for ahead in (-3600.0, 7200.0):
            stamp = round((time.time() + ahead) * 1000)
            await wire.send({"type": POSE, "body": {}, "timestamp": stamp})
            await eventually(
                lambda ahead=ahead: abs((client.stats.clock_offset or 0.0) - ahead) < 600  # type: ignore[misc]
            )
        received = client.stats.rx  # a large push takes long, and its time is then old
        large = {"type": CODE, "body": {"msg": "x" * LARGE}, "timestamp": 1_700_000_000_000}
        await wire.send(large)
        await eventually(lambda: client.stats.rx > received)
        assert abs((client.stats.clock_offset or 0.0) - ahead) < 600
