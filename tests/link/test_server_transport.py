"""The server's end of a connection after the other end has left."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from tests.link.link_peer import aio, config, soon
from woosh_robot_agent.link.server import serve_tcp, serve_websocket
from woosh_robot_agent.link.transport import TransportClosedError, open_transport


@pytest.mark.parametrize(
    ("transport", "serve"), [("websocket", serve_websocket), ("tcp", serve_tcp)]
)
@aio
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
