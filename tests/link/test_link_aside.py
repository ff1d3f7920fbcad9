"""Large messages are converted in a thread: nothing waits for them, nor changes its order."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from google.protobuf.message import Message

from tests.link.link_peer import TIMEOUT, Peer, answered, ask, eventually, linked, soon, turns
from woosh_robot_agent.link import Body, LinkState, Sending, SupersededError
from woosh_robot_agent.link.codecs import JSON
from woosh_robot_agent.link.codecs.json_codec import JsonCodec
from woosh_robot_agent.link.protos import full_name
from woosh_robot_agent.link.tasks import LARGE, offload
from woosh_robot_agent.pb.robot.robot_count_pb2 import StatusCode
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Speak
from woosh_robot_agent.pb.robot.robot_pb2 import NavPath, PoseSpeed, RobotInfo

SPEAK = full_name(Speak)
POSES = 4000
"""Number of poses of a large path."""


def path(poses: int) -> NavPath:
    message = NavPath()
    for i in range(poses):
        message.path.poses.add(x=i / 7, y=i / 11, theta=0.1)
    return message


def info(corners: int) -> RobotInfo:
    message = RobotInfo(robot_id=1)
    for i in range(corners):
        message.model.model.add(x=i / 7, y=i / 11)
    return message


def body(message: Any) -> Any:
    """Return a message as the body of a JSON frame."""
    return json.loads(JSON.encode(full_name(message), message))["body"]


@pytest.fixture
def gate() -> Iterator[threading.Event]:
    """An event for which something in the thread for large messages waits; set at the end."""
    opened = threading.Event()
    yield opened
    opened.set()


async def occupy(
    peer: Peer, client: Any, gate: threading.Event, take: Callable[[Any], None] = lambda _: None
) -> None:
    """Have the thread for large messages wait for an event, in the conversion of a push.

    `take` is called with None when the push is delivered.
    """
    began = threading.Event()

    def prepare(push: Body) -> None:
        began.set()
        assert gate.wait(TIMEOUT)

    client.subscribe_raw(NavPath, take, prepare)
    await (await peer.wire()).push(full_name(NavPath), body(path(POSES)))
    await eventually(began.is_set)


async def test_only_a_large_push_is_converted_in_another_thread() -> None:
    async with Peer() as peer, peer.client() as client:
        seen: list[tuple[int, str, str]] = []

        def prepare(push: Body) -> tuple[int, str]:
            return len(push.message().path.poses), threading.current_thread().name

        client.subscribe_raw(
            NavPath,
            lambda prepared: seen.append((*prepared, threading.current_thread().name)),
            prepare,
        )
        wire = await peer.wire()
        here = threading.current_thread().name
        for poses in (1, POSES, 1):
            count = len(seen)
            assert (len(json.dumps(body(path(poses)))) > LARGE) == (poses == POSES)
            await wire.push(full_name(NavPath), body(path(poses)))
            await eventually(lambda count=count: len(seen) > count)
        assert [poses for poses, _, _ in seen] == [1, POSES, 1]
        assert [converted == here for _, converted, _ in seen] == [True, False, True]
        assert {called for _, _, called in seen} == {here}


async def test_only_pushes_of_the_same_type_wait_for_a_large_one_in_their_order(
    gate: threading.Event,
) -> None:
    async with Peer() as peer, peer.client() as client:
        poses: list[PoseSpeed] = []
        lengths: list[int] = []
        client.subscribe(PoseSpeed, poses.append)
        client.subscribe(NavPath, lambda push: lengths.append(len(push.path.poses)))
        await occupy(peer, client, gate)
        wire = await peer.wire()
        for number in range(3):
            await wire.push(full_name(NavPath), body(path(number)))
        await eventually(lambda: client.debug()["pushes"] == 3)
        await wire.push(full_name(PoseSpeed))
        await eventually(lambda: poses)
        assert (await answered(client.request(Speak()), wire)).ok
        assert lengths in ([], [POSES])  # the three wait
        gate.set()
        await eventually(lambda: len(lengths) == 4)
        assert lengths == [POSES, 0, 1, 2]


async def test_pushes_go_on_after_a_large_one_that_a_subscriber_cannot_read() -> None:
    async with Peer() as peer, peer.client() as client:
        codes: list[int] = []
        client.subscribe_raw(StatusCode, lambda push: codes.append(push.message().code))
        wire = await peer.wire()
        for code in ("no number", 7):
            await wire.push(full_name(StatusCode), {"code": code, "msg": "x" * LARGE})
        await eventually(lambda: codes == [7])
        assert client.stats.bad_frames.total() == 1


async def test_a_push_that_a_newer_one_overtook_while_it_was_decoded_is_dropped(
    gate: threading.Event,
) -> None:
    async with Peer() as peer, peer.client() as client:
        lengths: list[int] = []
        client.subscribe(RobotInfo, lambda push: lengths.append(len(push.model.model)))
        await occupy(peer, client, gate)
        wire = await peer.wire()
        for poses in (POSES, 1):
            await wire.push(full_name(RobotInfo), body(info(poses)))
        await eventually(lambda: lengths)
        gate.set()
        await eventually(lambda: client.stats.dropped_pushes[full_name(RobotInfo)] == 1)
        assert lengths == [1]


async def test_an_urgent_request_overtakes_a_large_one_and_the_others_keep_their_order(
    gate: threading.Event,
) -> None:
    async with Peer() as peer, peer.client() as client:
        await occupy(peer, client, gate)
        wire = await peer.wire()
        large = ask(client, Speak(text="z" * LARGE))
        later = ask(client, Speak(text="later"))
        urgent = asyncio.ensure_future(client.send(Speak(text="urgent"), Sending(urgent=True)))
        frame = await wire.next(SPEAK)
        assert frame["body"] == {"text": "urgent"}
        await wire.answer(frame)
        await soon(urgent)
        assert wire.frames.empty()
        gate.set()
        frames = [await wire.next(SPEAK) for _ in range(2)]
        assert [len(frame["body"]["text"]) for frame in frames] == [LARGE, len("later")]
        for frame in frames:
            await wire.answer(frame)
        await soon(asyncio.gather(large, later))


async def test_a_large_request_that_is_withdrawn_while_it_is_encoded_is_not_sent(
    gate: threading.Event,
) -> None:
    async with Peer() as peer, peer.client() as client:
        await occupy(peer, client, gate)
        wire = await peer.wire()
        large = ask(client, Speak(text="z" * LARGE))
        await eventually(lambda: client.debug()["outbox"] == 1)
        client.withdraw(lambda message: isinstance(message, Speak), "it is not wanted")
        with pytest.raises(SupersededError, match="it is not wanted"):
            await soon(large)
        gate.set()
        last = ask(client, Speak(text="last"))
        frame = await wire.next(SPEAK)
        assert frame["body"] == {"text": "last"}
        await wire.answer(frame)
        await soon(last)


async def test_a_link_that_ends_before_its_robot_info_is_delivered_was_never_ready(
    gate: threading.Event,
) -> None:
    """What is sent to the robot as soon as the link is ready, e.g. a zero, would be lost."""
    async with Peer(info=body(info(POSES))) as peer:
        client = peer.client()
        states: list[LinkState] = []
        began = threading.Event()

        def prepare(_: RobotInfo) -> None:
            began.set()
            assert gate.wait(TIMEOUT)

        client.on_snapshot(lambda _: None, prepare)
        client.on_state(states.append)
        client.start()
        await eventually(began.is_set)
        (await peer.wire()).abort()
        await eventually(lambda: LinkState.WAITING in states)
        assert LinkState.READY not in states
        gate.set()
        await eventually(lambda: LinkState.READY in states)
        await client.close()


async def test_a_large_push_of_a_lost_link_does_not_follow_the_new_robot_info(
    gate: threading.Event,
) -> None:
    async with Peer() as peer, peer.client() as client:
        seen: list[Any] = []
        client.on_snapshot(seen.append)
        await occupy(peer, client, gate, seen.append)
        (await peer.wire()).abort()
        await eventually(lambda: seen)
        gate.set()
        await offload(int)  # the conversion has ended
        await turns()
        assert seen == [RobotInfo()]


@pytest.mark.parametrize("is_cancelled", [True, False])
async def test_what_waits_behind_a_large_request_is_sent_when_that_is_given_up(
    is_cancelled: bool, gate: threading.Event
) -> None:
    async with Peer() as peer, peer.client() as client:
        await occupy(peer, client, gate)
        wire = await peer.wire()
        large = ask(client, Speak(text="z" * LARGE))
        behind = ask(client, Speak(text="behind"))
        await eventually(lambda: client.debug()["outbox"] == 2)
        if is_cancelled:
            large.cancel()
        else:
            client.withdraw(lambda message: message.ByteSize() > LARGE, "it is not wanted")
        frame = await wire.next(SPEAK)
        assert frame["body"] == {"text": "behind"}
        await wire.answer(frame)
        await soon(behind)
        await asyncio.gather(large, return_exceptions=True)


async def test_of_two_large_pushes_the_second_is_not_dropped(gate: threading.Event) -> None:
    async with Peer() as peer, peer.client() as client:
        lengths: list[int] = []
        client.subscribe(RobotInfo, lambda push: lengths.append(len(push.model.model)))
        await occupy(peer, client, gate)
        wire = await peer.wire()
        before = client.debug()["tasks"]
        for corners in (POSES, POSES + 1):
            await wire.push(full_name(RobotInfo), body(info(corners)))
        await eventually(lambda: client.debug()["tasks"] == before + 2)  # both have arrived
        gate.set()
        await eventually(lambda: POSES + 1 in lengths)


@pytest.mark.parametrize(("pushed", "is_outdated"), [(StatusCode, True), (PoseSpeed, False)])
async def test_an_answer_that_a_newer_push_of_its_type_overtook_is_outdated(
    pushed: type[Message], is_outdated: bool, gate: threading.Event
) -> None:
    async with Peer() as peer, peer.client() as client:
        pushes: list[Message] = []
        client.subscribe(pushed, pushes.append)
        await occupy(peer, client, gate)
        wire = await peer.wire()
        asked = asyncio.ensure_future(client.request(StatusCode()))
        frame = await wire.next(full_name(StatusCode))
        await wire.answer(frame, {"msg": "x" * LARGE})
        await wire.push(full_name(pushed))
        await eventually(lambda: pushes)
        gate.set()
        assert (await soon(asked)).is_outdated == is_outdated


async def test_a_large_request_that_cannot_be_encoded_fails_and_the_link_stays(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail(*_: Any, **__: Any) -> str:
        raise ValueError("cannot be encoded")

    async with linked() as (_peer, client, wire):
        with monkeypatch.context() as patch:
            patch.setattr(JsonCodec, "encode", fail)
            with pytest.raises(ValueError, match="cannot be encoded"):
                await soon(client.request(Speak(text="z" * LARGE)))
        assert (await answered(client.request(Speak()), wire)).ok


async def test_a_large_robot_info_is_converted_aside_and_later_pushes_wait_for_it(
    gate: threading.Event,
) -> None:
    async with Peer(info=body(info(POSES))) as peer:
        client = peer.client()
        seen: list[str] = []
        began = threading.Event()

        def prepare(info: RobotInfo) -> str:
            began.set()
            assert gate.wait(TIMEOUT)
            return f"{len(info.model.model)} corners"

        client.on_snapshot(seen.append, prepare)
        client.subscribe(PoseSpeed, lambda push: seen.append("pose"))
        client.start()
        await eventually(began.is_set)
        await (await peer.wire()).push(full_name(PoseSpeed))
        await eventually(lambda: client.debug()["pushes"] == 2)  # and the end of the handshake
        assert not seen
        assert client.state is LinkState.CONNECTING  # who commands the robot must know its state
        gate.set()
        await eventually(lambda: len(seen) == 2)
        await client.close()
        assert seen == [f"{POSES} corners", "pose"]
