"""Replay of made-up recordings."""

from __future__ import annotations

import asyncio
import json
import socket
import tracemalloc
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from tests.asynchronous import TIMEOUT, eventually
from tests.tools.connections import connected, link
from woosh_robot_agent.link import ChassisClient, LinkState, RequestTimeoutError
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Speak, SwitchWorkMode
from woosh_robot_agent.pb.robot.robot_pb2 import Battery, Mode, PoseSpeed, RobotInfo
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.tools.options import ToolError
from woosh_robot_agent.tools.recording.layout import Event, Frame, Recording
from woosh_robot_agent.tools.recording.replayed_chassis import ReplayedChassis
from woosh_robot_agent.tools.recording.timeline import prepare


def made_up(*records: Any) -> Recording:
    """Return a recording made of tuples.

    A frame is (t, connection, sender, data), an event (t, connection, kind, by).
    """
    found: list[Any] = []
    for t, connection, what, which in records:
        if what in ("client", "chassis"):
            data = which if isinstance(which, str) else json.dumps(which)
            found.append(Frame(t, connection, what, data))
        else:
            found.append(Event(t, connection, what, which))
    return Recording("ws://x", 0.0, tuple(found))


def subscribed(t: float, *topics: str, connection: int = 1) -> Any:
    body = {"topics": list(topics), "sub": True}
    return (t, connection, "client", {"type": "woosh.Subscription", "body": body})


def exchange(
    t: float, name: str, sn: int, ask: Any, answer: Any = None, connection: int = 1
) -> Any:
    records = [(t, connection, "client", {"type": name, "body": ask, "sn": sn})]
    if answer is not None:
        frame = {"type": name, "body": {}, "ok": True, "msg": answer, "sn": sn}
        records.append((t + 0.01, connection, "chassis", frame))
    return records


def pushed(t: float, name: str, body: Any, connection: int = 1) -> Any:
    return (t, connection, "chassis", {"type": name, "body": body})


INFO = exchange(0.0, "woosh.robot.RobotInfo", 900, {}, "")
SWITCH = exchange(0.2, "woosh.robot.SwitchWorkMode", 1, {"mode": 1}, "done")
MODE = [subscribed(0.1, "woosh.robot.Mode"), pushed(0.3, "woosh.robot.Mode", {"work": 1})]
"""A subscription and a push."""


async def wait_round_trips(client: ChassisClient) -> None:
    """Wait for some round trips: enough for a fast playback to send something too early."""
    for _ in range(10):
        await client.request(RobotInfo())


@asynccontextmanager
async def replaying(*records: Any, **options: Any) -> AsyncIterator[ReplayedChassis]:
    opened = (0.0, 1, "open", "client")
    async with ReplayedChassis(prepare(made_up(opened, *INFO, *records)), **options) as chassis:
        yield chassis


async def test_answers_are_chosen_by_the_request_in_recorded_order_and_as_late() -> None:
    asked, late = exchange(3, "woosh.robot.Speak", 3, {"text": "a"}, "second a")
    records = [
        *exchange(1, "woosh.robot.Speak", 1, {"text": "a"}, "first a"),
        *exchange(2, "woosh.robot.Speak", 2, {"text": "b"}, "b"),
        *(asked, (3.5, *late[1:])),
        *exchange(4, "woosh.robot.SwitchWorkMode", 4, {"mode": 1}),  # not answered
    ]
    async with replaying(*records) as replayed, connected(replayed.port) as (client, _):
        said = [(await client.request(Speak(text=text))).msg for text in ("a", "b")]
        assert said == ["first a", "b"]
        before = asyncio.get_running_loop().time()
        said = [(await client.request(Speak(text=text))).msg for text in ("a", "a", "b", "c")]
        assert said == ["second a", "second a", "b", "first a"]
        assert asyncio.get_running_loop().time() - before > 0.9
        with pytest.raises(RequestTimeoutError):
            await client.request(SwitchWorkMode(mode=robot.kDeployMode), 0.3)


async def test_a_recorded_half_of_a_surrogate_pair_is_replayed() -> None:
    """E.g. the name of a network that the robot has cut in the middle of a character."""
    records = exchange(1, "woosh.robot.Speak", 1, {"text": "a"}, "cut \ud83d")
    async with replaying(*records) as replayed, connected(replayed.port) as (client, _):
        assert "cut" in (await client.request(Speak(text="a"))).msg


def test_answers_without_a_request_are_left_out() -> None:
    stray = (1, 1, "chassis", {"type": "woosh.robot.Mode", "body": {}, "ok": True, "sn": 1234})
    assert prepare(made_up(stray)).answers.unmatched == 1


def test_preparing_a_recording_takes_less_memory_than_its_frames() -> None:
    scan = {"ranges": list(range(1000, 3000))}
    records = [pushed(t, "woosh.robot.ScannerData", scan) for t in range(100)]
    recording = made_up(*records)
    tracemalloc.start()
    prepare(recording)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < sum(len(each.data) for each in recording.records if isinstance(each, Frame))


async def test_pushes_go_to_subscribers() -> None:
    records = [
        (0.1, 1, "client", {"type": "woosh.Subscription", "body": {"topics": 5}}),  # ignored
        subscribed(0.1, "woosh.robot.PoseSpeed", "woosh.robot.Mode"),
        pushed(0.2, "woosh.robot.PoseSpeed", {"mapId": 1}),
        pushed(0.3, "woosh.robot.Mode", {"work": 1}),
        # a push without a recorded subscription goes to every client
        pushed(0.4, "woosh.robot.Battery", {"power": 3}),
    ]
    async with replaying(*records) as replayed:
        poses: list[Any] = []
        async with connected(replayed.port) as (client, pushes):
            client.subscribe(PoseSpeed, poses.append)()  # subscribe and unsubscribe
            await eventually(lambda: replayed.rounds)
            await eventually(lambda: len(pushes) == 2)
        assert [type(m) for m in pushes] == [Mode, Battery]
        assert poses == []


async def test_the_playback_pauses_until_a_client_subscribes() -> None:
    async with (
        replaying(*MODE, speed=1e5) as replayed,
        ChassisClient(config=link(replayed.port)) as client,  # without a subscription
    ):
        await wait_round_trips(client)
        assert replayed.rounds == 0
        pushes: list[Any] = []
        client.subscribe(Mode, pushes.append)
        await eventually(lambda: replayed.rounds == 1)
        await eventually(lambda: len(pushes) == 1)


async def test_the_port_stays_closed_if_the_robot_never_came_back() -> None:
    records = [subscribed(0.1, "woosh.robot.Mode"), *SWITCH, (0.3, 1, "close", "chassis")]
    async with (
        replaying(*records, wait_for_commands=True) as replayed,
        connected(replayed.port) as (client, _),
    ):
        assert (await client.request(SwitchWorkMode(mode=robot.kDeployMode))).msg == "done"
        await eventually(lambda: replayed.rounds)
        await eventually(lambda: client.state is LinkState.WAITING)
        with pytest.raises(OSError):
            await asyncio.open_connection("127.0.0.1", replayed.port)
        assert client.stats.connects == 1


async def test_the_playback_pauses_until_a_command_is_sent() -> None:
    subscription, push = MODE
    async with (
        replaying(subscription, *SWITCH, push, wait_for_commands=True, speed=1e5) as replayed,
        connected(replayed.port) as (client, pushes),
    ):
        await wait_round_trips(client)
        assert pushes == []
        assert (await client.request(SwitchWorkMode(mode=robot.kDeployMode))).msg == "done"
        await eventually(lambda: len(pushes) == 1)


@pytest.mark.parametrize("kind", ["protobuf", "tcp"])
async def test_each_client_receives_its_own_encoding(kind: str) -> None:
    """The recording is in JSON."""
    spoken = exchange(0.3, "woosh.robot.Speak", 1, {"text": "a"}, "spoken")
    async with replaying(*MODE, *spoken) as replayed:
        port = replayed.tcp_port if kind == "tcp" else replayed.port
        async with connected(port, kind) as (client, pushes):
            await eventually(lambda: pushes == [Mode(work=robot.kDeployMode)])
            assert (await client.request(Speak(text="a"))).msg == "spoken"


async def test_a_loop_starts_again_although_the_robot_never_came_back() -> None:
    async with (
        replaying(*MODE, (0.4, 1, "close", "chassis"), loop=True) as replayed,
        connected(replayed.port) as (client, pushes),
    ):
        await eventually(lambda: len(pushes) >= 2)
        assert client.stats.connects >= 2


async def test_a_port_that_was_taken_during_a_recorded_loss_is_an_error() -> None:
    records = [
        subscribed(0.1, "woosh.robot.Mode"),
        (0.2, 1, "close", "chassis"),
        (2.5, 2, "open", "client"),
        pushed(2.6, "woosh.robot.Mode", {"work": 1}, connection=2),
    ]

    def take(port: int) -> socket.socket | None:
        try:
            return socket.create_server(("127.0.0.1", port))
        except OSError:
            return None

    async with replaying(*records) as replayed, connected(replayed.port):
        with await eventually(lambda: take(replayed.port)), pytest.raises(ToolError):
            await asyncio.wait_for(replayed.wait(asyncio.Event()), TIMEOUT)


async def test_the_client_with_the_most_frames_gives_the_timeline() -> None:
    records = [
        subscribed(0.1, "woosh.robot.Mode"),
        (0.1, 2, "open", "client"),
        subscribed(0.1, "woosh.robot.Mode", connection=2),
        pushed(0.2, "woosh.robot.Mode", {"work": 1}),
        pushed(0.2, "woosh.robot.Mode", {"work": 1}, connection=2),
        *exchange(0.2, "woosh.robot.Speak", 1, {}, "hello", connection=2),
        (0.25, 2, "close", "chassis"),
        pushed(0.3, "woosh.robot.Mode", {"work": 2}),
    ]
    async with (
        replaying(*records) as replayed,
        connected(replayed.port) as (client, pushes),
    ):
        await eventually(lambda: replayed.rounds)
        await eventually(lambda: len(pushes) == 2)
        assert [m.work for m in pushes] == [1, 2]
        assert (await client.request(Speak())).msg == "hello"
        assert client.stats.connects == 1
