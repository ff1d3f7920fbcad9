"""Both ends of a connection: the order of frames; clients that leave, send too much, or close."""

from __future__ import annotations

import asyncio
import contextlib
import random
from collections.abc import AsyncIterator, Iterator
from typing import Any

import pytest

from tests.link.link_peer import config, eventually, serve, soon, turns
from woosh_robot_agent.link.server import serve_tcp, serve_websocket
from woosh_robot_agent.link.tasks import LARGE
from woosh_robot_agent.link.transport import (
    CHUNK,
    ClientSocket,
    TransportClosedError,
    open_transport,
)

HANDSHAKE = (
    b"GET / HTTP/1.1\r\nHost: here\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)
CLOSED_AS_TOO_BIG = b"\x88\x02\x03\xf1"  # a close frame with code 1009
UNREAD = 16 * 1024 * 1024
"""More bytes than the sockets' buffers hold."""


@contextlib.asynccontextmanager
async def streams(
    handler: Any, request: bytes
) -> AsyncIterator[tuple[asyncio.StreamReader, asyncio.StreamWriter]]:
    """Serve WebSockets, and send a request over TCP."""
    listener = await serve_websocket(handler, "127.0.0.1", 0, max_size=100_000)
    reader, writer = await asyncio.open_connection("127.0.0.1", listener.port)
    writer.write(request)
    yield reader, writer
    writer.close()
    await listener.close()


async def serve_nobody(_: Any) -> None:
    raise AssertionError("not a WebSocket")


@pytest.mark.parametrize(
    ("transport", "serve"), [("websocket", serve_websocket), ("tcp", serve_tcp)]
)
async def test_writing_to_a_client_that_leaves_tells_that_the_connection_has_ended(
    transport: str, serve: Any
) -> None:
    ended: asyncio.Future[str] = asyncio.get_running_loop().create_future()

    async def write_until_the_end(server_side: Any) -> None:
        try:
            while True:  # at each moment of the closing handshake
                await server_side.send_raw(server_side.header(1) + b"x")
                await asyncio.sleep(0)
        except TransportClosedError as error:
            ended.set_result(str(error))
        except Exception as error:
            ended.set_exception(error)

    listener = await serve(write_until_the_end, "127.0.0.1", 0, max_size=1000)
    client = await open_transport(config(listener.port, transport=transport))
    await client.recv()
    await client.close()
    assert await soon(ended)
    await listener.close()


async def test_too_large_message_is_refused_before_all_of_it_has_arrived() -> None:
    ended: asyncio.Future[str] = asyncio.get_running_loop().create_future()

    async def read(server_side: Any) -> None:
        try:
            await server_side.recv()
        except TransportClosedError as error:
            ended.set_result(str(error))

    async def send_forever(writer: asyncio.StreamWriter) -> None:
        while True:
            writer.write(b"x" * 65536)
            await writer.drain()

    async with streams(read, HANDSHAKE) as (reader, writer):
        await soon(reader.readuntil(b"\r\n\r\n"))
        # a masked text frame of an exbibyte
        writer.write(b"\x81\xff" + (1 << 60).to_bytes(8, "big") + bytes(4))
        sending = asyncio.ensure_future(send_forever(writer))
        with contextlib.suppress(ConnectionResetError):  # the reset may overtake the close frame
            assert (await soon(reader.read(1000)))[:4] == CLOSED_AS_TOO_BIG
        assert await soon(ended)
        sending.cancel()


async def test_client_closes_a_connection_that_sends_its_last_bytes_meanwhile() -> None:
    closing: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    received: asyncio.Future[int] = asyncio.get_running_loop().create_future()

    async def read_late(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await closing
        received.set_result(len(await reader.read()))
        writer.close()

    server = await asyncio.start_server(read_late, "127.0.0.1", 0, limit=CHUNK)
    client = await open_transport(config(server.sockets[0].getsockname()[1], transport="tcp"))
    sending = asyncio.ensure_future(client.send(bytes(UNREAD)))
    await asyncio.sleep(0)
    assert client.backlog() > 0
    ends = asyncio.ensure_future(client.close(60.0))
    await asyncio.sleep(0)
    closing.set_result(None)
    await soon(ends)
    assert await soon(received) > UNREAD
    await asyncio.gather(sending, return_exceptions=True)
    server.close()


@pytest.mark.parametrize("line", [b"Sec-WebSocket-Version: 1", b"Sec-WebSocket-Key: A", b"Host: h"])
async def test_headers_that_are_no_text_are_refused(line: bytes) -> None:
    async with streams(serve_nobody, HANDSHAKE.replace(line, line + b"\xa2")) as (reader, _):
        assert (await soon(reader.readline())).startswith(b"HTTP/1.1 400")


async def test_late_answer_to_a_handshake_is_no_late_handshake(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("woosh_robot_agent.link.server._OPEN_TIMEOUT", 0.5)

    async def send(server_side: Any) -> None:
        await server_side.send("now")

    late = {"before_handshake": lambda: asyncio.sleep(1.0)}
    listener = await serve_websocket(send, "127.0.0.1", 0, max_size=1000, **late)
    client = await open_transport(config(listener.port, transport="websocket"))
    assert await soon(client.recv()) in (b"now", "now")  # text before websockets 14
    await client.close()
    await listener.close()


async def test_plain_request_is_told_that_the_port_serves_websockets() -> None:
    request = b"POST /woosh/robot/Mode HTTP/1.1\r\nHost: x\r\nContent-Length: 0\r\n\r\n"
    async with streams(serve_nobody, request) as (reader, _):
        answer = await soon(reader.readuntil(b"only WebSockets"))
        assert answer.startswith(b"HTTP/1.1 426 ")


CAN_TAKE = "websockets.asyncio" in ClientSocket.__module__
"""True if this release of websockets has what `Transport.take_at_once` needs."""


def frames(count: int) -> Iterator[str | list[str]]:
    """Yield small, fragmented and large frames in random order; each begins with its number."""
    shuffled = random.Random(7)
    for number in range(count):
        text = f"{number} "
        yield shuffled.choice([text, text, text, [text, "a", "b"], text + "x" * LARGE])


async def test_frames_keep_their_order_however_they_arrive() -> None:
    count = 300
    go_on = asyncio.Event()

    async def chassis(socket: Any) -> None:
        for number, frame in enumerate(frames(count)):
            await socket.send(frame if isinstance(frame, str) else in_turns(frame))
            if number % 50 == 49:  # the reader empties its queue, and takes frames at once again
                await soon(go_on.wait())
                go_on.clear()

    seen: list[int] = []
    taken: list[int] = []

    def note(data: str | bytes) -> int:
        seen.append(int(data.split()[0]))
        if len(seen) % 50 == 0:
            go_on.set()
        return seen[-1]

    async with serve(chassis, "127.0.0.1", 0, compression=None) as server:
        port = server.sockets[0].getsockname()[1]
        transport = await open_transport(config(port))
        transport.take_at_once(lambda data: taken.append(note(data)))
        reader = asyncio.ensure_future(read(transport, note))
        await eventually(lambda: len(seen) == count)
        reader.cancel()
        await transport.close()
    assert seen == list(range(count))
    assert bool(taken) == CAN_TAKE
    assert len(taken) < count


async def in_turns(parts: list[str]) -> AsyncIterator[str]:
    """Yield the fragments of a message; the reader waits for the next one meanwhile."""
    for part in parts:
        await turns()
        yield part


async def read(transport: Any, note: Any) -> None:
    while True:
        note(await transport.recv())
