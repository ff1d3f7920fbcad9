"""Closing and reconfiguring: of the client, of one connection, and while a timeout runs."""

from __future__ import annotations

import asyncio
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from tests.asynchronous import listening, read_to_end
from tests.link.link_peer import (
    INFO,
    TIMEOUT,
    Peer,
    RawServer,
    ask,
    block,
    config,
    eventually,
    ours,
    silent,
    soon,
    states,
    turns,
)
from woosh_robot_agent.link import (
    ChassisClient,
    ConnectionLostError,
    LinkState,
    NotConnectedError,
)
from woosh_robot_agent.link.tasks import run_with_timeout
from woosh_robot_agent.link.transport import open_transport
from woosh_robot_agent.pb.robot.robot_pack_pb2 import Speak
from woosh_robot_agent.pb.robot.robot_pb2 import PoseSpeed


@pytest.mark.parametrize(("kind", "is_full"), [("json", False), ("json", True), ("tcp", True)])
async def test_a_close_ends_even_if_the_other_end_reads_nothing(kind: str, is_full: bool) -> None:
    async with Peer(kind) as peer:
        client = await peer.client().__aenter__()
        wire = await peer.wire()
        wire.freeze()
        task = await block(client, wire) if is_full else ask(client, Speak())
        await turns()
        await soon(client.close())
        assert not ours()
        with pytest.raises(ConnectionLostError, match="the link was closed"):
            await task


async def test_what_the_kernel_has_not_sent_is_dropped_with_the_connection() -> None:
    """A command must not arrive when the link was given up long ago."""
    loop = asyncio.get_running_loop()
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.setblocking(False)
        transport = await open_transport(config(server.getsockname()[1], transport="tcp"))
        chassis, _ = await loop.sock_accept(server)
        with chassis:
            sending = asyncio.ensure_future(transport.send(bytes(10_000_000)))
            await turns()
            transport.abort()
            with pytest.raises(ConnectionResetError):
                await soon(read_to_end(chassis))
        await asyncio.wait({sending})
        sending.exception()


async def test_what_the_kernel_has_not_sent_is_dropped_soon_after_an_orderly_close() -> None:
    loop = asyncio.get_running_loop()
    with listening(4096) as server:
        transport = await open_transport(config(server.getsockname()[1], transport="tcp"))
        chassis, (_, port) = await loop.sock_accept(server)
        with chassis:
            await transport.send(bytes(100_000))
            assert transport.backlog() == 0
            await transport.close(0.2)
            local = f":{port:04X} "
            await eventually(lambda: local not in client_ends(), "the end of the connection")
            with pytest.raises(ConnectionResetError):
                await soon(read_to_end(chassis))


def client_ends() -> str:
    """Return the local addresses of all TCP connections of this machine, also of closed sockets."""
    lines = Path("/proc/net/tcp").read_text().splitlines()[1:]
    return "".join(f"{line.split()[1]} " for line in lines)


@pytest.mark.parametrize("kind", ["json", "tcp"])
async def test_an_orderly_close_does_not_wait_for_the_close_timeout(kind: str) -> None:
    async with Peer(kind) as peer:
        client = await peer.client(close_timeout=10 * TIMEOUT).__aenter__()
        await soon(client.close())
        await soon((await peer.wire()).gone.wait())


@pytest.mark.parametrize("kind", ["json", "tcp"])
async def test_a_cancelled_close_still_drops_the_connection(kind: str) -> None:
    async with Peer(kind) as peer:
        client = await peer.client(close_timeout=0.2).__aenter__()
        wire = await peer.wire()
        wire.freeze()
        closing = asyncio.ensure_future(client.close())
        await turns(3)
        closing.cancel()
        with pytest.raises(asyncio.CancelledError):
            await closing
        await eventually(lambda: not ours())
        wire.thaw()
        await soon(wire.gone.wait())


@pytest.mark.parametrize("pause", [1, 20])
async def test_a_connection_whose_close_is_cancelled_is_dropped(pause: int) -> None:
    async with Peer("tcp") as peer, peer.client(close_timeout=TIMEOUT) as client:
        task = await block(client, await peer.wire())
        connection = client._connection
        assert connection is not None
        closing = asyncio.ensure_future(connection.close(ConnectionLostError("test")))
        await turns(pause)
        closing.cancel()
        with pytest.raises(asyncio.CancelledError):
            await closing
        assert connection._transport.backlog() == 0
        with pytest.raises(ConnectionLostError):
            await task


@pytest.mark.parametrize("kind", ["json", "tcp"])
async def test_a_client_can_be_closed_at_any_moment_of_connecting(kind: str) -> None:
    async with Peer(kind) as peer:
        for pause in (0, 1, 2, 3, 5, 8, 13, 21, 34):
            client = peer.client()
            client.start()
            await turns(pause)
            await soon(client.close(), 5)
            assert client.state is LinkState.STOPPED
            assert not ours()
            for wire in peer.wires:
                await soon(wire.gone.wait())


async def test_a_client_can_be_closed_twice_or_without_a_start_and_started_again() -> None:
    async with Peer() as peer:
        client = peer.client()
        await client.close()
        assert client.state is LinkState.STOPPED
        await client.__aenter__()
        await asyncio.gather(client.close(), client.close())
        await client.close()
        assert client.state is LinkState.STOPPED
        async with client:
            assert client.state is LinkState.READY
        assert client.stats.connects == 2


async def test_close_ends_wait_ready_with_an_error() -> None:
    async with RawServer(silent) as server:
        client = ChassisClient(config=config(server.port))
        client.start()
        waiting = asyncio.ensure_future(client.wait_ready(30))
        await turns()
        await client.close()
        with pytest.raises(NotConnectedError):
            await soon(waiting)


async def test_a_start_during_a_close_gives_one_link() -> None:
    async with Peer() as peer:
        client = await peer.client().__aenter__()
        seen = states(client)
        closing = asyncio.ensure_future(client.close())
        await turns(1)
        client.start()
        await closing
        await client.wait_ready(TIMEOUT)
        assert LinkState.STOPPED not in seen
        assert client.state is LinkState.READY
        assert ours().count("link to the chassis") == 1
        await client.close()


async def test_a_new_configuration_moves_the_link_to_the_other_address() -> None:
    async with Peer() as one, Peer("tcp") as two, one.client() as client:
        wire = await one.wire()
        seen: list[int] = []
        client.subscribe(PoseSpeed, lambda pose: seen.append(pose.map_id))
        await client.reconfigure(two.config())
        await soon(wire.gone.wait())
        await client.wait_ready(TIMEOUT)
        assert client.config.transport == "tcp"
        other = await two.wire()
        assert [frame["type"] for frame in other.seen] == ["woosh.Subscription", INFO]
        await other.push("woosh.robot.PoseSpeed", b"\x18\x05")
        await eventually(lambda: seen == [5])
        assert len(one.wires) == 1


async def test_many_new_configurations_at_once_leave_one_link() -> None:
    async with Peer() as one, Peer() as two, one.client() as client:
        await asyncio.gather(*(client.reconfigure(p.config()) for p in (two, one, two, one, two)))
        await client.wait_ready(TIMEOUT)
        assert ours().count("link to the chassis") == 1
        await eventually(lambda: sum(not wire.gone.is_set() for wire in one.wires + two.wires) == 1)
        assert not two.wires[-1].gone.is_set()


async def test_the_new_link_waits_until_the_old_one_is_closed() -> None:
    async with Peer() as one, Peer() as two, one.client() as client:
        (await one.wire()).freeze()
        runners: list[int] = []
        client.on_state(
            lambda state: (
                runners.append(ours().count("link to the chassis"))
                if state is LinkState.CONNECTING
                else None
            )
        )
        await client.reconfigure(two.config())
        await client.wait_ready(TIMEOUT)
        assert runners == [0]  # only the task that reports the state is left


async def test_a_new_configuration_during_a_close_starts_nothing() -> None:
    async with Peer() as peer:
        client = await peer.client().__aenter__()
        changing = asyncio.ensure_future(client.reconfigure(peer.config()))
        await turns(1)
        await client.close()
        await changing
        assert not ours()
        await client.reconfigure(peer.config())
        assert client.state is LinkState.STOPPED


async def test_a_cancelled_reconfigure_leaves_a_link() -> None:
    async with Peer() as one, Peer() as two, one.client() as client:
        (await one.wire()).freeze()
        changing = asyncio.ensure_future(client.reconfigure(two.config()))
        await turns(2)
        changing.cancel()
        with pytest.raises(asyncio.CancelledError):
            await changing
        await two.wire()
        await client.wait_ready(TIMEOUT)


async def test_a_timeout_passes_on_a_cancellation_that_meets_a_result() -> None:
    result: asyncio.Future[int] = asyncio.get_running_loop().create_future()
    task = asyncio.ensure_future(run_with_timeout(5, result))
    await turns(2)
    result.set_result(1)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task


@pytest.mark.parametrize("kind", ["json", "tcp"])
async def test_an_attempt_cancelled_as_it_succeeds_leaves_no_socket(kind: str) -> None:
    async with Peer(kind) as peer:
        for pause in range(0, 60, 3):
            opening = asyncio.ensure_future(open_transport(peer.config()))
            await turns(pause)
            opening.cancel()
            try:
                transport = await opening
            except asyncio.CancelledError:
                continue
            assert opening.done()
            await transport.close()
        await eventually(lambda: all(wire.gone.is_set() for wire in peer.wires))


BLOCKED_LOOKUPS = """
import asyncio, threading
from woosh_robot_agent.link.tasks import run_main

async def main():
    for _ in range(50):
        asyncio.get_running_loop().run_in_executor(None, threading.Event().wait)
    await asyncio.to_thread(print, "not blocked")

run_main(main())
"""


def test_host_names_that_are_looked_up_delay_neither_each_other_nor_the_end_of_a_program() -> None:
    program = [sys.executable, "-c", BLOCKED_LOOKUPS]
    done = subprocess.run(program, capture_output=True, text=True, timeout=TIMEOUT)
    assert (done.returncode, done.stdout, done.stderr) == (0, "not blocked\n", "")
