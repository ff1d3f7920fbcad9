"""Recording and replaying over real sockets."""

from __future__ import annotations

import asyncio
import contextlib
from contextlib import AsyncExitStack
from typing import Any

import pytest

from tests.asynchronous import eventually, listening, read_to_end
from tests.quick_chassis import quick_config
from tests.tools.connections import KINDS, connected, link
from tests.tools.recordings import recording
from woosh_robot_agent.endpoints import COMMANDS, QUERIES
from woosh_robot_agent.link import ChassisClient, LinkState
from woosh_robot_agent.link.tasks import cancel_and_wait
from woosh_robot_agent.pb.robot.robot_pack_pb2 import ExecTask, Speak, SwitchWorkMode
from woosh_robot_agent.pb.robot.robot_pb2 import Mode, RobotInfo
from woosh_robot_agent.pb.util import robot_pb2 as robot
from woosh_robot_agent.pb.util import task_pb2 as task
from woosh_robot_agent.simulator import SimulatedChassis
from woosh_robot_agent.tools.recording.layout import Event, Frame, Recording
from woosh_robot_agent.tools.recording.reader import read_recording
from woosh_robot_agent.tools.recording.record import PassiveClient
from woosh_robot_agent.tools.recording.replayed_chassis import ReplayedChassis
from woosh_robot_agent.tools.recording.timeline import prepare


def simulator(speed: float = 50.0) -> SimulatedChassis:
    return SimulatedChassis(quick_config(port=0, tcp_port=0, speed=speed, seed=1))


def port_of(chassis: SimulatedChassis | ReplayedChassis, kind: str) -> int:
    return chassis.tcp_port if kind == "tcp" else chassis.port


def frames(found: Recording) -> list[Any]:
    """Return the frames of the chassis."""
    return [r.data for r in found.records if isinstance(r, Frame) and r.sender == "chassis"]


def events(found: Recording) -> list[tuple[str, str]]:
    return [(r.kind, r.by) for r in found.records if isinstance(r, Event)]


@pytest.mark.parametrize("kind", KINDS)
async def test_a_task_is_recorded_and_replayed(kind, tmp_path):
    path = tmp_path / "task.mcap"
    async with (
        simulator() as chassis,
        recording(path, port_of(chassis, kind), kind) as port,
        connected(port, kind) as (client, pushes),
    ):
        assert (await client.request(ExecTask(task_id=7, type=task.kPick, mark_no="A2"))).ok
        await eventually(lambda: task.kCompleted in [getattr(m, "state", None) for m in pushes])
        info = (await client.request(RobotInfo())).body
    found = read_recording(path)
    assert events(found) == [("open", "client"), ("close", "client")]
    assert {type(data) for data in frames(found)} == {str if kind == "json" else bytes}
    playback = prepare(found)
    assert playback.answers.unmatched == 0
    async with (
        ReplayedChassis(playback, speed=50) as replayed,
        connected(port_of(replayed, kind), kind) as (client, again),
    ):
        await eventually(lambda: replayed.rounds, "the end of the recording")
        await eventually(lambda: len(again) >= len(pushes), "the last push")
        assert again[: len(pushes)] == pushes
        assert (await client.request(RobotInfo())).body == info
        # the body differs: any answer of the type will do
        assert (await client.request(ExecTask(type=1, mark_no="B1"))).ok
        refused = await client.request(Speak(text="hello"))
        assert not refused.ok
        assert refused.msg == "the recording has no request of type woosh.robot.Speak"


async def test_all_bytes_are_forwarded_unchanged(tmp_path):
    """This includes bytes that are not WebSocket frames."""
    got = asyncio.Event()
    there = bytearray()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(bytes(range(256)) * 1000)
        while data := await reader.read(10_000):
            there.extend(data)
        got.set()
        writer.write(b"bye")  # this direction is still open
        writer.close()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    path = tmp_path / "a.mcap"
    async with recording(path, server.sockets[0].getsockname()[1]) as port:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(b"anything\xff" * 20_000)
        assert await reader.readexactly(256_000) == bytes(range(256)) * 1000
        writer.write_eof()
        await asyncio.wait_for(got.wait(), 10)
        assert there == b"anything\xff" * 20_000
        assert await reader.read() == b"bye"
        writer.close()
    server.close()
    kinds = [kind for kind, _ in events(read_recording(path))]
    assert kinds == ["open", "unreadable", "unreadable", "close"]


async def test_bad_frames_are_recorded_and_replayed(tmp_path):
    path = tmp_path / "a.mcap"
    async with (
        simulator() as chassis,
        recording(path, chassis.port) as port,
        connected(port) as (client, _),
    ):
        chassis.send_raw("{no json")
        await eventually(lambda: client.stats.bad_frames["json"], "the bad frame")
    assert "{no json" in frames(read_recording(path))
    async with (
        ReplayedChassis(prepare(read_recording(path))) as replayed,
        connected(replayed.port) as (client, _),
    ):
        await eventually(lambda: client.stats.bad_frames["json"], "the bad frame again")


async def test_a_lost_connection_is_lost_again_in_the_replay(tmp_path):
    path = tmp_path / "a.mcap"
    async with (
        simulator() as chassis,
        recording(path, chassis.port) as port,
        connected(port) as (client, pushes),
    ):
        assert (await client.request(SwitchWorkMode(mode=robot.kDeployMode))).ok
        await eventually(lambda: len(pushes) == 1)
        await chassis.stop_listening()
        await eventually(lambda: client.state is LinkState.WAITING)
        await eventually(
            lambda: ("refused", "chassis") in events(read_recording(path)), "an attempt that fails"
        )
        await chassis.listen()
        await eventually(lambda: client.stats.connects == 2)
        await eventually(lambda: chassis.counts["woosh.Subscription"] == 2)
        chassis.push(Mode(work=robot.kTaskMode))
        await eventually(lambda: len(pushes) == 2)
    found = read_recording(path)
    kinds = events(found)
    assert kinds[:2] == [("open", "client"), ("close", "chassis")]
    assert kinds[-2:] == [("open", "client"), ("close", "client")]
    assert set(kinds[2:-2]) == {("refused", "chassis")}
    async with ReplayedChassis(prepare(found), wait_for_commands=True) as replayed:
        seen: list[LinkState] = []
        client, again = ChassisClient(config=link(replayed.port)), []
        client.on_state(seen.append)
        client.subscribe(Mode, again.append)
        async with client:
            # The playback waits for this command, so the client sees the loss.
            assert (await client.request(SwitchWorkMode(mode=robot.kDeployMode))).ok
            await eventually(lambda: replayed.rounds, "the end")
            await eventually(lambda: len(again) == 2)
            await eventually(
                lambda: client.stats.connects == 2, "the client to note the connection"
            )
            # The last recorded connection was closed by its client, which is not replayed.
            assert client.state is LinkState.READY
        assert [m.work for m in again] == [robot.kDeployMode, robot.kTaskMode]
        lost = seen.index(LinkState.WAITING)
        assert seen[lost + 1] is LinkState.CONNECTING


async def test_what_follows_a_silent_loss_is_replayed(tmp_path):
    """As over Wi-Fi: the client connects again before the robot notices the loss."""
    path = tmp_path / "a.mcap"
    timeouts = {"liveness_timeout": 0.5, "request_timeout": 0.5}
    async with (
        simulator() as chassis,
        recording(path, chassis.port) as port,
        connected(port, **timeouts) as (client, pushes),
    ):
        await eventually(lambda: chassis.counts["woosh.Subscription"] == 1)
        for work in (robot.kDeployMode, robot.kTaskMode) * 5:
            chassis.push(Mode(work=work))
        await eventually(lambda: len(pushes) == 10)
        loss = chassis.inject("half_open")
        await eventually(lambda: events(read_recording(path)).count(("open", "client")) == 2)
        loss.clear()
        await eventually(lambda: chassis.counts["woosh.Subscription"] == 2)
        chassis.push(Mode(work=robot.kScheduleMode))
        await eventually(lambda: len(pushes) == 11)
    async with (
        ReplayedChassis(prepare(read_recording(path)), speed=50) as replayed,
        connected(replayed.port) as (client, again),
    ):
        await eventually(lambda: replayed.rounds, "the end")
        await eventually(lambda: again == pushes, "the push after the loss")
        await eventually(lambda: client.stats.connects == 2, "the client to note the connection")


async def test_the_end_of_the_recording_is_not_a_lost_connection(tmp_path):
    path = tmp_path / "a.mcap"
    async with (
        simulator() as chassis,
        AsyncExitStack() as stack,  # the client outlives the recording
        recording(path, chassis.port) as port,
    ):
        await stack.enter_async_context(connected(port))
    assert events(read_recording(path))[-1] == ("close", "recorder")
    async with (
        ReplayedChassis(prepare(read_recording(path))) as replayed,
        connected(replayed.port) as (client, _),
    ):
        await eventually(lambda: replayed.rounds)
        assert (await client.request(RobotInfo())).ok
        assert client.stats.connects == 1


@pytest.mark.parametrize("client_ends", [False, True])
async def test_what_the_network_has_not_taken_is_dropped(tmp_path, monkeypatch, client_ends):
    """A command must not arrive long after the end of its client or of the recording."""
    monkeypatch.setattr("woosh_robot_agent.tools.recording.proxy._LINGER_TIMEOUT", 0.1)
    loop = asyncio.get_running_loop()
    with listening(1) as server:  # it takes only a few kB
        async with recording(tmp_path / "a.mcap", server.getsockname()[1]) as port:
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            chassis, _ = await loop.sock_accept(server)
            writer.write(bytes(60_000))
            await loop.sock_recv(chassis, 1)  # the proxy forwards
            if client_ends:
                writer.write_eof()
                with contextlib.suppress(ConnectionResetError):
                    await asyncio.wait_for(reader.read(), 5)  # until the proxy has ended, too
        with chassis, pytest.raises(ConnectionResetError):
            await read_to_end(chassis, 5)
        writer.close()


async def test_a_client_that_connects_while_the_proxy_stops_is_dropped(tmp_path, monkeypatch):
    late: list[tuple[asyncio.StreamReader, asyncio.StreamWriter]] = []

    async def cancel_and_connect(*tasks: Any) -> None:
        await cancel_and_wait(*tasks)
        if not late:
            late.append(await asyncio.open_connection("127.0.0.1", port))
            await asyncio.sleep(0.1)  # the proxy accepts it

    monkeypatch.setattr(
        "woosh_robot_agent.tools.recording.proxy.cancel_and_wait", cancel_and_connect
    )
    async with simulator() as chassis:
        async with recording(tmp_path / "a.mcap", chassis.port) as port:
            pass
        ((reader, writer),) = late
        with contextlib.suppress(ConnectionResetError):
            assert await asyncio.wait_for(reader.read(), 5) == b""
        writer.close()


async def test_the_passive_client_sends_each_query_and_no_command(tmp_path):
    path = tmp_path / "a.mcap"
    queries = {query.request for query in QUERIES}
    async with simulator(speed=1.0) as chassis, recording(path, chassis.port) as port:
        own = PassiveClient(link(port))
        own.start()
        await eventually(lambda: queries <= set(chassis.counts), "the last query")
        chassis.push(Mode(work=robot.kDeployMode))
        await eventually(lambda: any('"work":1' in each for each in frames(read_recording(path))))
        await own.close()
        asked = set(chassis.counts)
    playback = prepare(read_recording(path))
    assert set(playback.answers.types) == asked - {"woosh.Subscription"}
    assert not asked & {command.request for command in COMMANDS if not command.reads}


async def test_a_query_that_ends_the_connection_is_sent_twice(tmp_path):
    queries = {query.request for query in QUERIES}
    async with (
        simulator(speed=1.0) as chassis,
        recording(tmp_path / "a.mcap", chassis.port) as port,
    ):
        chassis.inject("truncated", type="woosh.robot.Battery", where="wire")
        own = PassiveClient(link(port))
        own.start()
        await eventually(lambda: queries <= set(chassis.counts), "the last query")
        await own.close()
        assert chassis.counts["woosh.robot.Battery"] == 2
